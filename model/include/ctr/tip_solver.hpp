// One friction state after another: tips and their derivatives, for calibration and inverse kinematics.
#pragma once

#include <memory>
#include <mutex>
#include <vector>

#include "ctr/friction_solver.hpp"
#include "ctr/sensitivities.hpp"
#include "ctr/shape.hpp"
#include "ctr/zero_clearance.hpp"

namespace ctr {

// A solution in one place of many that are asked for again and again, of robots that hardly differ.
struct KeptTip {
    std::vector<int> node_unknowns, contact_begin;  // how its mesh was laid out
    LaneState::Kept state;
    Vec3 believed{}, tip{};  // m, of the zero-clearance model, which says which branch that is, and its own
};

// Such solutions, by place; one call at a time has them.
struct TipMemory {
    std::vector<std::unique_ptr<KeptTip>> places;
    std::mutex busy;
};

// Solves along the branch of the zero-clearance model. Friction states of one configuration asked for in a row share their
// mesh and the first part of the way.
class TipSolver {
  public:
    explicit TipSolver(const Robot& robot) : solver_(robot) {}

    // phi per pair, outermost first; to the last digits, which derivatives need. unstable: an angle's pivot is negative, the
    // robot would turn away from the solution. kept: a solution near which it is sought first, if there is one, and that it
    // leaves; where the tip of it or of the zero-clearance model is elsewhere, or the robot turns away, none is near.
    Status solve(const Configuration& q, const Accuracy& accuracy, const std::vector<double>& phi, std::unique_ptr<KeptTip>* kept = nullptr);
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
    void share();  // the first part of the way
    bool solve_near(const KeptTip& kept);
    void solve_cold();
    void keep(std::unique_ptr<KeptTip>& kept) const;

    FrictionSolver solver_;
    ZeroClearance zero_;
    LaneState state_, shared_;
    bool begun_ = false, is_shared_ = false, shared_is_good_ = false;
    Accuracy accuracy_;
    Configuration q_;
    std::vector<double> phi_;
    Convergence convergence_;
    Backbone backbone_;
    BackboneTracer tracer_;
    Sensitivities sensitivities_;
};

}  // namespace ctr
