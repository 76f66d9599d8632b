#include "ctr/shape.hpp"

#include <algorithm>
#include <cmath>

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"
#include "shape/stations.hpp"

}  // namespace

Shape make_shape(const FrictionSolver& solver, const LaneState& state, int lane, const Configuration& q) {
    const KernelProblem& pb = solver.mesh().problem();
    const Robot& robot = solver.robot();
    const std::vector<double>& s = solver.mesh().s();
    const int n = robot.count();
    Shape shape;
    shape.tubes.resize(n);
    double kappa[4][kMaxTubes][2], rotated[kMaxTubes][2], rotated_end[kMaxTubes][2];
    std::vector<Frame> frame(n);
    BackboneTracer tracer;
    tracer.bend(solver, state, lane, 1);
    for (int e = 0; e < pb.elements; ++e) {
        const int m = pb.element_tubes[e];
        for (int g = 0; g < 2; ++g) {
            element_curvature(solver, state, lane, e, kGauss[g], kappa[g], rotated);
            tracer.innermost(e, g, lane, kappa[g][0]);  // the same digits as in a backbone
        }
        element_curvature(solver, state, lane, e, 1.0, kappa[3], rotated_end);
        element_curvature(solver, state, lane, e, 0.0, kappa[2], rotated);
        for (int t = 0; t < m; ++t) {
            const int i = n - 1 - t;
            TubeShape& tube = shape.tubes[i];
            const bool ghost = solver.mesh().is_ghost(e, t);
            if (ghost && t > 0) continue;  // the innermost one's goes on to the robot's tip, as its centreline
            const double radius = ghost ? 0.0 : robot.tubes[i].outer_radius;
            const double rate = (state.unknown(e + 1, 5 * t, lane) - state.unknown(e, 5 * t, lane)) / pb.length[e];
            if (tube.s.empty()) {
                frame[i].p = {0, 0, q.l[i]};
                append(tube, s[e], frame[i], state.unknown(e, 5 * t, lane), rate, kappa[2][t], rotated[t], radius);
            }
            advance(frame[i], kappa[0][t], kappa[1][t], pb.length[e]);
            append(tube, s[e + 1], frame[i], state.unknown(e + 1, 5 * t, lane), rate, kappa[3][t], rotated_end[t], radius);
            // a section joint may jump the strain: report the larger side
            const double proximal = radius * std::hypot(kappa[2][t][0] - rotated[t][0], kappa[2][t][1] - rotated[t][1]);
            double& before = tube.strain[tube.strain.size() - 2];
            before = std::max(before, proximal);
        }
    }
    shape.end_at(tip_frame(solver, state, lane, frame[n - 1]));
    for (const TubeShape& tube : shape.tubes)
        for (double strain : tube.strain) shape.max_strain = std::max(shape.max_strain, strain);
    for (double at : shape.tubes[n - 1].s) shape.radius.push_back(outermost_radius(robot, q, at));
    shape.contacts.resize(n - 1);
    for (int e = 0; e < pb.elements; ++e)
        for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k) {
            const int p = pb.contact_pair[k];
            double d[2];
            for (int plane = 0; plane < 2; ++plane)
                d[plane] = pb.contact_shape[4 * k] * state.unknown(e, 1 + 5 * p + plane, lane) +
                           pb.contact_shape[4 * k + 1] * state.unknown(e, 3 + 5 * p + plane, lane) +
                           pb.contact_shape[4 * k + 2] * state.unknown(e + 1, 1 + 5 * p + plane, lane) +
                           pb.contact_shape[4 * k + 3] * state.unknown(e + 1, 3 + 5 * p + plane, lane) +
                           state.shift(k, plane, lane);
            ContactForces& contact = shape.contacts[n - 2 - p];
            contact.s.push_back(solver.mesh().contact_s()[k]);
            contact.force.push_back(state.multiplier(k, lane) * std::hypot(d[0], d[1]));
            contact.angle.push_back(std::atan2(d[1], d[0]));
        }
    return shape;
}

}  // namespace ctr
