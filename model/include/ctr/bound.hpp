// The friction bound at a configuration: the frictionless solution, every sign corner, the largest deviations.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "ctr/friction_solver.hpp"
#include "ctr/shape.hpp"
#include "ctr/zero_clearance.hpp"

namespace ctr {

class CarriedState;
class Predictor;

// Friction states phi [row][section][pair], outermost pair first: of equally long parts of each pair, from the plate to the
// end of its outer tube.
struct FrictionStates {
    const double* phi;
    std::size_t rows;
    int sections;
};

// Shapes that solves begin from, theta [row][tube][count] at arc lengths s [count], and the rotations of the bases [row][tube] and
// friction states phi [row][pair] that they are solved for, outermost first.
struct GivenShapes {
    const double *s, *theta, *base, *phi;
    std::size_t count, rows;
};

// What all friction states of a configuration share, for whoever asks for more of them later: the frictionless robot, and the
// iterate where the states part from it.
struct FrictionlessStart {
    Configuration q;
    Accuracy accuracy;
    Mesh mesh;
    std::optional<LaneState::Kept> shared;
    std::optional<ZeroClearance> zero;  // in its place where that was not reached
    Backbone rest;
    Convergence convergence;
    double stability = 0;  // as FrictionSolver::stabilities
};

// A solution in one friction state.
struct FrictionShape {
    const Backbone& backbone;
    const Convergence& convergence;
    double stability;
};

// All solutions at one configuration; keeps its memory from one configuration to the next and starts warm where it can.
class BoundSolver {
  public:
    explicit BoundSolver(const Robot& robot);
    ~BoundSolver();
    BoundSolver(const BoundSolver&) = delete;
    BoundSolver& operator=(const BoundSolver&) = delete;

    // Solves from scratch, along the branch of the zero-clearance model.
    void solve(const Configuration& q, const Accuracy& accuracy);
    // Starts from the previous solution, carried over to the new mesh; from scratch if that is not possible or fails.
    // retrying: from the solution the last call started from, whose outcome was rejected.
    void follow(const Configuration& q, const Accuracy& accuracy, bool retrying = false);
    // Stands at q as it does already, or did before its last step; where it did not, as solve().
    void begin_at(const Configuration& q, const Accuracy& accuracy);
    // One solution for given friction states, phi per pair, outermost first.
    void solve_single(const Configuration& q, const Accuracy& accuracy, const std::vector<double>& phi);

    // The frictionless robot from scratch, and solutions for friction states from there; each is shown as it stands there.
    FrictionlessStart begin_states(const Configuration& q, const Accuracy& accuracy);
    void solve_states(const FrictionlessStart& start, const FrictionStates& states,
                      const std::function<void(std::size_t row, const FrictionShape&)>& show);
    // Solves from given shapes, on whatever branch they lie, with bases where q has them but for the rotations; shows also the
    // angles [tube][count] as they were given.
    void solve_from(const Configuration& q, const Accuracy& accuracy, const GivenShapes& given,
                    const std::function<void(const FrictionShape&, std::vector<double>&& theta)>& show);
    // Solves from scratch, then every corner from every other one: how far [m] a stable equilibrium found so lies from the
    // corner's own, the largest per corner; 0 where all agree, inf where a corner was not solved.
    std::vector<double> corners_apart(const Configuration& q, const Accuracy& accuracy);

    // Looks for other stable equilibria: restarts of the zero-clearance model with the inner tubes of each pair turned
    // across opposed precurvatures, confirmed on the frictionless clearance model. status() then says multiple.
    void search_others();

    // All corners, as a new solver has them (of robots of at most kMostTubesOfAllCorners; those of more have none), or these
    // alone, signs [corner][pair].
    void visit_all_corners();
    void visit_corners(std::vector<signed char> signs);
    static constexpr int kMostTubesOfAllCorners = 10;

