// What a discretised robot is made of, as a row of numbers.
#pragma once

#include <utility>
#include <vector>

#include "ctr/mesh.hpp"
#include "ctr/robot.hpp"

namespace ctr {

// Where each kind of number stands in a row of all that a discretised robot is made of. Tubes and pairs are counted from the
// innermost, as in KernelProblem.
struct NumberLayout {
    NumberLayout() = default;
    NumberLayout(int tubes, int elements);
    int tubes = 0, elements = 0;
    int start = 0;              // of the innermost tube, m
    int base = 0;               // [tube] base rotation, rad
    int length = 0;             // [element]
    int precurvature = 0;       // [element][Gauss point][tube][2]
    int bending = 0, ovality = 0, axis = 0, knee = 0, fraction = 0;                   // [tube], of its law
    int torsional = 0, shaft_stiffness = 0, shaft_angle = 0;                          // [tube]
    int half_square = 0, outer_arm = 0, inner_arm = 0, scale = 0, friction = 0;       // [pair]
    int load = 0;               // LaneState::load_moments()
    int count = 0;
};

// The row itself up to the loads; contact points and their weights go with the lengths of elements.
void read_numbers(const Mesh& mesh, const Robot& robot, const Configuration& q, std::vector<double>& row);

// A change of the row: the places that change, and by how much per unit.
using NumberChange = std::vector<std::pair<int, double>>;

}  // namespace ctr
