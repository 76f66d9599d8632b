#include "ctr/loads.hpp"

#include <algorithm>
#include <cmath>

namespace ctr {
namespace {

constexpr double kGauss[2] = {0.21132486540518711775, 0.78867513459481288225};

Vec3 sum(const Vec3& a, const Vec3& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
Vec3 difference(const Vec3& a, const Vec3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }

}  // namespace

// Moment about p(s) of what acts beyond s: m(s) = m_tip + (p_tip - p) x f_tip + int (p(sigma) - p) x q dsigma, summed from
// the tip; as a curvature vector (t' = kappa) in the twist-free frame it is (m_y, -m_x).
double LoadMoments::update(const FrictionSolver& solver, LaneState& state, double base_l) {
    const Robot& robot = solver.robot();
    double change = 0;
    const KernelProblem& pb = solver.mesh().problem();
    const Loads& loads = robot.loads;
    for (int lane = 0; lane < state.lanes(); ++lane) {
        trace_backbone(solver, state, lane, base_l, backbone_);
        Vec3 force{loads.tip_force[0], loads.tip_force[1], loads.tip_force[2]};
        Vec3 moment{loads.tip_moment[0], loads.tip_moment[1], loads.tip_moment[2]};  // at the distal node
        for (int e = pb.elements - 1; e >= 0; --e) {
            const Frame &near = backbone_.frame[e], &far = backbone_.frame[e + 1];
            double mass = 0;
            for (int t = 0; t < pb.element_tubes[e]; ++t) mass += robot.tubes[pb.tubes - 1 - t].mass_per_length;
            const double h = pb.length[e];
            const Vec3 weight{mass * loads.gravity[0], mass * loads.gravity[1], mass * loads.gravity[2]};  // N/m
            const Vec3 chord = difference(far.p, near.p);
            for (int g = 0; g < 2; ++g) {
                const double rest = 1 - kGauss[g];  // of the element beyond the point; its bow is of second order
                Vec3 arm, half;
                for (int i = 0; i < 3; ++i) {
                    arm[i] = rest * chord[i];
                    half[i] = rest * h * weight[i];
                }
                const Vec3 own = cross(arm, half);
                Vec3 m = sum(moment, cross(arm, force));
                for (int i = 0; i < 3; ++i) m[i] += 0.5 * own[i];
                const bool carried = !solver.mesh().mean_is_free(e);
                Vec3 column[2];
                for (int k = 0; k < 2; ++k) {
                    const Vec3 a = near.column(k), b = far.column(k);
                    for (int i = 0; i < 3; ++i) column[k][i] = (1 - kGauss[g]) * a[i] + kGauss[g] * b[i];
                }
                for (int plane = 0; plane < 2; ++plane) {
                    const double value = carried ? 0.0 : plane ? -dot(column[0], m) : dot(column[1], m);
                    double& kept = state.load_moment(e, g, plane, lane);
                    change = std::max(change, std::fabs(value - kept));
                    kept = value;
                }
            }
            const Vec3 own{h * weight[0], h * weight[1], h * weight[2]};
            const Vec3 by_weight = cross(chord, own);
            moment = sum(moment, cross(chord, force));
            for (int i = 0; i < 3; ++i) moment[i] += 0.5 * by_weight[i];
            force = sum(force, own);
        }
    }
    return change;
}

}  // namespace ctr
