// What a solver found, as it is answered.
#pragma once

#include "ctr/model.hpp"

namespace ctr {

// Throws InvalidInput for robots of too many tubes.
void require_all_corners(const Robot& robot);

BoundShapes bound_shapes(const BoundSolver& solver);
void fill_bound(const BoundSolver& solver, std::size_t row, BoundRows& out);

}  // namespace ctr
