// The law that residuals keep, whatever the robot.
#pragma once

#include <algorithm>

#include "ctr/bound.hpp"
#include "random_robot.hpp"

namespace tests {

// Residuals of what a bound rests on: below 1e-8, or below what rounding leaves on a mesh with elements shorter than 0.2 mm.
inline void expect_residuals(const ctr::BoundSolver& solver, int seed) {
    const double tolerance = solver.solver().tolerance();
    const ctr::KernelProblem& mesh = solver.solver().mesh().problem();
    const bool coarse = *std::min_element(mesh.length, mesh.length + mesh.elements) > 2e-4;
    expect(tolerance == 1e-8 || (!coarse && tolerance <= 1e-6), "residual below 1e-8 where no element is short", seed);
    expect(solver.frictionless().residual < tolerance, "residual reached without friction", seed);
    for (int k = 0; k < solver.corners(); ++k) expect(solver.corner(k).residual < tolerance, "residual reached in a corner", seed);
}

}  // namespace tests
