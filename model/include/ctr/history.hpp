// What the robot does along a joint path: equilibria whose friction follows the slip of every contact point.
//
// Each contact carries a friction vector (phi, psi) in the unit disc, the circumferential and axial share of the Coulomb
// limit. A step of the joints slips it circumferentially by r_out dtheta_in - r_in dtheta_out + c dalpha, taken at the material
// points that are in contact now, and axially by the relative translation; the vector follows over a short breakaway
// length and is projected back onto the disc (return mapping). phi enters the equilibrium and is solved with it.
#pragma once

#include <memory>
#include <vector>

#include "ctr/friction_solver.hpp"
#include "ctr/shape.hpp"
#include "ctr/tip_solver.hpp"

namespace ctr {

class CarriedState;

struct HistoryOptions {
    double breakaway = 0.02e-3;        // m
    double rotation = 0.05;            // rad, longest step of a tube base
    double translation = 0.5e-3;       // m
    double state_change = 0.05;        // of phi, mean over the contacts weighted by force, aimed at in a step
};

// Work and energy of a step of pure rotations, N m. Translations are left out on all sides, their friction is.
struct EnergyBalance {
    double work = 0;           // of the actuators
    double elastic = 0;        // growth of elastic energy
    double breakaway = 0;      // growth of what is stored before contacts slip
    double loss = 0;           // in contacts that slip
    double smallest_loss = 0;  // of any contact in any step
};

// Friction of a pair at its N contact points.
struct PairFriction {
    std::vector<double> s, phi, psi, force;  // m; shares of the Coulomb limit; N
};

// What is there after each waypoint of a path: rows after a failure are NaN, the one that failed but for its status.
struct WaypointRows {
    WaypointRows(std::size_t rows, std::size_t pairs);
    std::vector<Status> status;
    std::vector<double> snaps;
    std::vector<Vec3> tip, tangent;
    std::vector<double> phi;  // [row][pair], averaged by normal force
};

class History {
  public:
    History(const Robot& robot, const Accuracy& accuracy, const HistoryOptions& options);
    ~History();

    // Begins at a configuration with every contact of a pair at phi, e.g. 0 released, +-1 fully loaded in a corner.
    Status start(const Configuration& q, const std::vector<double>& phi);
    // Moves all joints together to a configuration. A step that no equilibrium continues ends where the robot slides to.
    // Called off, this and follow() leave the history where it was before.
    Status advance(const Configuration& q);

    // Waypoint after waypoint.
    WaypointRows follow(const std::vector<Configuration>& path);

    Shape shape() const;
    std::vector<PairFriction> friction() const;  // outermost pair first

    struct Iterate {
        std::vector<double> unknowns, multiplier, slack;
    };
    // A memory of where a history stands.
    struct State {
        Configuration q;
        Mesh mesh;
        Iterate iterate;
        std::vector<double> phi, psi, built_breaks, pending_slip;
        Status status = Status::failed;
        Convergence convergence;
        std::vector<double> owner;  // numbers of the robot and mesh it is of
    };
    State save() const;
    void restore(const State& state);  // throws InvalidInput if it is of another robot or accuracy

    // The solution with every contact of a pair at phi on the branch that this history is on: friction goes there by parts, the
    // history stays where it is. False where the branch ends before.
    bool solve_beside(const std::vector<double>& phi, Backbone& backbone);

    const FrictionSolver& solver() const { return solver_; }
    const LaneState& state() const { return state_; }
    const Configuration& configuration() const { return q_; }
    Status status() const { return status_; }
    double residual() const { return convergence_.residual; }
    const std::vector<double>& phi() const { return phi_; }  // [contact] of the mesh
    const std::vector<double>& psi() const { return psi_; }
    void mean_phi(double* phi) const;  // [pair] outermost first, averaged by normal force
    const EnergyBalance& energy() const { return energy_; }  // of the last advance
    int steps() const { return steps_; }                     // of the last advance
    int snaps() const { return snaps_; }                     // of the last advance

  private:
    // Contacts of a pair where the last step ended.
    struct OldContacts {
        std::vector<double> s, phi, psi, d;
    };
    struct Before {
        Configuration q;
        std::vector<double> breaks, s, unknowns;
        std::vector<OldContacts> pairs;
    };
    // Friction and direction of contact that a contact point had before the step.
    struct OldContact {
        double phi = 0, psi = 0, direction[2] = {0, 0};
    };
    template <class Work>
    auto put_back_if_interrupted(const Work& work);
    Status move(const Configuration& target);
    bool go_beside(const std::vector<double>& phi, Backbone& backbone);
    WaypointRows move_along(const std::vector<Configuration>& path);
    void identify();
    Iterate iterate() const;
    void put(const Iterate& iterate);
    void remember();
    void move_mesh(const Configuration& q);
    bool is_stretched(double most) const;
    struct Crossing {
        double before, after;  // parts of the way
    };
    bool leaves_mesh(const Configuration& q) const;
    Crossing find_crossing(const Configuration& from, const Configuration& target, double done, double next) const;
    bool renew_mesh(const Configuration& q);
    void refer(const Configuration& q);
    void publish_law();
    OldContact old_contact(int pair, double s) const;
    double old_angle(int tube, double s) const;
    double offset(int element, int contact, int plane) const;
    double slip_of(int element, int contact) const;
    bool try_step(const Configuration& q);
    double largest_turn(const Configuration& q) const;
    bool slide(const Configuration& q);
    bool slide_with(const std::vector<double>& phi);
    void hold(const std::vector<double>& phi);
    std::vector<double> followed_phi() const;
    void finish_step(const Configuration& q);
    double change_of_friction() const;
    void take_stock();
    double elastic_energy() const;
    double base_torque(int tube) const;

    HistoryOptions options_;
    Accuracy accuracy_;
    std::vector<double> identity_;  // State::owner
    static constexpr double kLargestTurn = 0.15;  // rad, of any place in a step: more is another equilibrium, or a step too long

    BackboneTracer tracer_;
    FrictionSolver solver_;
    TipSolver starter_;
    LaneState state_;
    Configuration q_;
    Status status_ = Status::failed;
    Convergence convergence_;
    std::vector<double> phi_, psi_;
    Before before_;
    std::unique_ptr<CarriedState> carried_;
    std::vector<double> built_breaks_;  // of the mesh when it was built
    std::vector<double> pending_slip_;  // [pair] from the innermost, m: axial, not yet in the friction
    bool has_factors_ = false;     // of the iterate as it is
    bool held_ = false;            // friction did not follow all of the last slide
    std::vector<double> friction_, reference_, across_, last_phi_, next_psi_, inner_arm_, outer_arm_;
    SlipLaw law_{};
    EnergyBalance energy_;
    double elastic_ = 0;
    std::vector<double> torque_;
    int steps_ = 0, snaps_ = 0;
};

}  // namespace ctr
