// Derivatives of a solution by joints and by the robot's numbers, from the last factorisation.
#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "ctr/friction_solver.hpp"
#include "ctr/shape.hpp"

namespace ctr {

class LoadMoments;
class TipGradient;

// Every number of a robot and of a configuration, in one order; names like "tube.1.section.2.length", from 1, outermost
// first, SI units. Joints come last: theta_b.1, ..., l_b.1, ...
std::vector<std::string> number_names(const Robot& robot);
void numbers(Robot& robot, Configuration& q, std::vector<double*>& all);

// A change of several numbers at once: what is asked for may be a combination of them. `step` [in units of the parameter] is
// small for it: differences are taken across it of expressions that are polynomials or trigonometric in the parameter.
struct Direction {
    std::vector<std::pair<int, double>> weights;  // index into numbers(), derivative of the number by the parameter
    double step;
    bool operator==(const Direction&) const = default;
};

struct TipDerivative {
    Vec3 position{0, 0, 0};  // m per unit
    Vec3 tangent{0, 0, 0};
    static TipDerivative nowhere();  // NaN: a direction that cannot be followed
};

// The outermost tubes in front of the plate and, without friction, the stability, by P directions; NaN for those that lead nowhere.
struct BodyDerivatives {
    std::vector<double> point;         // [N][4] m: position and outer radius, as collect_points() has them
    std::vector<double> point_by;      // [N][3][P] m per unit, of points that keep their shares of the elements
    double stability = 0;              // NaN with friction
    std::vector<double> stability_by;  // [P]
};

// Differentiates the converged equations (d)-(e) of docs/model.md at constant barrier level. With F(x, lambda, w; p) = 0,
// contact multipliers and gaps eliminated as in a Newton step, H dx/dp = -dF/dp; the tip follows along dx and dp. Where tubes
// carry nothing, one gradient of the tip serves all directions, loads among them (tip_gradient.hpp).
class Sensitivities {
  public:
    Sensitivities();
    ~Sensitivities();
    // state: one lane, converged on the solver's mesh for the friction states phi. out: one entry per direction, NaN
    // where a collar, joint or tip would pass another one, a rigid shaft would yield, or the loads' share does not converge.
    void compute(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi,
                 const std::vector<Direction>& directions, std::vector<TipDerivative>& out);

    // The same with a right-hand side and two backbones for every direction, whatever the tubes are.
    void compute_each(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi,
                      const std::vector<Direction>& directions, std::vector<TipDerivative>& out);

    // Bodies at points no farther apart than `spacing`.
    void compute_body(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi,
                      const std::vector<Direction>& directions, double spacing, BodyDerivatives& out);

  private:
    enum class Way { gradient, loaded, none };  // how a direction is taken; loaded: it brings loads; none: it leads nowhere
    struct Side {  // the problem at parameter +- step
        FrictionSolver* solver = nullptr;      // the one asked about where only base rotations change, else its own
        std::unique_ptr<FrictionSolver> own;
        Robot robot;
        Configuration q;
        std::vector<double*> values;           // numbers() of the two
        std::vector<double> gap, barrier, rhs;  // of every contact, every unknown
    };
    void set(const FrictionSolver& solver, const Configuration& q, const Direction& direction, double amount, Side& side) const;
    bool shift(FrictionSolver& solver, const Configuration& q, const Direction& direction, double amount, Side& side) const;
    void prepare(const FrictionSolver& solver, const Configuration& q, const std::vector<Direction>& directions);
    Way read_change(const FrictionSolver& solver, const Configuration& q, const Direction& direction, std::vector<std::pair<int, double>>& change);
    void add_loads(const FrictionSolver& solver, LaneState& state, const Configuration& q, const Direction& direction,
                   std::vector<std::pair<int, double>>& change);
    bool only_turns(const FrictionSolver& solver, const Direction& direction) const;
    void start(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<Direction>& directions);
    TipDerivative follow(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi,
                         const Direction& direction);
    // Whether the solution can be followed along a direction: its sides and changes are then known.
    bool measure_change(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi,
                        const Direction& direction);
    void read_points(const FrictionSolver& solver, LaneState& state, double spacing, const double* lengths, std::vector<double>& out);
    double stability_beside(LaneState& state, const std::vector<double>& phi, double amount, Side& side);
    double follow_stability(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi,
                            const Direction& direction);
    bool loads(const FrictionSolver& solver, const Configuration& q, const std::vector<Direction>& directions);
    void measure_multiplier_change(const LaneState& state, double step);
    void measure_gaps(const LaneState& state, Side& side) const;
    void measure_imbalance(LaneState& state, const std::vector<double>& phi, double amount, Side& side);
    void move_state(LaneState& state, double amount) const;  // along change_
    void set_load_moments(LaneState& state, double amount) const;
    void move_to(LaneState& state, double amount, const Side& side) const;
    void rest(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi) const;
    void solve_change(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi, double step);
    bool follow_loads(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi, double step);
    Frame tip(const FrictionSolver& solver, LaneState& state);

    Side plus_, minus_, here_;
    std::vector<double> unknowns_, change_, multiplier_, multiplier_change_, slack_, above_, below_, moments_, moments_change_, upper_moments_;
    Backbone backbone_;
    BackboneTracer tracer_;
    std::unique_ptr<TipGradient> gradient_;
    std::unique_ptr<LoadMoments> loads_;
    // What the directions change in a row of numbers, for the configuration and the mesh that were asked about last.
    std::vector<Direction> directions_;
    Configuration q_;
    std::vector<double> s_;
    std::vector<std::vector<std::pair<int, double>>> changes_;
    std::vector<std::pair<int, double>> with_loads_;  // a change of those, and what its loads ask of the tubes
    std::vector<Way> ways_;
    Mesh moved_;
    std::vector<double> upper_, lower_;
};

}  // namespace ctr
