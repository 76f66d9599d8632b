// Path history: elastic energy and the torques of the actuators.
#include "ctr/history.hpp"

#include <algorithm>
#include <cmath>

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"

// Energy per length over EI of a cross section that is bent to rho, see (f) in docs/model.md.
double bending(double rho, double knee, double fraction) {
    if (rho <= knee) return 0.5 * rho * rho;
    return (1 - fraction) * knee * (rho - 0.5 * knee) + 0.5 * fraction * rho * rho;
}

}  // namespace

double History::base_torque(int t) const {
    const KernelProblem& pb = solver_.mesh().problem();
    const int node = pb.shaft_node[t];
    if (node < 0) return 0;
    if (pb.shaft_stiffness[t] > 0) return pb.shaft_stiffness[t] * (pb.shaft_angle[t] - state_.unknown(node, 5 * t, 0));
    return const_cast<LaneState&>(state_).rhs(node, 5 * t, 0);
}

double History::elastic_energy() const {
    const KernelProblem& pb = solver_.mesh().problem();
    const Robot& robot = solver_.robot();
    double kappa[kMaxTubes][2], rotated[kMaxTubes][2], energy = 0;
    for (int e = 0; e < pb.elements; ++e) {
        const double h = pb.length[e];
        for (int t = 0; t < pb.element_tubes[e]; ++t) {
            const double twist = state_.unknown(e + 1, 5 * t, 0) - state_.unknown(e, 5 * t, 0);
            energy += 0.5 * pb.torsional_stiffness[t] * twist * twist / h;
        }
        for (double xi : kGauss) {
            element_curvature(solver_, state_, 0, e, xi, kappa, rotated);
            for (int t = 0; t < pb.element_tubes[e]; ++t) {
                const Tube& tube = robot.tubes[pb.tubes - 1 - t];
                const double axis = tube.ovality_axis + (1 - xi) * state_.unknown(e, 5 * t, 0) + xi * state_.unknown(e + 1, 5 * t, 0);
                const double x = kappa[t][0] - rotated[t][0], y = kappa[t][1] - rotated[t][1];
                const double k0 = std::cos(axis) * x + std::sin(axis) * y, k1 = std::cos(axis) * y - std::sin(axis) * x;
                const double rho = std::sqrt((1 + tube.ovality) * k0 * k0 + (1 - tube.ovality) * k1 * k1);
                energy += 0.5 * h * pb.bending_stiffness[pb.element_regime[e] / 2 * pb.tubes + t] * bending(rho, tube.softening_strain / tube.outer_radius, tube.softening_fraction);
            }
        }
    }
    for (int t = 0; t < pb.tubes; ++t)
        if (pb.shaft_stiffness[t] > 0) energy += 0.5 * base_torque(t) * base_torque(t) / pb.shaft_stiffness[t];
    return energy;
}

}  // namespace ctr
