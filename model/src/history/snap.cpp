// Path history past a fold: where the robot goes when no equilibrium is near.
#include "ctr/history.hpp"

#include <algorithm>
#include <cmath>

#include "bound/carried_state.hpp"
#include "history/put_back.hpp"

namespace ctr {
void History::hold(const std::vector<double>& phi) {
    const KernelProblem& pb = solver_.mesh().problem();
    state_.follow_slip(nullptr);
    for (int k = 0; k < pb.contacts; ++k)
        state_.set_phi_mu(k, 0, std::clamp(phi[k], -1.0, 1.0) * solver_.robot().pairs[pb.tubes - 2 - pb.contact_pair[k]].friction);
}

// Where the robot goes while friction is held.
bool History::slide_with(const std::vector<double>& phi) {
    hold(phi);
    solver_.recentre(state_, BarrierPath::kSoft);
    solver_.slide(state_, BarrierPath::kSoft, convergence_);
    return has_factors_ = convergence_.converged;
}

bool History::solve_beside(const std::vector<double>& phi, Backbone& backbone) {
    return put_back_if_interrupted([&] { return go_beside(phi, backbone); });
}

bool History::go_beside(const std::vector<double>& phi, Backbone& backbone) {
    constexpr double kSmallestPart = 0.01;
    const State kept = save();
    const KernelProblem& pb = solver_.mesh().problem();
    const int pairs = pb.tubes - 1;
    std::vector<double> now(pb.contacts);
    double done = 0, part = 0.25;
    bool found = true;
    while (done < 1 && found) {
        const double next = std::min(1.0, done + part);
        const Iterate at = iterate();
        remember();
        for (int k = 0; k < pb.contacts; ++k) now[k] = (1 - next) * kept.phi[k] + next * phi[pairs - 1 - pb.contact_pair[k]];
        hold(now);
        const BarrierPath path = BarrierPath::warm(5, solver_.last_barrier());
        solver_.recentre(state_, path.first);
        solver_.solve(state_, path, &convergence_);
        if (convergence_.converged && largest_turn(q_) < 2 * kLargestTurn) {
            done = next;
            continue;
        }
        put(at);
        part *= 0.5;
        found = part > kSmallestPart;
    }
    if (found) tracer_.trace(solver_, state_, 0, 1, q_.l.back(), &backbone);
    found = found && !solver_.turns_away(state_);
    restore(kept);
    return found;
}

// Friction that belongs to the slip so far.
std::vector<double> History::followed_phi() const {
    const KernelProblem& pb = solver_.mesh().problem();
    std::vector<double> phi(pb.contacts);
    for (int e = 0; e < pb.elements; ++e)
        for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k) {
            const double trial = last_phi_[k] + slip_of(e, k) / options_.breakaway;
            phi[k] = trial / std::max(1.0, std::hypot(trial, next_psi_[k]));
        }
    return phi;
}

// No equilibrium near by: friction as it was, the robot slides to where there is one, and friction follows that slip,
// by parts if it must. Where friction and shape do not settle on each other, the shape has the friction of the last part.
bool History::slide(const Configuration& q) {
    constexpr int kRounds = 8;
    carried_->give(solver_.mesh(), state_);
    solver_.set_base(state_, q);
    std::vector<double> phi = last_phi_;
    if (!slide_with(phi)) {  // from the shape that the robot has when it is put there afresh, without friction
        const std::vector<double> none(solver_.robot().pairs.size() + 1, 0.0);
        if (starter_.solve(q, accuracy_, none) == Status::failed) return false;
        solver_.build(q, accuracy_);
        built_breaks_ = solver_.mesh().breaks();
        state_.resize(solver_.mesh().problem(), 1);
        refer(q);
        phi.assign(solver_.mesh().problem().contacts, 0.0);
        hold(phi);
        solver_.spread(starter_.state(), state_);
        has_factors_ = false;
        convergence_ = starter_.convergence();
    }
    for (int round = 0; round < kRounds; ++round) {
        const Iterate slid = iterate();
        const Convergence held = convergence_;
        state_.follow_slip(&law_);
        solver_.recentre(state_, 1);
        solver_.solve(state_, BarrierPath::warm(10, solver_.last_barrier()), &convergence_);
        if (convergence_.converged) return has_factors_ = true;
        put(slid);
        convergence_ = held;
        const std::vector<double> goal = followed_phi(), last = phi;
        for (std::size_t k = 0; k < phi.size(); ++k) phi[k] += (round < 2 ? 1.0 : 0.4) * (goal[k] - phi[k]);
        if (!slide_with(phi)) {
            put(slid);
            hold(last);
            convergence_ = held;
            break;
        }
    }
    return held_ = true;
}

}  // namespace ctr
