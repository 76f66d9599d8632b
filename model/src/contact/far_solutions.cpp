// Solutions that Newton's method does not reach by itself: by easing softening in, or by sliding as the robot would.
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

constexpr double kFirstDamping = 30;      // 1/m^2, about the lowest torsional mode of a 0.2 m tube
constexpr double kLeastDamping = 3;
constexpr double kTrust = 0.3;            // rad that a step in time may turn a tube
constexpr double kSettled = 1e-3;         // rad, last Newton step of a step in time
constexpr double kAtRest = 0.01;          // rad, a step in time after which equilibrium is near
constexpr int kShortSlide = 400;          // that most slides need, before other ways are tried

}  // namespace

struct FrictionSolver::SlideState {
    double level, damping = 0;
    int saddles = 0, wait = 0, patience = 1;  // wait: steps in time before equilibrium is asked for again
};

bool FrictionSolver::reach(LaneState& state, double level, Convergence& result, int most_steps) {
    begun_.resize(mesh_.problem(), 1);
    copy(state, begun_, 0);
    int steps = 0;
    bool is_first = true, overtwists = false;
    auto goes = [&](auto way) {  // from where it began
        if (steps >= most_steps) return false;
        if (!is_first) {
            copy(begun_, state, 0);
            weigh(state);
        }
        is_first = false;
        way();
        steps += result.iterations;
        overtwists = overtwists || result.overtwisted;
        return result.converged;
    };
    auto eases = [&] { return robot_.softens() && goes([&] { ease(state, level, result); }); };
    SlideState at{level};
    auto slides = [&](int most) { return goes([&] { slide_on(state, at, result, std::min(most, most_steps - steps)); }); };
    auto slides_on = [&] {
        return at.damping < kMostDamping && goes([&] {
            copy(slid_, state, 0);
            weigh(state);
            slide_on(state, at, result, most_steps - steps);
        });
    };
    auto loads = [&] { return goes([&] { load_friction(state, level, result, most_steps - steps); }); };
    bool found;
    if (loads_first_) {
        found = eases() || loads() || slides(most_steps);
    } else {
        found = eases() || slides(kShortSlide);
        if (!found) {
            slid_.share_steps(begun_);
            slid_.resize(mesh_.problem(), 1);
            copy(state, slid_, 0);
        }
        if (!found && (loads_first_ = loads())) found = true;
        found = found || (!overtwists && slides_on());
    }
    result.iterations = steps;
    result.overtwisted = overtwists && !found;
    return result.converged = found;
}

// From no friction to all of it, each solution from the one before, by shorter steps where the next one is not reached.
bool FrictionSolver::load_friction(LaneState& state, double level, Convergence& result, int most_steps) {
    constexpr double kFirst = 0.5, kLeast = 1.0 / 64, kMotion = 10, kNearly = 0.9;
    const KernelProblem& pb = mesh_.problem();
    std::vector<double> whole(pb.contacts);
    double most = 0;
    for (int k = 0; k < pb.contacts; ++k) most = std::max(most, std::fabs(whole[k] = state.phi_mu(k, 0)));
    auto load = [&](double share) {
        for (int k = 0; k < pb.contacts; ++k) state.set_phi_mu(k, 0, share * whole[k]);
    };
    if (most == 0) return false;
    kept_.resize(pb, 1);
    load(0);
    solve(state, BarrierPath{level, last_barrier_}, &result);
    int steps = result.iterations;
    double share = 0, ahead = kFirst, too_far = 1;  // too_far: the last step that was not reached
    for (bool reached = result.converged; reached && share < 1 && ahead >= kLeast && steps < most_steps;) {
        const double next = std::min(1.0, share + ahead);
        copy(state, kept_, 0);
        load(next);
        const BarrierPath path = BarrierPath::warm(kMotion * ahead / kFirst, last_barrier_);
        recentre(state, path.first);
        solve(state, path, &result);
        steps += result.iterations;
        if (result.converged) {
            share = next;
            ahead = std::min(1.5 * ahead, kNearly * too_far);
        } else {
            copy(kept_, state, 0);
            too_far = next - share;
            ahead = 0.5 * too_far;
        }
    }
    load(1);
    result.converged = share == 1;
    result.iterations = steps;
    return result.converged;
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

void FrictionSolver::slide(LaneState& state, double level, Convergence& result, int most_steps) {
    SlideState at{level};
    slide_on(state, at, result, most_steps);
}

void FrictionSolver::slide_on(LaneState& state, SlideState& at, Convergence& result, int most_steps) {
    const KernelProblem& pb = mesh_.problem();
    auto& [level, damping, saddles, wait, patience] = at;
    int steps = 0;
    result = {};
    result.residual = result.complementarity = std::numeric_limits<double>::infinity();  // until equilibrium is reached
    kept_.resize(pb, 1);
    while (steps < most_steps && damping < kMostDamping) {
        copy(state, kept_, 0);
        const bool settled = settle(state, level, damping, steps) && moved(state) < kTrust;
        const bool saddle = settled && damping == 0 && turns_away(state, 0) && ++saddles < 5;
        if (settled && largest_shear(state) > kMostShear) {
            result.overtwisted = true;
            break;
        }
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

// Newton steps at one level, until they are full and small; false if they do not become so.
bool FrictionSolver::settle(LaneState& state, double level, double damping, int& steps) {
    const KernelProblem& pb = mesh_.problem();
    const KernelState view = state.view(&kept_);
    const KernelTable& run = kernel(1);
    const double barrier = level * barrier_unit_;
    for (int k = 0; k < kMostAtLevel; ++k) {
        Watch::look();
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

double FrictionSolver::moved(const LaneState& state) const {
    const KernelProblem& pb = mesh_.problem();
    double most = 0;
    for (int node = 0; node < pb.nodes; ++node)
        for (int t = 0; t < pb.tubes; ++t)
            most = std::max(most, std::fabs(state.unknown(node, 5 * t, 0) - kept_.unknown(node, 5 * t, 0)));
    return most;
}

double FrictionSolver::largest_shear(const LaneState& state) const {
    const KernelProblem& pb = mesh_.problem();
    double most = 0;
    for (int e = 0; e < pb.elements; ++e)
        for (int t = 0; t < pb.element_tubes[e]; ++t)
            most = std::max(most, pb.outer_radius[t] * std::fabs(state.unknown(e + 1, 5 * t, 0) - state.unknown(e, 5 * t, 0)) / pb.length[e]);
    return most;
}

}  // namespace ctr
