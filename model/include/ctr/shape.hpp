// Shapes out of solutions: centrelines, frames, curvatures, strains, contact forces.
#pragma once

#include <memory>
#include <vector>

#include "ctr/curve.hpp"
#include "ctr/equilibrium.hpp"
#include "ctr/friction_solver.hpp"
#include "ctr/robot.hpp"
#include "ctr/zero_clearance.hpp"

namespace ctr {

// Numbers are part of the Python contract (ctrplan.mechanics.Status).
// overtwisted: of single shapes only, where rows say failed.
enum class Status { converged = 0, multiple = 1, unstable = 2, failed = 3, overtwisted = 4 };

struct TubeShape {
    std::vector<double> s;          // (N) m from the plate
    std::vector<Vec3> position;     // (N) m, world
    std::vector<std::array<double, 9>> frame;  // (N) material frame R, row major
    std::vector<double> theta;      // (N) rad, material angle against the tube's twist-free frame
    std::vector<Vec3> curvature;    // (N) u in the material frame, 1/m
    std::vector<double> strain;     // (N) r_out |u_xy - u_hat_xy|
};

struct ContactForces {
    std::vector<double> s;      // m
    std::vector<double> force;  // N, normal force between the tubes of the pair
    std::vector<double> angle;  // rad, direction of the inner centreline seen from the outer one, twist-free frame
};

struct Shape {
    Vec3 tip, tip_tangent;                // of the innermost tube, world
    std::vector<TubeShape> tubes;         // outermost first; empty, as contacts, radius and max_strain are, until laid out
    std::vector<ContactForces> contacts;  // outermost pair first
    std::vector<double> radius;           // (N) outer radius of what is there, at the innermost tube's s
    Status status = Status::failed;
    double residual = 0, stability = 0, max_strain = 0;
    std::shared_ptr<const Equilibrium> equilibrium;  // null where nobody kept it

    void lay_out() {
        if (tubes.empty() && equilibrium) equilibrium->lay_out(*this);
    }
    void end_at(const Frame& frame) { tip = frame.p, tip_tangent = frame.tangent(); }
};

// The innermost centreline alone, with what the planner needs along it; memory is reused.
struct Backbone {
    std::vector<Frame> frame;          // (nodes) twist-free frames of the innermost tube
    std::vector<Vec3> outer_position;  // (nodes) centreline of the outermost tube present, distal side of the node
    std::vector<Vec3> outer_end;       // (nodes) the same of the proximal side: another where a tube ends
    Frame tip;                         // twist-free; where the centreline ends, along the foremost tube
    double max_strain = 0;             // over all tubes
};

// At the end of the innermost centreline, turned along the foremost tube, against which a ghost is tilted.
Frame tip_frame(const FrictionSolver& solver, const LaneState& state, int lane, const Frame& innermost);

// Bending curvature of every tube (innermost first) and its rotated precurvature at xi in [0, 1] of an element.
void element_curvature(const FrictionSolver& solver, const LaneState& state, int lane, int element, double xi,
                       double (*curvature)[2], double (*rotated)[2]);

// Bending moment of tube t against curvature kappa at a Gauss point, N m, and its derivative, xx, xy, yy.
void section_moment(const FrictionSolver& solver, const LaneState& state, int lane, int element, int gauss, int t, const double* kappa,
                    const double* rotated, double* moment, double* tangent);

// Integrates backbones out of solutions; memory is reused.
class BackboneTracer {
  public:
    // Of `count` lanes from the first one on, into as many backbones; base_l [m] is the innermost tube's.
    void trace(const FrictionSolver& solver, const LaneState& state, int first_lane, int count, double base_l, Backbone* out);
    // The first half of that: how the innermost tube bends.
    void bend(const FrictionSolver& solver, const LaneState& state, int first_lane, int count);
    void innermost(int element, int gauss, int lane, double* curvature) const;

  private:
    void follow(const FrictionSolver& solver, const LaneState& state, int lane, double base_l, Backbone& out) const;

    AlignedArray innermost_;  // [element][Gauss point][2][lane] 1/m
    alignas(kAlignment) double strain_square_[kMostLanes] = {};
    int lanes_ = 1;
};

Shape make_shape(const FrictionSolver& solver, const LaneState& state, int lane, const Configuration& q);
Shape make_shape(const Robot& robot, const ZeroClearance& solution, const Configuration& q);
Frame end_of(const Robot& robot, const ZeroClearance& solution, const Configuration& q);  // of that shape, to the last digit

}  // namespace ctr
