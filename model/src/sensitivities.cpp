#include "ctr/sensitivities.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

namespace ctr {
namespace {

constexpr int kMaxLoadSteps = 60;
constexpr double kLoadTolerance = 1e-6;  // of the largest change
constexpr double kMomentNoise = 1e-13;    // of EI * precurvature, from rounding
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr TipDerivative kNowhere{{kNaN, kNaN, kNaN}, {kNaN, kNaN, kNaN}};

}  // namespace

std::vector<std::string> number_names(const Robot& robot) {
    std::vector<std::string> names;
    const int n = robot.count();
    for (int i = 0; i < n; ++i) {
        const std::string tube = "tube." + std::to_string(i + 1) + ".";
        for (const char* name : {"outer_radius", "inner_radius", "bending_stiffness", "torsional_stiffness", "ovality", "ovality_axis",
                                 "softening_strain", "softening_fraction", "shaft_compliance", "mass_per_length"})
            names.push_back(tube + name);
        for (std::size_t k = 0; k < robot.tubes[i].sections.size(); ++k)
            for (const char* name : {"length", "curvature_x", "curvature_y", "gradient"})
                names.push_back(tube + "section." + std::to_string(k + 1) + "." + name);
    }
    for (int i = 0; i + 1 < n; ++i)
        for (const char* name : {"clearance", "friction", "outer_inner_radius", "inner_outer_radius"})
            names.push_back("pair." + std::to_string(i + 1) + "." + name);
    for (const char* name : {"tip_force", "tip_moment", "gravity"})
        for (int k = 1; k <= 3; ++k) names.push_back(std::string("loads.") + name + "." + std::to_string(k));
    for (const char* name : {"theta_b.", "l_b."})
        for (int i = 1; i <= n; ++i) names.push_back(name + std::to_string(i));
    return names;
}

void numbers(Robot& robot, Configuration& q, std::vector<double*>& all) {
    all.clear();
    for (Tube& t : robot.tubes) {
        for (double* value : {&t.outer_radius, &t.inner_radius, &t.bending_stiffness, &t.torsional_stiffness, &t.ovality, &t.ovality_axis,
                              &t.softening_strain, &t.softening_fraction, &t.shaft_compliance, &t.mass_per_length})
            all.push_back(value);
        for (Section& s : t.sections)
            for (double* value : {&s.length, &s.curvature_x, &s.curvature_y, &s.gradient}) all.push_back(value);
    }
    for (Pair& p : robot.pairs)
        for (double* value : {&p.clearance, &p.friction, &p.outer_inner_radius, &p.inner_outer_radius}) all.push_back(value);
    for (double* vector : {robot.loads.tip_force, robot.loads.tip_moment, robot.loads.gravity})
        for (int k = 0; k < 3; ++k) all.push_back(vector + k);
    for (double& value : q.theta) all.push_back(&value);
    for (double& value : q.l) all.push_back(&value);
}

Frame Sensitivities::tip(const FrictionSolver& solver, LaneState& state) {
    tracer_.trace(solver, state, 0, 1, solver.base_l(), &backbone_);
    return backbone_.frame.back();
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

bool Sensitivities::shift(FrictionSolver& solver, const Configuration& q, const Direction& direction, double amount, Side& side) const {
    set(solver, q, direction, amount, side);
    if (only_turns(solver, direction) &&
        std::all_of(side.robot.tubes.begin(), side.robot.tubes.end(), [](const Tube& t) { return t.shaft_compliance == 0; })) {
        side.solver = &solver;
        return true;
    }
    if (!side.own) side.own = std::make_unique<FrictionSolver>(solver.robot());
    side.solver = side.own.get();
    return side.own->move(solver, side.robot, side.q);
}

// Whether the robot carries loads, or would along one of the directions.
bool Sensitivities::loads(const FrictionSolver& solver, const Configuration& q, const std::vector<Direction>& directions) {
    return solver.robot().loaded() || std::any_of(directions.begin(), directions.end(), [&](const Direction& direction) {
               set(solver, q, direction, direction.step, plus_);
               return plus_.robot.loaded();
           });
}

// With multiplier times gap on the barrier: of every contact where the unknowns are.
void Sensitivities::measure_multiplier_change(const LaneState& state, double step) {
    if (plus_.solver == minus_.solver) {  // neither gaps nor barriers know base rotations
        std::fill(multiplier_change_.begin(), multiplier_change_.end(), 0.0);
        return;
    }
    measure_gaps(state, plus_);
    measure_gaps(state, minus_);
    for (std::size_t k = 0; k < multiplier_change_.size(); ++k) {
        const double gap = (plus_.gap[k] - minus_.gap[k]) / (2 * step), barrier = (plus_.barrier[k] - minus_.barrier[k]) / (2 * step);
        multiplier_change_[k] = (barrier - multiplier_[k] * gap) / state.slack(static_cast<int>(k), 0);
    }
}

// Gaps and barriers of the contact points where the unknowns are.
void Sensitivities::measure_gaps(const LaneState& state, Side& side) const {
    const KernelProblem& pb = side.solver->mesh().problem();
    const double level = side.solver->last_level();
    side.gap.resize(pb.contacts);
    side.barrier.resize(pb.contacts);
    for (int e = 0; e < pb.elements; ++e)
        for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k) {
            const int p = pb.contact_pair[k];
            double square = 0;
            for (int plane = 0; plane < 2; ++plane) {
                const int d = 1 + 5 * p + plane, slope = d + 2;
                const double* N = pb.contact_shape + 4 * k;
                const double value = N[0] * state.unknown(e, d, 0) + N[1] * state.unknown(e, slope, 0) +
                                     N[2] * state.unknown(e + 1, d, 0) + N[3] * state.unknown(e + 1, slope, 0);
                square += value * value;
            }
            side.gap[k] = pb.half_square_clearance[p] - 0.5 * square;
            side.barrier[k] = level * pb.barrier_scale[p] * pb.contact_weight[k];
        }
}

// Imbalance of every free unknown at the parameter's other value, with multipliers and moments of the loads moved along
// their own changes.
void Sensitivities::measure_imbalance(LaneState& state, const std::vector<double>& phi, double amount, Side& side) {
    const KernelProblem& pb = side.solver->mesh().problem();
    move_state(state, 0);
    state.set_phi(side.robot, pb, 0, phi.data());
    side.solver->set_base(state, side.q);
    for (int k = 0; k < pb.contacts; ++k) state.multiplier(k, 0) = multiplier_[k] + amount * multiplier_change_[k];
    set_load_moments(state, amount);
    double level[kLanes], moment[kLanes], gap[kLanes];
    std::fill(level, level + kLanes, side.solver->last_level());
    kernel(1).residual(pb, state.view(), level, moment, gap);
    side.rhs.assign(&state.rhs(0, 0, 0), &state.rhs(0, 0, 0) + static_cast<std::size_t>(pb.nodes) * pb.stride);
}

void Sensitivities::move_state(LaneState& state, double amount) const {
    double* unknowns = state.unknowns();
    for (std::size_t i = 0; i < unknowns_.size(); ++i) unknowns[i] = unknowns_[i] + amount * change_[i];
}

void Sensitivities::set_load_moments(LaneState& state, double amount) const {
    for (std::size_t i = 0; i < moments_.size(); ++i) state.load_moments()[i] = moments_[i] + amount * moments_change_[i];
}

// The solution at the parameter's other value, to first order.
void Sensitivities::move_to(LaneState& state, double amount, const Side& side) const {
    move_state(state, amount);
    side.solver->set_base(state, side.q);
    set_load_moments(state, amount);
}

// One step of dx = -H^-1 dF along the parameter, the multipliers and the moments of the loads.
void Sensitivities::solve_change(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi, double step) {
    const KernelProblem& pb = solver.mesh().problem();
    measure_imbalance(state, phi, step, plus_);
    measure_imbalance(state, phi, -step, minus_);
    rest(solver, state, q, phi);
    for (int k = 0; k < pb.nodes; ++k)
        for (int i = 0; i < pb.stride; ++i) {
            const double change = (plus_.rhs[k * pb.stride + i] - minus_.rhs[k * pb.stride + i]) / (2 * step);
            state.rhs(k, i, 0) = i < pb.node_unknowns[k] ? change : 0.0;
        }
    kernel(1).solve(pb, state.view());
    for (int k = 0; k < pb.nodes; ++k)
        for (int i = 0; i < pb.node_unknowns[k]; ++i) change_[k * pb.stride + i] = state.step(k, i, 0);
}

// Back to the solution itself.
void Sensitivities::rest(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi) const {
    const KernelProblem& pb = solver.mesh().problem();
    move_state(state, 0);
    solver.set_base(state, q);
    state.set_phi(solver.robot(), pb, 0, phi.data());
    for (int k = 0; k < pb.contacts; ++k) state.multiplier(k, 0) = multiplier_[k];
    set_load_moments(state, 0);
}

// The moments of the loads follow the shape, which H does not know: both changes are repeated until they settle, faster by
// the ratio of buckling load to load.
bool Sensitivities::follow_loads(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi, double step) {
    std::vector<double>& upper = upper_moments_;
    upper.resize(moments_.size());
    for (int k = 0; k < kMaxLoadSteps; ++k) {
        move_to(state, step, plus_);
        plus_.solver->weigh(state);
        std::copy_n(state.load_moments(), moments_.size(), upper.begin());
        move_to(state, -step, minus_);
        minus_.solver->weigh(state);
        double largest = 0, moved = 0;
        for (std::size_t i = 0; i < moments_.size(); ++i) {
            const double value = (upper[i] - state.load_moments()[i]) / (2 * step);
            moved = std::max(moved, std::fabs(value - moments_change_[i]));
            largest = std::max(largest, std::fabs(value));
            moments_change_[i] = value;
        }
        solve_change(solver, state, q, phi, step);
        if (moved <= kLoadTolerance * largest + kMomentNoise * solver.moment_scale() / step) return true;
    }
    return false;
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
    for (const Side* side : {&plus_, &minus_})
        if (side->robot.loaded() || !side->robot.linear_round()) return Way::alone;
    for (auto [side, row] : {std::pair{&plus_, &upper_}, {&minus_, &lower_}}) {
        if (!moved_.move_elements(solver.mesh(), side->robot, side->q)) return Way::none;
        read_numbers(moved_, side->robot, side->q, *row);
    }
    for (int i = 0; i < at.count; ++i)
        if (upper_[i] != lower_[i]) change.push_back({i, (upper_[i] - lower_[i]) / (2 * direction.step)});
    return Way::gradient;
}

void Sensitivities::start(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<Direction>& directions) {
    const KernelProblem& pb = solver.mesh().problem();
    const std::size_t count = static_cast<std::size_t>(pb.nodes) * pb.stride;
    unknowns_.resize(count);
    change_.resize(count);
    multiplier_.resize(pb.contacts);
    multiplier_change_.resize(pb.contacts);
    std::copy_n(state.unknowns(), count, unknowns_.begin());
    for (int k = 0; k < pb.contacts; ++k) multiplier_[k] = state.multiplier(k, 0);
    moments_.clear();
    if (loads(solver, q, directions)) moments_.assign(state.load_moments(), state.load_moments() + state.load_moment_count());
    moments_change_.resize(moments_.size());
}

TipDerivative Sensitivities::follow(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi,
                                    const Direction& direction) {
    const double step = direction.step;
    if (!shift(solver, q, direction, step, plus_) || !shift(solver, q, direction, -step, minus_)) return kNowhere;
    measure_multiplier_change(state, step);
    std::fill(change_.begin(), change_.end(), 0.0);
    std::fill(moments_change_.begin(), moments_change_.end(), 0.0);
    solve_change(solver, state, q, phi, step);
    const bool settled = moments_.empty() || follow_loads(solver, state, q, phi, step);
    move_to(state, step, plus_);
    const Frame upper = tip(*plus_.solver, state);
    move_to(state, -step, minus_);
    const Frame lower = tip(*minus_.solver, state);
    rest(solver, state, q, phi);
    if (!settled) return kNowhere;
    TipDerivative by;
    const Vec3 u = upper.tangent(), v = lower.tangent();
    for (int i = 0; i < 3; ++i) {
        by.position[i] = (upper.p[i] - lower.p[i]) / (2 * step);
        by.tangent[i] = (u[i] - v[i]) / (2 * step);
    }
    return by;
}

void Sensitivities::compute(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi,
                            const std::vector<Direction>& directions, std::vector<TipDerivative>& out) {
    if (!TipGradient::applies(solver, state)) return compute_each(solver, state, q, phi, directions, out);
    solver.factorise(state);
    prepare(solver, q, directions);
    if (std::find(ways_.begin(), ways_.end(), Way::gradient) != ways_.end()) gradient_.compute(solver, state, phi);
    if (std::find(ways_.begin(), ways_.end(), Way::alone) != ways_.end()) start(solver, state, q, directions);
    out.assign(directions.size(), kNowhere);
    for (std::size_t j = 0; j < directions.size(); ++j) {
        if (ways_[j] == Way::alone) out[j] = follow(solver, state, q, phi, directions[j]);
        if (ways_[j] != Way::gradient) continue;
        const TipValues by = gradient_.along(changes_[j]);
        std::copy_n(by.value.begin(), 3, out[j].position.begin());
        std::copy_n(by.value.begin() + 3, 3, out[j].tangent.begin());
    }
}

void Sensitivities::compute_each(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi,
                                 const std::vector<Direction>& directions, std::vector<TipDerivative>& out) {
    solver.factorise(state);
    start(solver, state, q, directions);
    out.clear();
    for (const Direction& direction : directions) out.push_back(follow(solver, state, q, phi, direction));
}

}  // namespace ctr
