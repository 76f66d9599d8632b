// Keeps the offsets that are unknowns of friction_solver.hpp equal to the true ones of exact_geometry.hpp, up to short waves.
#pragma once

#include <array>
#include <vector>

#include "ctr/curve.hpp"

namespace ctr {

class FrictionSolver;
class LaneState;
struct KernelProblem;

// Plane vectors of all tubes, innermost first, at the two Gauss points of every element.
class GaussField {
  public:
    void resize(int elements, int tubes) {
        tubes_ = tubes;
        values_.resize(static_cast<std::size_t>(elements) * 2 * tubes);
    }
    double (*at(int element, int gauss))[2] { return &values_[(element * 2 + gauss) * tubes_].v; }
    const double (*at(int element, int gauss) const)[2] { return &values_[(element * 2 + gauss) * tubes_].v; }

  private:
    struct Plane {
        double v[2];
    };
    int tubes_ = 0;
    std::vector<Plane> values_;
};

// Where tubes lie beside each other on a bent course, equal curvatures do not keep them at equal distance: per length, the
// inner tube of the bend gets ahead by kappa . d (the epsilon of (16)), and its frame turns by d' x kappa against the outer
// one's. Over a course that turns by a radian the true offsets depart from d'' = difference of curvatures by as much as d
// itself, however small d. The curvatures are corrected by what a change of the offsets is known to need.
class Alignment {
  public:
    void build(const FrictionSolver& solver);
    // Corrects the curvatures of a lane for the change of its offsets since `record`, and for what was wrong then.
    void correct(const FrictionSolver& solver, LaneState& state, int lane, GaussField& curvature);
    // Takes down the true offsets. frame: twist-free frames, [node][tube].
    void record(const FrictionSolver& solver, LaneState& state, int lane, const GaussField& curvature, const std::vector<Frame>& frame);

  private:
    using Plane = std::array<double, 2>;
    struct Knot {
        int node;
        Plane value, slope;  // m, 1
    };
    void find_range(const KernelProblem& pb, int pair);
    void find_needs(const KernelProblem& pb, const GaussField& curvature, int pair);
    void place_knots(const std::vector<double>& s);
    void bend(const FrictionSolver& solver, LaneState& state, int lane, int pair, GaussField& curvature) const;

    double spacing_ = 0;      // m, of the knots: shorter waves need no correction
    int first_ = 0, last_ = 0;      // nodes of the pair in hand
    std::vector<Plane> offset_;     // [node] m
    std::vector<Plane> needs_;      // [node] m: its second derivative is the difference of curvatures that the offsets need
    std::vector<Knot> knots_;
};

}  // namespace ctr
