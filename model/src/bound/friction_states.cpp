// Single friction states, each from where it parts from the frictionless robot.
#include <algorithm>
#include <cmath>
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

// The part of each contact along its pair, from the plate to the end of the outer tube; what is behind the plate is in the first.
std::vector<int> BoundSolver::sections_of_contacts(int sections) const {
    const KernelProblem& pb = solver_.mesh().problem();
    std::vector<double> s(pb.contacts), end(pairs_, 0.0);
    for (int e = 0; e < pb.elements; ++e)
        for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k) {
            s[k] = solver_.mesh().s()[e] + pb.contact_xi[k] * pb.length[e];
            end[pb.contact_pair[k]] = std::max(end[pb.contact_pair[k]], s[k]);
        }
    std::vector<int> section(pb.contacts, 0);
    for (int k = 0; k < pb.contacts; ++k)
        if (s[k] > 0) section[k] = std::min(sections - 1, static_cast<int>(sections * s[k] / end[pb.contact_pair[k]]));
    return section;
}

FrictionlessStart BoundSolver::begin_states(const Configuration& q, const Accuracy& accuracy) {
    zero_.solve(solver_.robot(), q);
    prepare(q, accuracy);
    solve_frictionless();
    have_solution_ = false;
    FrictionlessStart start{q, accuracy, solver_.mesh(), {}, {}, {}, frictionless_convergence_, 0};
    if (shared_is_good_) start.shared = shared_.keep(0);
    else start.zero = zero_;
    solver_.stabilities(frictionless_, &start.stability);
    tracer_.trace(solver_, frictionless_, 0, 1, q.l.back(), &start.rest);
    return start;
}

// As begin_states() left the solver, wherever it has been since.
void BoundSolver::return_to(const FrictionlessStart& start) {
    q_ = start.q;
    accuracy_ = start.accuracy;
    multiple_ = have_solution_ = false;
    solver_.adopt(start.mesh, start.q, start.accuracy);
    shared_is_good_ = start.shared.has_value();
    if (!shared_is_good_) {
        zero_ = *start.zero;
        return;
    }
    shared_.resize(solver_.mesh().problem(), 1);
    shared_.put(*start.shared, solver_.mesh().problem());
}

void BoundSolver::solve_states(const FrictionlessStart& start, const FrictionStates& states,
                               const std::function<void(std::size_t row, const FrictionShape&)>& show) {
    return_to(start);
    const std::size_t rows = states.rows, numbers = static_cast<std::size_t>(states.sections) * pairs_;
    std::vector<std::size_t> with_friction;
    for (std::size_t row = 0; row < rows; ++row) {
        const double* own = states.phi + row * numbers;
        if (std::any_of(own, own + numbers, [](double value) { return value != 0; })) with_friction.push_back(row);
    }
    std::size_t shown = 0;
    auto show_rest_up_to = [&](std::size_t row) {
        for (; shown < row; ++shown) show(shown, {start.rest, start.convergence, start.stability});
    };
    const KernelProblem& pb = solver_.mesh().problem();
    LaneState& state = *batches_.front();
    const std::vector<int> section = sections_of_contacts(states.sections);
    auto set_phi = [&](LaneState& to, int lane, std::size_t row) {
        for (int k = 0; k < pb.contacts; ++k) {
            const int pair = pairs_ - 1 - pb.contact_pair[k];
            to.set_phi_mu(k, lane, states.phi[row * numbers + section[k] * pairs_ + pair] * solver_.robot().pairs[pair].friction);
        }
    };
    grant_far_steps(1);
    Convergence result[kMostLanes];
    Backbone shapes[kMostLanes];
    double stability[kMostLanes];
    for (std::size_t first = 0, next; first < with_friction.size(); first = next) {
        const int lanes = lanes_for(with_friction.size() - first);
        next = std::min(first + lanes, with_friction.size());
        const int count = static_cast<int>(next - first);
        auto row_of = [&](int lane) { return with_friction[first + std::min(lane, count - 1)]; };  // spare lanes repeat the last
        state.resize(pb, lanes);
        for (int lane = 0; lane < lanes; ++lane) set_phi(state, lane, row_of(lane));
        const BarrierPath path = set_out(state);
        solver_.solve(state, path, result);
        solver_.stabilities(state, stability);
        for (int lane = 0; lane < count; ++lane) {
            if (result[lane].converged) continue;
            trial_.resize(pb, 1);
            set_phi(trial_, 0, row_of(lane));
            const BarrierPath again = set_out(trial_);
            reach_far(trial_, again.first, result[lane]);
            if (result[lane].converged) solver_.stabilities(trial_, &stability[lane]);
            solver_.copy(trial_, state, lane);
        }
        tracer_.trace(solver_, state, 0, count, start.q.l.back(), shapes);
        for (int lane = 0; lane < count; ++lane) {
            show_rest_up_to(row_of(lane));
            show(shown++, {shapes[lane], result[lane], stability[lane]});
        }
    }
    show_rest_up_to(rows);
}

void BoundSolver::solve_from(const Configuration& q, const Accuracy& accuracy, const GivenShapes& given,
                             const std::function<void(const FrictionShape&, std::vector<double>&& theta)>& show) {
    prepare(q, accuracy);
    have_solution_ = false;
    const KernelProblem& pb = solver_.mesh().problem();
    LaneState& state = *batches_.front();
    const BarrierPath path = BarrierPath::cold(solver_.last_barrier());
    Configuration turned = q;
    Convergence result[kMostLanes];
    Backbone shapes[kMostLanes];
    double stability[kMostLanes], level[kMostLanes];
    for (std::size_t first = 0, next; first < given.rows; first = next) {
        const int lanes = lanes_for(given.rows - first);
        next = std::min(first + lanes, given.rows);
        const int count = static_cast<int>(next - first);
        state.resize(pb, lanes);
        const auto angles = [&](int lane) {
            return GivenAngles{given.s, given.theta + (first + lane) * (pairs_ + 1) * given.count, given.count};
        };
        for (int lane = 0; lane < lanes; ++lane) {
            const int own = std::min(lane, count - 1);  // spare lanes repeat the last
            state.set_phi(solver_.robot(), pb, lane, given.phi + (first + own) * pairs_);
            std::copy_n(given.base + (first + own) * (pairs_ + 1), pairs_ + 1, turned.theta.begin());
            solver_.start_lane(state, lane, turned, angles(own), path.first);
        }
        solver_.find_levels(state, path, level);
        solver_.solve(state, path, result, level);
        solver_.stabilities(state, stability);
        tracer_.trace(solver_, state, 0, count, q.l.back(), shapes);
        for (int lane = 0; lane < count; ++lane) {
            std::vector<double> theta;
            solver_.read_angles(state, lane, angles(lane), theta);
            if (solver_.turns_away(state, lane)) stability[lane] = -std::fabs(stability[lane]);
            show({shapes[lane], result[lane], stability[lane]}, std::move(theta));
        }
    }
}

}  // namespace ctr
