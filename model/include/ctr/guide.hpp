// Shapes that solves begin from in place of a robot without precurvature: those of the branch of equilibria that it stands on.
#pragma once

#include <cstddef>
#include <vector>

namespace ctr {

struct Configuration;

// A shape that a solve begins from: angles [tube][count] of the tubes, outermost first, at arc lengths s [count] that ascend,
// in between on straight lines, beyond as at the ends.
struct GivenAngles {
    const double *s, *theta;
    std::size_t count;
    double at(int tube, double place) const;
};

// Shapes along a way of the joints, each solved from the one before: angles [row][tube][count] at arc lengths s [count], of bases
// theta [rad] and l [m], [row][tube].
struct Guide {
    // The one rule by which branches are followed, here and in Python: steps so short that no other shape is reached.
    static constexpr double kRotation = 0.2;        // rad, longest step of a base: longer ones are seldom reached at once
    static constexpr double kTranslation = 6e-3;    // m
    static constexpr double kCorrection = 0.35;     // rad that an angle may part from what a step makes of it: more is another shape
    static constexpr double kShortest = 1.0 / 64;   // of a longest step: where that one parts, the branch has ended

    std::vector<double> s, theta, l, angles;
    std::size_t tubes = 0;

    std::size_t rows() const { return tubes ? theta.size() / tubes : 0; }
    GivenAngles shape(std::size_t row) const { return {s.data(), angles.data() + row * tubes * s.size(), s.size()}; }
    // The row with bases nearest to q, each whole turn of which counts as a step; turned: its bases, by whole turns as
    // near to q as they come, and its angles turn along.
    std::size_t nearest(const Configuration& q, Configuration& turned) const;
    // Steps between two configurations, on each of which a branch is followed.
    static double steps(const Configuration& a, const Configuration& b);
};

}  // namespace ctr
