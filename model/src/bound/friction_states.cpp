// Single friction states, each solved from scratch.
#include <algorithm>
#include <vector>

#include "ctr/bound.hpp"

namespace ctr {

void BoundSolver::solve_single(const Configuration& q, const Accuracy& accuracy, const std::vector<double>& phi) {
    zero_.solve(solver_.robot(), q);
    prepare(q, accuracy);
    solve_frictionless();
    have_solution_ = false;
    search_others();
    if (std::all_of(phi.begin(), phi.end(), [](double value) { return value == 0; })) return;
    const KernelProblem& pb = solver_.mesh().problem();
    frictionless_.set_phi(solver_.robot(), pb, 0, phi.data());
    const BarrierPath path = set_out(frictionless_);
    solver_.solve(frictionless_, path, &frictionless_convergence_);
    if (frictionless_convergence_.converged) return;
    set_out(frictionless_);
    solver_.reach(frictionless_, path.first, frictionless_convergence_);
}

void BoundSolver::solve_states(const Configuration& q, const Accuracy& accuracy, const double* phi, std::size_t rows,
                               const std::function<void(std::size_t row, const FrictionShape&)>& show) {
    zero_.solve(solver_.robot(), q);
    prepare(q, accuracy);
    solve_frictionless();
    have_solution_ = false;
    std::vector<std::size_t> with_friction;
    for (std::size_t row = 0; row < rows; ++row) {
        const double* own = phi + row * pairs_;
        if (std::any_of(own, own + pairs_, [](double value) { return value != 0; })) with_friction.push_back(row);
    }
    Backbone rest;  // known already: a lane of its own would cost as much as any other
    double rest_stability = 0;
    if (with_friction.size() < rows) {
        solver_.stabilities(frictionless_, &rest_stability);
        tracer_.trace(solver_, frictionless_, 0, 1, q.l.back(), &rest);
    }
    std::size_t shown = 0;
    auto show_rest_up_to = [&](std::size_t row) {
        for (; shown < row; ++shown) show(shown, {rest, frictionless_convergence_, rest_stability});
    };
    const KernelProblem& pb = solver_.mesh().problem();
    LaneState& state = *batches_.front();
    grant_far_steps();
    Convergence result[kLanes];
    Backbone shapes[kLanes];
    double stability[kLanes];
    for (std::size_t first = 0; first < with_friction.size(); first += kLanes) {
        const int count = static_cast<int>(std::min<std::size_t>(kLanes, with_friction.size() - first));
        auto row_of = [&](int lane) { return with_friction[first + std::min(lane, count - 1)]; };  // spare lanes repeat the last
        auto phi_of = [&](int lane) { return phi + row_of(lane) * pairs_; };
        state.resize(pb, kLanes);
        for (int lane = 0; lane < kLanes; ++lane) state.set_phi(solver_.robot(), pb, lane, phi_of(lane));
        const BarrierPath path = set_out(state);
        solver_.solve(state, path, result);
        solver_.stabilities(state, stability);
        for (int lane = 0; lane < count; ++lane) {
            if (result[lane].converged) continue;
            trial_.resize(pb, 1);
            trial_.set_phi(solver_.robot(), pb, 0, phi_of(lane));
            const BarrierPath again = set_out(trial_);
            reach_far(trial_, again.first, result[lane]);
            if (result[lane].converged) solver_.stabilities(trial_, &stability[lane]);
            solver_.copy(trial_, state, lane);
        }
        tracer_.trace(solver_, state, 0, count, q.l.back(), shapes);
        for (int lane = 0; lane < count; ++lane) {
            show_rest_up_to(row_of(lane));
            show(shown++, {shapes[lane], result[lane], stability[lane]});
        }
    }
    show_rest_up_to(rows);
}

}  // namespace ctr
