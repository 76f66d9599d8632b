// One friction state after another: tips and their derivatives, for calibration and inverse kinematics.
#pragma once

#include <vector>

#include "ctr/friction_solver.hpp"
#include "ctr/sensitivities.hpp"
#include "ctr/shape.hpp"
#include "ctr/zero_clearance.hpp"

namespace ctr {

// Solves along the branch of the zero-clearance model. Friction states of one configuration asked for in a row share their
// mesh and the first part of the way.
class TipSolver {
  public:
    explicit TipSolver(const Robot& robot) : solver_(robot) {}

    // phi per pair, outermost first; to the last digits, which derivatives need. unstable: an angle's pivot is negative, the
    // robot would turn away from the solution.
    Status solve(const Configuration& q, const Accuracy& accuracy, const std::vector<double>& phi);
    // Of the last solution, which must have converged.
    void differentiate(const std::vector<Direction>& directions, std::vector<TipDerivative>& out) {
        sensitivities_.compute(solver_, state_, q_, phi_, directions, out);
    }

    void differentiate_body(const std::vector<Direction>& directions, double spacing, BodyDerivatives& out) {
        sensitivities_.compute_body(solver_, state_, q_, phi_, directions, spacing, out);
    }

    const Convergence& convergence() const { return convergence_; }
    const Frame& tip() const { return backbone_.tip; }
    const LaneState& state() const { return state_; }
    double max_strain() const { return backbone_.max_strain; }

  private:
    void begin(const Configuration& q, const Accuracy& accuracy);

    FrictionSolver solver_;
    ZeroClearance zero_;
    LaneState state_, shared_;
    bool begun_ = false, shared_is_good_ = false;
    Accuracy accuracy_;
    Configuration q_;
    std::vector<double> phi_;
    Convergence convergence_;
    Backbone backbone_;
    BackboneTracer tracer_;
    Sensitivities sensitivities_;
};

}  // namespace ctr
