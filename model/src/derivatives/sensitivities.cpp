#include "ctr/sensitivities.hpp"

#include <algorithm>
#include <limits>

#include "contact/load_moments.hpp"
#include "derivatives/tip_gradient.hpp"

namespace ctr {

Sensitivities::Sensitivities() : gradient_(std::make_unique<TipGradient>()), loads_(std::make_unique<LoadMoments>()) {}
Sensitivities::~Sensitivities() = default;

TipDerivative TipDerivative::nowhere() {
    constexpr double nan = std::numeric_limits<double>::quiet_NaN();
    return {{nan, nan, nan}, {nan, nan, nan}};
}

void Sensitivities::set(const FrictionSolver& solver, const Configuration& q, const Direction& direction, double amount, Side& side) const {
    side.robot = solver.robot();
    side.q = q;
    numbers(side.robot, side.q, side.values);
    for (const auto& [index, weight] : direction.weights) *side.values[index] += amount * weight;
}

// Whether only base rotations change along a direction; joints are the last numbers.
bool Sensitivities::only_turns(const FrictionSolver& solver, const Direction& direction) const {
    const int count = static_cast<int>(plus_.values.size()), n = solver.robot().count();
    return std::all_of(direction.weights.begin(), direction.weights.end(),
                       [&](const auto& w) { return w.first >= count - 2 * n && w.first < count - n; });
}

// Where the directions lead, unless that is known already: friction states of one configuration follow one another.
void Sensitivities::prepare(const FrictionSolver& solver, const Configuration& q, const std::vector<Direction>& directions) {
    if (directions == directions_ && q.theta == q_.theta && q.l == q_.l && solver.mesh().s() == s_) return;
    directions_ = directions;
    q_ = q;
    s_ = solver.mesh().s();
    changes_.resize(directions.size());
    ways_.resize(directions.size());
    for (std::size_t j = 0; j < directions.size(); ++j) ways_[j] = read_change(solver, q, directions[j], changes_[j]);
}

Sensitivities::Way Sensitivities::read_change(const FrictionSolver& solver, const Configuration& q, const Direction& direction,
                                              NumberChange& change) {
    const KernelProblem& pb = solver.mesh().problem();
    const NumberLayout at(pb.tubes, pb.elements);
    change.clear();
    set(solver, q, direction, direction.step, plus_);
    if (only_turns(solver, direction)) {
        const int first = static_cast<int>(plus_.values.size()) - 2 * pb.tubes;
        for (const auto& [index, weight] : direction.weights)
            for (int place : {at.base, at.shaft_angle}) change.push_back({place + pb.tubes - 1 - (index - first), weight});
        return Way::gradient;
    }
    set(solver, q, direction, -direction.step, minus_);
    for (auto [side, row] : {std::pair{&plus_, &upper_}, {&minus_, &lower_}}) {
        if (!moved_.build_elements_like(solver.mesh(), side->robot, side->q)) return Way::none;
        read_numbers(moved_, side->robot, side->q, *row);
        const double unit = FrictionSolver::barrier_unit(side->robot) / FrictionSolver::barrier_unit(solver.robot());
        for (int p = 0; p < pb.tubes; ++p) (*row)[at.scale + p] *= unit;  // a barrier is level times scale
    }
    for (int i = 0; i < at.load; ++i)
        if (upper_[i] != lower_[i]) change.push_back({i, (upper_[i] - lower_[i]) / (2 * direction.step)});
    return plus_.robot.loaded() || minus_.robot.loaded() ? Way::loaded : Way::gradient;
}

// What a load that there is none of asks of the tubes, on the shape of this friction state.
void Sensitivities::add_loads(const FrictionSolver& solver, LaneState& state, const Configuration& q, const Direction& direction,
                              NumberChange& change) {
    const std::size_t count = state.load_moment_count();
    const int load = NumberLayout(solver.mesh().problem().tubes, solver.mesh().problem().elements).load;
    double unused;
    upper_moments_.assign(count, 0.0);
    for (const double amount : {direction.step, -direction.step}) {
        set(solver, q, direction, amount, plus_);
        loads_->update(solver, plus_.robot, state, solver.base_l(), &unused);
        for (std::size_t i = 0; i < count; ++i) upper_moments_[i] += state.load_moments()[i] / (2 * amount);
        std::fill_n(state.load_moments(), count, 0.0);
    }
    for (std::size_t i = 0; i < count; ++i)
        if (upper_moments_[i] != 0) change.push_back({load + static_cast<int>(i), upper_moments_[i]});
}

void Sensitivities::compute(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi,
                            const std::vector<Direction>& directions, std::vector<TipDerivative>& out) {
    if (!TipGradient::applies(solver, state)) return compute_each(solver, state, q, phi, directions, out);
    solver.factorise(state);
    prepare(solver, q, directions);
    if (std::any_of(ways_.begin(), ways_.end(), [](Way way) { return way != Way::none; })) gradient_->compute(solver, state, phi);
    out.assign(directions.size(), TipDerivative::nowhere());
    for (std::size_t j = 0; j < directions.size(); ++j) {
        if (ways_[j] == Way::none) continue;
        with_loads_ = changes_[j];
        if (ways_[j] == Way::loaded) add_loads(solver, state, q, directions[j], with_loads_);
        const TipValues by = gradient_->along(with_loads_);
        std::copy_n(by.value.begin(), 3, out[j].position.begin());
        std::copy_n(by.value.begin() + 3, 3, out[j].tangent.begin());
    }
}

}  // namespace ctr
