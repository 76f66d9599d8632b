#include "contact/load_moments.hpp"

#include <algorithm>
#include <cmath>

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"

constexpr double kWeighed = 1e-12;        // of the moments of loads: their last change

Vec3 sum(const Vec3& a, const Vec3& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
Vec3 difference(const Vec3& a, const Vec3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }

}  // namespace

// Moment about p(s) of what acts beyond s: m(s) = m_tip + (p_tip - p) x f_tip + int (p(sigma) - p) x q dsigma, summed from
// the tip for each tube; as a curvature vector (t' = kappa) in the twist-free frame it is (m_y, -m_x).
void LoadMoments::update(const FrictionSolver& solver, const Robot& robot, LaneState& state, double base_l, double* changes) {
    const KernelProblem& pb = solver.mesh().problem();
    const Loads& loads = robot.loads;
    Vec3 force[kMaxTubes], moment[kMaxTubes];  // on each tube beyond the distal node, about it
    double differs = 0, largest = 0;
    auto keep = [&](double& kept, double value) {
        const double change = std::fabs(value - kept);
        differs = change <= differs ? differs : change;  // a NaN stays
        largest = std::max(largest, std::fabs(value));
        kept = value;
    };
    for (int lane = 0; lane < state.lanes(); ++lane) {
        differs = largest = 0;
        tracer_.trace(solver, state, lane, 1, base_l, &backbone_);
        for (int t = 0; t < pb.tubes; ++t) force[t] = moment[t] = {0, 0, 0};
        for (int i = 0; i < 3; ++i) {
            force[0][i] = loads.tip_force[i];
            moment[0][i] = loads.tip_moment[i];
        }
        keep(state.tip_torque(lane), dot(moment[0], backbone_.frame.back().tangent()));
        for (int e = pb.elements - 1; e >= 0; --e) {
            const Frame &near = backbone_.frame[e], &far = backbone_.frame[e + 1];
            const double h = pb.length[e];
            const Vec3 chord = difference(far.p, near.p);
            for (int t = 0; t < pb.element_tubes[e]; ++t) {
                const double mass = robot.tubes[pb.tubes - 1 - t].mass_per_length;
                const Vec3 weight{mass * h * loads.gravity[0], mass * h * loads.gravity[1], mass * h * loads.gravity[2]};
                for (int g = 0; g < 2; ++g) {
                    const double rest = 1 - kGauss[g];  // of the element beyond the point; its bow is of second order
                    Vec3 arm, half;
                    for (int i = 0; i < 3; ++i) {
                        arm[i] = rest * chord[i];
                        half[i] = 0.5 * rest * weight[i];
                    }
                    const Vec3 m = sum(sum(moment[t], cross(arm, force[t])), cross(arm, half));
                    Vec3 column[2];
                    for (int k = 0; k < 2; ++k) {
                        const Vec3 a = near.column(k), b = far.column(k);
                        for (int i = 0; i < 3; ++i) column[k][i] = (1 - kGauss[g]) * a[i] + kGauss[g] * b[i];
                    }
                    keep(state.load_moment(e, g, t, 0, lane), dot(column[1], m));
                    keep(state.load_moment(e, g, t, 1, lane), -dot(column[0], m));
                }
                const Vec3 half{0.5 * weight[0], 0.5 * weight[1], 0.5 * weight[2]};
                moment[t] = sum(sum(moment[t], cross(chord, force[t])), cross(chord, half));
                force[t] = sum(force[t], weight);
            }
        }
        changes[lane] = differs / (solver.moment_scale() + largest);
    }
}

void FrictionSolver::weigh(LaneState& state) {
    if (loads_) loads_->update(*this, robot_, state, base_l_, load_change_.data());
}

// Steps are scaled by what the last two say of the slowest mode (Aitken), per lane: by themselves they go astray where a load
// bends as much as the tube resists.
void FrictionSolver::converge_load_moments(LaneState& state) {
    constexpr int kMost = 100;
    constexpr double kLeast = 0.02, kLongest = 20;
    const std::size_t lanes = state.lanes(), count = state.load_moment_count();
    double share[kMostLanes];
    std::fill(share, share + kMostLanes, 1.0);
    for (int k = 0; loads_ && k < kMost; ++k) {
        load_begun_.assign(state.load_moments(), state.load_moments() + count);
        weigh(state);
        if (std::all_of(load_change_.begin(), load_change_.begin() + lanes, [](double change) { return !(change > kWeighed); })) return;
        load_step_.swap(load_step_before_);
        load_step_.resize(count);
        for (std::size_t i = 0; i < count; ++i) load_step_[i] = state.load_moments()[i] - load_begun_[i];
        for (std::size_t lane = 0; lane < lanes; ++lane) {
            double product = 0, square = 0;
            for (std::size_t i = lane; k > 0 && i < count; i += lanes) {
                const double differs = load_step_[i] - load_step_before_[i];
                product += load_step_before_[i] * differs;
                square += differs * differs;
            }
            if (square > 0) share[lane] = std::clamp(-share[lane] * product / square, kLeast, kLongest);
            for (std::size_t i = lane; i < count; i += lanes) state.load_moments()[i] = load_begun_[i] + share[lane] * load_step_[i];
        }
    }
}

}  // namespace ctr
