#include "ctr/friction.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "ctr/loads.hpp"

namespace ctr {
namespace {

constexpr double kFirstDamping = 30;      // 1/m^2, about the lowest torsional mode of a 0.2 m tube
constexpr double kLeastDamping = 3, kMostDamping = 1e7;
constexpr double kTrust = 0.3;            // rad that a step in time may turn a tube
constexpr double kSettled = 1e-3;         // rad, last Newton step of a step in time
constexpr double kAtRest = 0.01;          // rad, a step in time after which equilibrium is near
constexpr int kSlidingSteps = 3000;       // Newton steps in all
constexpr double kKeep = 0.98;            // fraction of the way to the boundary
constexpr double kNearlyFull = 0.99;      // of a step, below which no residual vanishes
constexpr double kMaxTwistStep = 0.6;     // rad
constexpr double kResidual = 1e-8;        // of EI * precurvature
constexpr double kWeighed = 1e-12;        // of the moments of loads: their last change
constexpr double kExactLevel = 0.1;       // barrier level, see BarrierPath, below which exact geometry matters
constexpr double kExactComplementarity = 0.03;  // of a barrier ten to a hundred times lower
constexpr int kExactSteps = 40;           // more, since convergence is linear
constexpr double kHardClearance = 3e-3;   // of the innermost tube's length. The tip error of the barrier goes with the
                                          // clearance, rounding in the gaps with its inverse: smaller ones get a softer barrier
constexpr double kComplementarity = 1e-3; // of the last barrier level, itself far below any contact force

}  // namespace

FrictionSolver::FrictionSolver(const Robot& robot) : robot_(robot) {
    if (robot.loaded()) loads_ = std::make_shared<LoadMoments>();
}

void FrictionSolver::weigh(LaneState& state) {
    if (loads_) loads_->update(*this, state, base_l_, load_change_.data());
}

void FrictionSolver::build(const Configuration& q, const Accuracy& accuracy) {
    mesh_.build(robot_, q, accuracy);
    scale(q, accuracy);
}

void FrictionSolver::adopt(const Mesh& mesh, const Configuration& q, const Accuracy& accuracy) {
    mesh_ = mesh;
    scale(q, accuracy);
}

void FrictionSolver::scale(const Configuration& q, const Accuracy& accuracy) {
    base_l_ = q.l.back();
    last_barrier_ = accuracy.barrier;
    is_exact_ = accuracy.exact;
    if (is_exact_) {
        double clearance = 0;
        for (const Pair& pair : robot_.pairs) clearance = std::max(clearance, pair.clearance);
        const double hard = kHardClearance * robot_.tubes.back().length();
        if (clearance > 0) last_barrier_ *= std::clamp(hard / clearance, 1.0, 10.0);
        exact_.build(*this, q);
    }
    moment_scale_ = 1e-9;
    for (const Tube& tube : robot_.tubes)
        for (const Section& section : tube.sections)
            moment_scale_ = std::max(moment_scale_, tube.bending_stiffness * std::hypot(section.curvature_x, section.curvature_y));
    const double length = robot_.tubes.back().length();
    barrier_unit_ = moment_scale_ / (length * length);
}

// Steps are scaled by what the last two say of the slowest mode (Aitken), per lane: by themselves they go astray where a load
// bends as much as the tube resists.
void FrictionSolver::weigh_out(LaneState& state) {
    constexpr int kMost = 100;
    constexpr double kLeast = 0.02, kLongest = 20;
    const std::size_t lanes = state.lanes(), count = state.load_moment_count();
    double share[kLanes];
    std::fill(share, share + kLanes, 1.0);
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

bool FrictionSolver::move(const FrictionSolver& from, const Robot& robot, const Configuration& q) {
    robot_ = robot;
    moment_scale_ = from.moment_scale_;
    barrier_unit_ = from.barrier_unit_;
    last_barrier_ = from.last_barrier_;
    base_l_ = q.l.back();
    if (!robot.loaded()) loads_ = nullptr;
    else if (!loads_) loads_ = std::make_shared<LoadMoments>();
    return mesh_.move(from.mesh_, robot, q);
}

bool FrictionSolver::move_along(const Configuration& q) {
    base_l_ = q.l.back();
    std::swap(mesh_, left_);
    if (mesh_.move(left_, robot_, q)) return true;
    std::swap(mesh_, left_);
    return false;
}

void FrictionSolver::factorise(LaneState& state) {
    alignas(kAlignment) double level[kLanes], damping[kLanes] = {};
    std::fill(level, level + kLanes, last_level());
    weigh(state);
    kernel(state.lanes()).newton(mesh_.problem(), state.view(), level, damping);
}

void FrictionSolver::start(LaneState& state, const Configuration& q, const ZeroClearance& guess, double level) {
    const KernelProblem& pb = mesh_.problem();
    const int n = robot_.count();
    state.forget_exact();
    for (int lane = 0; lane < state.lanes(); ++lane) {
        for (int k = 0; k < pb.nodes; ++k) {
            for (int i = 0; i < pb.stride; ++i) state.unknown(k, i, lane) = 0;
            for (int t = 0; t < n; ++t)
                state.unknown(k, 5 * t, lane) = k <= pb.shaft_node[t] ? q.theta[n - 1 - t] : guess.theta(t, mesh_.s()[k]);
        }
        for (int k = 0; k < pb.contacts; ++k) {
            const int p = pb.contact_pair[k];
            state.slack(k, lane) = pb.half_square_clearance[p];
            state.multiplier(k, lane) = level * barrier_unit_ * pb.barrier_scale[p] * pb.contact_weight[k] / pb.half_square_clearance[p];
        }
    }
}

void FrictionSolver::spread(const LaneState& from, LaneState& to) const {
    for (int lane = 0; lane < to.lanes(); ++lane) copy(from, to, lane);
}

void FrictionSolver::copy(const LaneState& from, LaneState& to, int lane) const {
    const KernelProblem& pb = mesh_.problem();
    for (int k = 0; k < pb.nodes; ++k)
        for (int i = 0; i < pb.stride; ++i) to.unknown(k, i, lane) = from.unknown(k, i, 0);
    for (int k = 0; k < pb.contacts; ++k) {
        to.multiplier(k, lane) = from.multiplier(k, 0);
        to.slack(k, lane) = from.slack(k, 0);
    }
    to.copy_exact(from, pb, lane);
}

void FrictionSolver::recentre(LaneState& state, double level) {
    const KernelProblem& pb = mesh_.problem();
    for (int k = 0; k < pb.contacts; ++k) {
        const double eps = level * barrier_unit_ * pb.barrier_scale[pb.contact_pair[k]] * pb.contact_weight[k];
        const double balanced = std::sqrt(eps);
        for (int lane = 0; lane < state.lanes(); ++lane) {
            double &lambda = state.multiplier(k, lane), &w = state.slack(k, lane);
            if (lambda * pb.half_square_clearance[pb.contact_pair[k]] > eps && lambda * balanced > w) w = eps / lambda;  // in contact: keep the force
            else lambda = eps / w;
        }
    }
}

void FrictionSolver::set_base(LaneState& state, const Configuration& q) {
    const KernelProblem& pb = mesh_.problem();
    for (int k = 0; k < pb.nodes; ++k)
        for (int t = 0; t < pb.tubes; ++t) {
            // by node: where breaks were merged, a collar and the node it became stand at different arc lengths
            if (k > pb.shaft_node[t] || 5 * t < pb.node_unknowns[k]) continue;  // an unknown there
            for (int lane = 0; lane < state.lanes(); ++lane) state.unknown(k, 5 * t, lane) = q.theta[pb.tubes - 1 - t];
        }
}

void FrictionSolver::solve(LaneState& state, const BarrierPath& path, Convergence* result) {
    const KernelProblem& pb = mesh_.problem();
    if (is_exact_ && !state.is_exact()) state.begin_exact(pb);
    const int lanes = state.lanes();
    const KernelTable& run = kernel(lanes);
    alignas(kAlignment) double level[kLanes], primal[kLanes], dual[kLanes], moment[kLanes], gap[kLanes];
    double bend_error[kLanes] = {};
    bool done[kLanes] = {};
    const double last = path.last * barrier_unit_;
    for (int lane = 0; lane < lanes; ++lane) {
        level[lane] = path.first * barrier_unit_;
        result[lane] = {};
        result[lane].residual = result[lane].complementarity = std::numeric_limits<double>::infinity();
    }
    weigh(state);
    auto update = [&] {
        for (int lane = 0; is_exact_ && lane < lanes; ++lane)
            if (!done[lane] && level[lane] < kExactLevel * barrier_unit_) bend_error[lane] = exact_.update(*this, state, lane);
    };
    update();
    const int most = path.max_steps + (is_exact_ ? kExactSteps : 0);
    const double centred = is_exact_ ? kExactComplementarity : kComplementarity;
    for (int k = 0; k < most; ++k) {
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
        else weigh_out(state);  // no contact whose imbalance would show that a load still changes the shape
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
            const bool weighed = !loads_ || load_change_[lane] < kResidual;  // NaN is not
            if (level[lane] <= last && result[lane].residual < kResidual && gap[lane] < centred && weighed)
                done[lane] = result[lane].converged = true;
            all = all && done[lane];
        }
        if (all) return;
    }
}

// Corrects the step of every lane that may go as far with the correction as without.
void FrictionSolver::lengthen(LaneState& state, double* primal, double* dual) {
    const KernelProblem& pb = mesh_.problem();
    const KernelTable& run = kernel(state.lanes());
    alignas(kAlignment) double further[kLanes], dual_further[kLanes];
    bool take[kLanes];
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

// Newton steps at one level, until they are full and small; false if they do not become so.
bool FrictionSolver::settle(LaneState& state, double level, double damping, int& steps) {
    constexpr int kMost = 16;
    const KernelProblem& pb = mesh_.problem();
    const KernelState view = state.view(&kept_);
    const KernelTable& run = kernel(1);
    const double barrier = level * barrier_unit_;
    for (int k = 0; k < kMost; ++k) {
        double primal, dual;
        run.newton(pb, view, &barrier, &damping);
        ++steps;
        const double twist = largest_twist(state, 0);
        if (!(twist < 1e6)) return false;
        run.step_length(pb, view, kKeep, &primal, &dual);
        primal = std::min(primal, kMaxTwistStep / std::max(twist, 1e-12));
        run.advance(pb, view, &primal, &dual);
        weigh(state);
        if (moved(state) > 2 * kTrust) return false;
        if (twist < kSettled && std::min(primal, dual) > 0.999) return true;
    }
    return false;
}

void FrictionSolver::reach(LaneState& state, double level, Convergence& result) {
    if (robot_.softens()) {
        begun_.resize(mesh_.problem(), 1);
        copy(state, begun_, 0);
        if (ease(state, level, result)) return;
        copy(begun_, state, 0);
        weigh(state);
    }
    slide(state, level, result);
}

// From tubes that bend linearly to those that soften, each solution from the one before, with the softening kept where the
// next one is not reached. Newton's method alone runs in circles around the knees of many sections.
bool FrictionSolver::ease(LaneState& state, double level, Convergence& result) {
    constexpr double kFirst = 0.25, kLeast = 1.0 / 128, kMotion = 10;
    const KernelProblem& pb = mesh_.problem();
    kept_.resize(pb, 1);
    mesh_.soften(robot_, 0);
    solve(state, BarrierPath{level, last_barrier_}, &result);
    Convergence reached = result;
    int steps = result.iterations;
    double share = 0, ahead = kFirst;
    while (reached.converged && share < 1 && ahead >= kLeast) {
        const double next = std::min(1.0, share + ahead);
        copy(state, kept_, 0);
        mesh_.soften(robot_, next);
        const BarrierPath path = BarrierPath::warm(kMotion * ahead / kFirst, last_barrier_);
        recentre(state, path.first);
        solve(state, path, &result);
        steps += result.iterations;
        if (result.converged) {
            reached = result;
            share = next;
            ahead *= 1.5;
        } else {
            copy(kept_, state, 0);
            ahead *= 0.5;
        }
    }
    mesh_.soften(robot_, 1);
    result = reached;
    result.converged = reached.converged && share == 1;
    result.iterations = steps;
    return result.converged;
}

void FrictionSolver::slide(LaneState& state, double level, Convergence& result) {
    const KernelProblem& pb = mesh_.problem();
    double damping = 0;
    int steps = 0, saddles = 0, wait = 0, patience = 1;  // steps in time before equilibrium is asked for again
    result = {};
    result.residual = result.complementarity = std::numeric_limits<double>::infinity();  // until equilibrium is reached
    kept_.resize(pb, 1);
    while (steps < kSlidingSteps && damping < kMostDamping) {
        copy(state, kept_, 0);
        const bool settled = settle(state, level, damping, steps) && moved(state) < kTrust;
        const bool saddle = settled && damping == 0 && turns_away(state, 0) && ++saddles < 5;
        if (!settled || saddle) {
            copy(kept_, state, 0);
            weigh(state);
            if (damping == 0) wait = patience = std::min(2 * patience, 64);
            damping = std::max(kFirstDamping, 3 * damping);
            continue;
        }
        --wait;
        if (damping == 0) {
            if (level <= (is_exact_ ? std::max(kExactLevel, last_barrier_) : last_barrier_)) {
                solve(state, {level, last_barrier_}, &result);
                break;
            }
            level = std::max(last_barrier_, 0.2 * level);
            patience = 1;
        } else if (moved(state) < kAtRest && damping <= kFirstDamping && wait <= 0) {
            damping = 0;
        } else if (moved(state) < 0.5 * kTrust) {
            damping = std::max(kLeastDamping, 0.4 * damping);
        }
    }
    result.iterations += steps;
}

double FrictionSolver::moved(const LaneState& state) const {
    const KernelProblem& pb = mesh_.problem();
    double most = 0;
    for (int node = 0; node < pb.nodes; ++node)
        for (int t = 0; t < pb.tubes; ++t)
            most = std::max(most, std::fabs(state.unknown(node, 5 * t, 0) - kept_.unknown(node, 5 * t, 0)));
    return most;
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

bool FrictionSolver::turns_away(const LaneState& state, int lane) const {
    const KernelProblem& pb = mesh_.problem();
    for (int k = 0; k < pb.nodes; ++k)
        for (int i = 0; i < pb.node_unknowns[k]; i += 5)
            if (state.inverse_pivot(k, i, lane) < 0) return true;
    return false;
}

}  // namespace ctr
