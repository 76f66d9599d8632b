// A direction by its own right-hand side and two backbones, whatever the tubes are.
#include <algorithm>
#include <cmath>
#include <memory>

#include "ctr/sensitivities.hpp"
#include "derivatives/tip_gradient.hpp"

namespace ctr {
namespace {

constexpr int kMaxLoadSteps = 60;
constexpr double kLoadTolerance = 1e-6;  // of the largest change
constexpr double kMomentNoise = 1e-13;    // of EI * precurvature, from rounding

}  // namespace

bool Sensitivities::shift(FrictionSolver& solver, const Configuration& q, const Direction& direction, double amount, Side& side) const {
    set(solver, q, direction, amount, side);
    if (only_turns(solver, direction) &&
        std::all_of(side.robot.tubes.begin(), side.robot.tubes.end(), [](const Tube& t) { return t.shaft_compliance == 0; })) {
        side.solver = &solver;
        return true;
    }
    if (!side.own) side.own = std::make_unique<FrictionSolver>(solver.robot());
    side.solver = side.own.get();
    return side.own->take(solver, side.robot, side.q);
}

// Whether the robot carries loads, or would along one of the directions.
bool Sensitivities::loads(const FrictionSolver& solver, const Configuration& q, const std::vector<Direction>& directions) {
    return solver.robot().loaded() || std::any_of(directions.begin(), directions.end(), [&](const Direction& direction) {
               set(solver, q, direction, direction.step, plus_);
               return plus_.robot.loaded();
           });
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

bool Sensitivities::measure_change(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi,
                                   const Direction& direction) {
    const double step = direction.step;
    if (!shift(solver, q, direction, step, plus_) || !shift(solver, q, direction, -step, minus_)) return false;
    measure_multiplier_change(state, step);
    std::fill(change_.begin(), change_.end(), 0.0);
    std::fill(moments_change_.begin(), moments_change_.end(), 0.0);
    solve_change(solver, state, q, phi, step);
    return moments_.empty() || follow_loads(solver, state, q, phi, step);
}

TipDerivative Sensitivities::follow(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi,
                                    const Direction& direction) {
    const double step = direction.step;
    if (!measure_change(solver, state, q, phi, direction)) {
        rest(solver, state, q, phi);
        return TipDerivative::nowhere();
    }
    move_to(state, step, plus_);
    const Frame upper = tip(*plus_.solver, state);
    move_to(state, -step, minus_);
    const Frame lower = tip(*minus_.solver, state);
    rest(solver, state, q, phi);
    TipDerivative by;
    const Vec3 u = upper.tangent(), v = lower.tangent();
    for (int i = 0; i < 3; ++i) {
        by.position[i] = (upper.p[i] - lower.p[i]) / (2 * step);
        by.tangent[i] = (u[i] - v[i]) / (2 * step);
    }
    return by;
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

Frame Sensitivities::tip(const FrictionSolver& solver, LaneState& state) {
    tracer_.trace(solver, state, 0, 1, solver.base_l(), &backbone_);
    return backbone_.tip;
}

void Sensitivities::compute_each(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi,
                                 const std::vector<Direction>& directions, std::vector<TipDerivative>& out) {
    solver.factorise(state);
    start(solver, state, q, directions);
    out.clear();
    for (const Direction& direction : directions) out.push_back(follow(solver, state, q, phi, direction));
}

}  // namespace ctr
