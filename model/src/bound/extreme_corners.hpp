// Which corners move the tip farthest, found without visiting all 2^(n-1).
#pragma once

#include <vector>

#include "ctr/bound.hpp"

namespace ctr {

// Signs of those corners, [corner][pair], outermost pair first: what full friction of every pair by itself does to tip and
// tangent says where the farthest vertices of their sums are (a zonotope has about n^2 of them); the best of these are solved,
// and from there on every pair is turned around as long as that leads farther. What was not reached is among them.
std::vector<signed char> extreme_corners(BoundSolver& solver, const Configuration& q, const Accuracy& accuracy);

}  // namespace ctr
