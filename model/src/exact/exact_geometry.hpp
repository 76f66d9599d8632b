// The equations of the paper on the exact geometry: every tube a curve on SE(3) of its own (2), contact in the normal plane
// of the outer tube (18)-(19), forces (36)-(40) at the two centrelines, torques (41) about the two tangents, balance (37).
//
// Unknowns are those of friction_solver.hpp. The tubes' curvatures, each in its own twist-free frame, are the first-order ones plus
// `bend`; integrating them gives the true offsets at the contact points and the true moments of the contact forces. What
// these differ by from the first-order ones enters the first-order Newton system as a shift of the offsets and a load, until
// nothing changes (deferred correction): the residual that vanishes is the exact one, the matrix only has to be close.
// docs/model.md, "Exact geometry".
#pragma once

#include <array>
#include <vector>

#include "exact/alignment.hpp"
#include "ctr/curve.hpp"
#include "ctr/kernel.hpp"
#include "ctr/robot.hpp"

namespace ctr {

class FrictionSolver;
class LaneState;

class ExactGeometry {
  public:
    // For a configuration that the solver has a mesh for.
    void build(const FrictionSolver& solver, const Configuration& q);
    // Updates shift, load and bend of a lane at its iterate. Returns the largest moment [N m] by which bend had been wrong:
    // part of the residual, whose other part is what the kernel finds with the new load and shift.
    double update(const FrictionSolver& solver, LaneState& state, int lane);

  private:
    // A tube in the element in hand: what acts on it beyond the element's base, and the moments inside.
    struct Element {
        Vec3 force{0, 0, 0}, torque{0, 0, 0};  // N, N m about the base, world
        double moment[2][2];                   // [Gauss point][plane] N m, against the curvature vector
        Vec3 e1[2], e2[2];                     // twist-free axes at the Gauss points
        double offset[4][2], load[4][2];       // of the pair that it is the inner tube of: Hermite values, and what goes with them
    };
    struct Bent {
        double kappa[2], moment[2], tangent[3];  // 1/m, N m, N m^2
        double torque() const { return moment[0] * kappa[1] - moment[1] * kappa[0]; }
    };
    // On the curvature that is 1 at a Gauss point and 0 at the other: the work of a moment that falls by one an element to zero
    // at the contact, and of a constant one up to it; over the Gauss weight.
    struct Work {
        double falling[2], constant[2];
    };

    void integrate(const KernelProblem& pb);
    void begin_element(const FrictionSolver& solver, const LaneState& state, int lane, int element);
    void press(const KernelProblem& pb, LaneState& state, int lane, int element, int contact);
    static void twist(Element& tube, const Work& work, double torque, const Vec3& tangent);
    double balance(const FrictionSolver& solver, LaneState& state, int lane, int element);

    std::vector<double> base_l_, mass_;       // [tube], innermost first; m, kg/m
    GaussField curvature_, rotated_;          // 1/m, in the tubes' twist-free frames; precurvatures turned by theta
    std::vector<Frame> frame_;                // [node][tube], twist-free
    std::vector<Work> work_;                  // [contact]
    std::array<Element, kMaxTubes> element_;
    Alignment alignment_;
};

}  // namespace ctr
