// Equilibria with clearance and friction: minimise (4)-(5) subject to (14) for phi = 0, and solve the balance (37) with
// friction forces (38) and torques (41) otherwise, by a primal-dual interior point on the mesh of mesh.hpp. The friction
// state phi of a pair multiplies its friction coefficient: phi = +1, -1 are the paper's eta, anything between is the share
// of the Coulomb limit that acts circumferentially.
#pragma once

#include <algorithm>
#include <array>
#include <memory>
#include <vector>

#include "ctr/guide.hpp"
#include "ctr/kernel.hpp"
#include "ctr/lane_state.hpp"
#include "ctr/mesh.hpp"
#include "ctr/robot.hpp"
#include "ctr/zero_clearance.hpp"

namespace ctr {

class ExactGeometry;
class LoadMoments;

struct Convergence {
    bool converged = false;
    double residual = 0;         // largest imbalance of force * element length, moment, torque over EI * precurvature; or change of loads
    double complementarity = 0;  // largest |lambda w - eps| / eps
    int iterations = 0;
    bool overtwisted = false;    // not converged: on its way there a tube was twisted far beyond what any bears
};

// Barrier levels, in units of the robot's own force per length (largest EI * precurvature over the innermost tube's length
// squared; 3.6 N/m for the three-tube robot): the multiplier of a contact satisfies lambda w = level * clearance *
// tributary length. The first level is so stiff that its solution is close to the zero-clearance one; the last leaves
// contact-free points with a force of about `last` times their length.
struct BarrierPath {
    double first, last;
    double shrink = 0.05;
    int max_steps = 40;
    bool centre_only = false;  // stop near the central path at the last level; the residual is not promised

    static constexpr double kFirst = 8e3, kSoft = 8, kParting = 1;
    static BarrierPath cold(double last) { return {kFirst, last}; }
    // The cold path in parts: what all friction states share, where they part, and how the frictionless one goes on.
    static BarrierPath shared() { return {kFirst, kParting, 0.05, 40, true}; }
    static BarrierPath parted(double last) { return {kParting, last, 0.3, 24}; }
    static BarrierPath onward(double last) { return {std::max(0.3 * kParting, last), last, 0.3}; }
    // After a motion of so many degrees or half millimetres: the farther contacts move, the softer the barrier starts.
    static BarrierPath warm(double motion, double last) {
        return {std::clamp(0.06 * motion * motion, std::min(4 * last, 0.3), kSoft), last, 0.08};
    }
    // From an extrapolated solution.
    static BarrierPath predicted(double last) { return {last, last, 0.3, 8}; }
};

class FrictionSolver {
  public:
    explicit FrictionSolver(const Robot& robot);
    ~FrictionSolver();

