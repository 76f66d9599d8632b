// Newton's method down the barrier path, one or four friction states side by side.
#include <algorithm>
#include <cmath>
#include <limits>

#include "contact/load_moments.hpp"
#include "ctr/friction_solver.hpp"
#include "ctr/watch.hpp"
#include "exact/exact_geometry.hpp"

namespace ctr {
namespace {

#include "contact/newton_limits.hpp"

constexpr double kNearlyFull = 0.99;      // of a step, below which no residual vanishes
constexpr double kExactComplementarity = 0.03;  // of a barrier ten to a hundred times lower
constexpr int kExactSteps = 40;           // more, since convergence is linear
constexpr int kMostFinalSteps = 4;         // of finish(): they square the error
constexpr double kRounding = 1e-9;        // of complementarity, relative
constexpr double kComplementarity = 1e-3; // of the last barrier level, itself far below any contact force

}  // namespace

void FrictionSolver::solve(LaneState& state, const BarrierPath& path, Convergence* result, const double* first) {
    const KernelProblem& pb = mesh_.problem();
    if (is_exact_ && !state.is_exact()) state.begin_exact(pb);
    const int lanes = state.lanes();
    const KernelTable& run = kernel(lanes);
    alignas(kAlignment) double level[kMostLanes], primal[kMostLanes], dual[kMostLanes], moment[kMostLanes], gap[kMostLanes];
    double bend_error[kMostLanes] = {};
    bool done[kMostLanes] = {};
    const double last = path.last * barrier_unit_;
    for (int lane = 0; lane < lanes; ++lane) {
        level[lane] = (first ? first[lane] : path.first) * barrier_unit_;
        result[lane] = {};
        result[lane].residual = result[lane].complementarity = std::numeric_limits<double>::infinity();
    }
    weigh(state);
    auto update = [&] {
        for (int lane = 0; is_exact_ && lane < lanes; ++lane)
            if (!done[lane] && level[lane] < kExactLevel * barrier_unit_) bend_error[lane] = exact_->update(*this, state, lane);
    };
    update();
    const int most = path.max_steps + (is_exact_ ? kExactSteps : 0);
    const double centred = is_exact_ ? kExactComplementarity : kComplementarity;
    for (int k = 0; k < most; ++k) {
        Watch::look();
        run.newton(pb, state.view(), level, nullptr);
        run.step_length(pb, state.view(), kKeep, primal, dual);
        lengthen(state, primal, dual);
        for (int lane = 0; lane < lanes; ++lane) {
            const double twist = largest_twist(state, lane);
            if (done[lane] || !(twist < 1e6)) {  // also NaN
                primal[lane] = dual[lane] = 0;
                continue;
            }
            primal[lane] = std::min(primal[lane], kMaxTwistStep / std::max(twist, 1e-12));
        }
        run.advance(pb, state.view(), primal, dual);
        if (pb.tubes > 1) weigh(state);
        else converge_load_moments(state);  // no contact whose imbalance would show that a load still changes the shape
        bool check = false;
        for (int lane = 0; lane < lanes; ++lane) {
            if (done[lane]) continue;
            ++result[lane].iterations;
            if (level[lane] <= last && std::min(primal[lane], dual[lane]) > kNearlyFull) check = true;
            if (path.centre_only && level[lane] <= last && std::min(primal[lane], dual[lane]) > 0.5) {
                done[lane] = result[lane].converged = true;
                continue;
            }
            const double worst = std::min(primal[lane], dual[lane]);
            if (worst > 0.3) level[lane] = std::max(last, level[lane] * (worst > 0.8 ? path.shrink : 0.5));
        }
        if (path.centre_only) {
            if (std::all_of(done, done + lanes, [](bool d) { return d; })) return;
            update();
            continue;
        }
        update();
        if (!check) continue;
        run.residual(pb, state.view(), level, moment, gap);
        bool all = true;
        for (int lane = 0; lane < lanes; ++lane) {
            if (done[lane]) continue;
            result[lane].residual = std::max(std::max(moment[lane], bend_error[lane]) / moment_scale_, loads_ ? load_change_[lane] : 0.0);
            result[lane].complementarity = gap[lane];
            const bool weighed = !loads_ || load_change_[lane] < tolerance_;  // NaN is not
            if (level[lane] <= last && result[lane].residual < tolerance_ && gap[lane] < centred && weighed)
                done[lane] = result[lane].converged = true;
            all = all && done[lane];
        }
        if (all) return;
    }
}

void FrictionSolver::find_levels(LaneState& state, const BarrierPath& path, double* level) {
    const KernelProblem& pb = mesh_.problem();
    const int lanes = state.lanes();
    const KernelTable& run = kernel(lanes);
    LaneState nearest;
    for (LaneState* other : {&nearest, &kept_}) {
        other->share_steps(state);
        other->resize(pb, lanes);
        for (int lane = 0; lane < lanes; ++lane) other->copy_lane(state, lane, lane, pb);
    }
    alignas(kAlignment) double barrier[kMostLanes], damping[kMostLanes], primal[kMostLanes], dual[kMostLanes];
    double least[kMostLanes];
    std::fill(damping, damping + lanes, kMostDamping);
    std::fill(least, least + lanes, std::numeric_limits<double>::infinity());
    std::fill(level, level + lanes, path.first);
    weigh(state);
    for (double at = path.first;; at = std::max(path.last, path.shrink * at)) {
        std::fill(barrier, barrier + lanes, at * barrier_unit_);
        double shortest = 0;
        for (int k = 0; k < kMostAtLevel && shortest <= kNearlyFull; ++k) {
            Watch::look();
            run.newton(pb, state.view(&kept_), barrier, damping);
            run.step_length(pb, state.view(), kKeep, primal, dual);
            run.advance(pb, state.view(), primal, dual);
            weigh(state);
            shortest = std::min(*std::min_element(primal, primal + lanes), *std::min_element(dual, dual + lanes));
        }
        run.newton(pb, state.view(), barrier, nullptr);
        for (int lane = 0; lane < lanes; ++lane) {
            const double twist = largest_twist(state, lane);
            if (!(twist < least[lane])) continue;
            least[lane] = twist;
            level[lane] = at;
            nearest.copy_lane(state, lane, lane, pb);
        }
        if (at <= path.last) break;
    }
    for (int lane = 0; lane < lanes; ++lane) state.copy_lane(nearest, lane, lane, pb);
}

void FrictionSolver::finish(LaneState& state, Convergence& result) {
    const KernelProblem& pb = mesh_.problem();
    const KernelTable& run = kernel(1);
    const double level = last_level();
    for (int k = 0; k < kMostFinalSteps && result.complementarity > kRounding; ++k) {
        double primal = 1, dual = 1, moment;
        run.newton(pb, state.view(), &level, nullptr);
        run.step_length(pb, state.view(), kKeep, &primal, &dual);
        if (std::min(primal, dual) < kNearlyFull) return;  // not so near as it seemed
        run.advance(pb, state.view(), &primal, &dual);
        weigh(state);
        run.residual(pb, state.view(), &level, &moment, &result.complementarity);
        result.residual = std::max(moment / moment_scale_, loads_ ? load_change_[0] : 0.0);
        ++result.iterations;
    }
}

// Corrects the step of every lane that may go as far with the correction as without.
void FrictionSolver::lengthen(LaneState& state, double* primal, double* dual) {
    const KernelProblem& pb = mesh_.problem();
    const KernelTable& run = kernel(state.lanes());
    alignas(kAlignment) double further[kMostLanes], dual_further[kMostLanes];
    bool take[kMostLanes];
    run.correct(pb, state.view(), state.corrected_view());
    run.step_length(pb, state.corrected_view(), kKeep, further, dual_further);
    for (int lane = 0; lane < state.lanes(); ++lane) {
        take[lane] = std::min(further[lane], dual_further[lane]) >= std::min(primal[lane], dual[lane]);
        if (!take[lane]) continue;
        primal[lane] = further[lane];
        dual[lane] = dual_further[lane];
    }
    state.take_corrected(take);
}

double FrictionSolver::largest_twist(const LaneState& state, int lane) const {
    const KernelProblem& pb = mesh_.problem();
    double most = 0;
    for (int node = 0; node < pb.nodes; ++node)
        for (int t = 0; t < pb.tubes; ++t) {
            const double twist = std::fabs(state.step(node, 5 * t, lane));
            most = twist <= most ? most : twist;  // a NaN stays
        }
    return most;
}

double FrictionSolver::imbalance(LaneState& state) {
    const double level = last_level();
    double moment, gap;
    converge_load_moments(state);
    const double bend_error = is_exact_ && state.is_exact() ? exact_->update(*this, state, 0) : 0.0;
    kernel(1).residual(mesh_.problem(), state.view(), &level, &moment, &gap);
    return std::max(moment, bend_error) / moment_scale_;
}

void FrictionSolver::factorise(LaneState& state) {
    alignas(kAlignment) double level[kMostLanes], damping[kMostLanes] = {};
    std::fill(level, level + kMostLanes, last_level());
    weigh(state);
    kernel(state.lanes()).newton(mesh_.problem(), state.view(), level, damping);
}

bool FrictionSolver::turns_away(const LaneState& state, int lane) const {
    const KernelProblem& pb = mesh_.problem();
    for (int k = 0; k < pb.nodes; ++k)
        for (int i = 0; i < pb.node_unknowns[k]; i += 5)
            if (state.inverse_pivot(k, i, lane) < 0) return true;
    return false;
}

}  // namespace ctr