    int corners() const { return corners_; }
    // Corner signs in itertools.product((1, -1)) order, outermost pair first.
    int sign(int corner, int pair) const {
        if (!signs_.empty()) return signs_[static_cast<std::size_t>(corner) * pairs_ + pair];
        return (corner >> (pairs_ - 1 - pair)) & 1 ? -1 : 1;
    }
    const LaneState& corner_state(int corner) const { return *batches_[corner / lanes_]; }
    int corner_lane(int corner) const { return corner % lanes_; }
    const LaneState& frictionless_state() const { return frictionless_; }
    const Convergence& frictionless() const { return frictionless_convergence_; }
    const Convergence& corner(int k) const { return corner_convergence_[k]; }
    bool started_cold() const { return cold_; }  // the last solve or follow, from nothing
    bool all_converged() const;
    double stability() const { return stability_; }
    std::vector<double> shape_stabilities();  // frictionless, then every corner with its friction
    Status status() const;  // of the frictionless solution
    Status corner_status(int k) const;
    bool overtwisted() const;  // a friction state was not reached because of that
    int iterations() const;
    const FrictionSolver& solver() const { return solver_; }
    const Configuration& configuration() const { return q_; }
    const Accuracy& accuracy() const { return accuracy_; }
    ZeroClearance& zero_clearance() { return zero_; }  // also a workspace for zero-clearance solutions alone

    // Largest deviation of the corners from the frictionless solution; NaN unless everything converged.
    double position = 0;           // tip, m
    double tangent = 0;            // tip, rad
    int worst_corner = 0;          // of the tip position
    std::vector<double> envelope;  // (nodes) innermost centreline, m
    double max_strain = 0;         // over frictionless and corners
    Backbone backbone;             // frictionless
    std::vector<Backbone> corner_backbones;

  private:
    std::vector<int> sections_of_contacts(int sections) const;
    void return_to(const FrictionlessStart& start);
    void prepare(const Configuration& q, const Accuracy& accuracy);
    void solve_frictionless();
    void solve_corners();
    void lay_out(int corners);
    bool shares_steps() const { return corners_ > 16; }  // memory counts from six tubes on: factors of the last batch alone
    void grant_far_steps(double share);
    void reach_far(LaneState& state, double level, Convergence& result);
    void reach_corner(std::size_t batch, int lane);
    bool reach_from_neighbour(int corner, Convergence& result, bool only_far = false);
    void set_trial(int corner);
    void keep_trial(int corner);
    void reach_rest();
    bool reach_from_neighbours();
    int neighbour(int corner, int pair) const;  // that with the sign of one pair turned; the corner itself if it is not visited
    BarrierPath set_out(LaneState& state);
    void set_corner_phi(std::size_t batch);
    void measure();
    void remember();
    bool follow_last();
    bool follow_from(bool predicted);
    bool advance(std::size_t index, LaneState& state, bool predicted, Convergence* result);

    FrictionSolver solver_;
    BackboneTracer tracer_;
    ZeroClearance zero_;
    int pairs_, corners_, lanes_ = kLanes;  // lanes_: of a batch of corners
    std::vector<signed char> signs_;  // empty: all corners
    int far_steps_ = 0;               // left for corners that are hard to reach
    bool took_long_ = false;          // to reach one of them
    LaneState frictionless_, shared_;  // shared_: the frictionless iterate where the friction states part
    bool shared_is_good_ = false;
    std::vector<std::unique_ptr<LaneState>> batches_;
    std::vector<LaneState*> states_;  // frictionless, then the batches
    Convergence frictionless_convergence_;
    std::vector<Convergence> corner_convergence_;
    std::vector<bool> is_far_;  // corners that Newton's method did not reach by itself
    double stability_ = 0;
    int negative_ = 0;
    bool multiple_ = false;
    ZeroClearance other_;
    LaneState trial_;
    bool have_solution_ = false, cold_ = true;
    std::vector<bool> unfactored_;  // batches a lane of which came from elsewhere, or whose factors others have overwritten
    std::vector<CarriedState> carried_;  // what follow() starts from: frictionless, then the batches
    std::unique_ptr<Predictor> predictor_;
    std::vector<double> phi_;
    Configuration q_;
    Accuracy accuracy_;
};

}  // namespace ctr