    void build(const Configuration& q, const Accuracy& accuracy);
    void adopt(const Mesh& mesh, const Configuration& q, const Accuracy& accuracy);  // a mesh kept from an earlier build
    // Another solver's mesh as it would be built for a robot and configuration a little way off (Mesh::build_like).
    bool take(const FrictionSolver& from, const Robot& robot, const Configuration& q);
    // Its own mesh moved along (Mesh::move).
    bool move_along(const Configuration& q);
    // Angles from the zero-clearance solution, no offsets, multipliers on the central path at the given level (BarrierPath).
    void start(LaneState& state, const Configuration& q, const ZeroClearance& guess, double level);
    // The same in one lane, from a given shape.
    void start_lane(LaneState& state, int lane, const Configuration& q, const GivenAngles& guess, double level);
    // Angles of one lane where `like` has its own, of all tubes as there.
    void read_angles(const LaneState& state, int lane, const GivenAngles& like, std::vector<double>& theta) const;
    // Copies a one-lane iterate on the same mesh, its exact geometry included, into every lane, or into one.
    void spread(const LaneState& from, LaneState& to) const;
    void copy(const LaneState& from, LaneState& to, int lane) const;
    // Puts every contact of an earlier solution back on the central path at the given level, for a warm start.
    void recentre(LaneState& state, double level);
    // Base angles of a new configuration on an unchanged mesh layout; the twist at the base is kept.
    void set_base(LaneState& state, const Configuration& q);
    // Newton steps down the barrier path; every lane ends at path.last. converged is filled per lane. first: levels that lanes
    // begin at instead of path.first.
    void solve(LaneState& state, const BarrierPath& path, Convergence* result, const double* first = nullptr);
    // Down the barrier path with the angles of every lane held, from where start_lane() left them: offsets and forces that belong to
    // these angles, at the level [lane] whose solution is nearest to them. An equilibrium's own level is the last.
    void find_levels(LaneState& state, const BarrierPath& path, double* level);
    // One lane that solve() brought to its tolerances, to the last digits: derivatives are those of exact solutions.
    void finish(LaneState& state, Convergence& result);
    // One lane, for what solve() does not reach from an iterate near the central path at the given level: by easing the
    // softening of the tubes, where they soften, else by friction that grows from none, else by sliding.
    // Gives up after about `most_steps` Newton steps; returns whether it got there.
    bool reach(LaneState& state, double level, Convergence& result, int most_steps = kMostSteps);
    // One lane, from an iterate near the central path at the given level: follows the way the robot would slide, off folds
    // and onto a stable branch, by implicit steps in time. Slow.
    void slide(LaneState& state, double level, Convergence& result, int most_steps = kMostSteps);
    static constexpr int kMostSteps = 3000;
    // Shear strain of a tube's outside, r_out * twist rate, at which sliding gives up. Friction at its full limit everywhere winds
    // up some robots by tens of turns; nitinol bears a shear of 0.14 or so, and no tube one of 0.5.
    static constexpr double kMostShear = 0.5;
    // The frictionless torsional second variation's smallest eigenvalue over GJ / L^2 of the innermost tube; uses the
    // factors left in a one-lane state by solve(). Negative pivots are counted into `negative`.
    double stability(LaneState& state, int& negative);
    // Of every lane, friction included: the real eigenvalue nearest to zero of the unsymmetric Newton matrix, in the same unit.
    void stabilities(LaneState& state, double* stability);
    // Whether an angle's pivot of the last factors is negative.
    bool turns_away(const LaneState& state, int lane = 0) const;
    // Largest imbalance of one lane as it is over EI * precurvature, its loads as the shape asks: a residual evaluated anew.
    double imbalance(LaneState& state);
    // Factors the Newton matrix at a converged iterate, for derivatives.
    void factorise(LaneState& state);

    // Brings the moments of the loads up to date with the shape: once, or until both agree for the unknowns as they are or no
    // way there is found.
    void weigh(LaneState& state);
    void converge_load_moments(LaneState& state);

    static double barrier_unit(const Robot& robot);  // N/m: of its levels, see BarrierPath

    const Mesh& mesh() const { return mesh_; }
    const Robot& robot() const { return robot_; }
    double base_l() const { return base_l_; }  // m, of the innermost tube
    double moment_scale() const { return moment_scale_; }
    double tolerance() const { return tolerance_; }        // of residuals: 1e-8, or what rounding leaves on this mesh
    double last_barrier() const { return last_barrier_; }  // of the accuracy built for
    double last_level() const { return last_barrier_ * barrier_unit_; }  // N/m

  private:
    template <class Angle>
    void fill_lane(LaneState& state, int lane, const Configuration& q, const Angle& angle, double level);
    struct SlideState;  // of a slide that may be gone on with
    double rounding() const;
    void scale(const Configuration& q, const Accuracy& accuracy);
    void lengthen(LaneState& state, double* primal, double* dual);
    bool load_friction(LaneState& state, double level, Convergence& result, int most_steps);
    bool ease(LaneState& state, double level, Convergence& result);
    void slide_on(LaneState& state, SlideState& at, Convergence& result, int most_steps);
    bool settle(LaneState& state, double level, double damping, int& steps);
    double moved(const LaneState& state) const;  // rad, since the anchor
    double largest_shear(const LaneState& state) const;  // of one lane: r_out * twist rate
    double largest_twist(const LaneState& state, int lane) const;  // rad, of the last step

    Robot robot_;
    Mesh mesh_, left_;  // left_: where move_along() came from
    double moment_scale_ = 1, barrier_unit_ = 1, last_barrier_ = 1;  // N m, N/m, in units
    double base_l_ = 0;
    double tolerance_ = 1e-8;  // of the residual
    std::unique_ptr<LoadMoments> loads_;  // null without loads
    std::array<double, kMostLanes> load_change_{};  // per lane, the last one of the moments of the loads, over their size
    std::vector<double> load_begun_, load_step_, load_step_before_;  // of converge_load_moments()
    LaneState kept_;  // of slide() and ease(): the iterate to go back to, and the anchor
    LaneState begun_, slid_;  // of reach(): where it began, and where a slide stopped short
    std::unique_ptr<ExactGeometry> exact_;
    bool is_exact_ = false;  // accuracy built for
    bool loads_first_ = false;  // of reach(): on this mesh friction that grows got there where sliding did not
    std::vector<double> modes_;  // of stability(), [node][tube] each
};

}  // namespace ctr
