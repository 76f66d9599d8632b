// Points of the body and the stability of a solution beside itself, along every direction by its own right-hand side.
#include <algorithm>
#include <cmath>
#include <limits>

#include "ctr/sensitivities.hpp"

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"
#include "walk/outer_line.hpp"

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
// Steps of a direction across which the stability is differenced: rounding in an eigenvalue is larger than in a point.
constexpr double kStabilitySteps = 10;

}  // namespace

void Sensitivities::read_points(const FrictionSolver& solver, LaneState& state, double spacing, const double* lengths, std::vector<double>& out) {
    tracer_.trace(solver, state, 0, 1, solver.base_l(), &backbone_);
    out.clear();
    for_outer_points(solver, backbone_, spacing, lengths, [&](const Vec3& p, double radius) { out.insert(out.end(), {p[0], p[1], p[2], radius}); });
}

// At the solution moved along change_, where multiplier times gap is what it was, but for the barrier.
double Sensitivities::stability_beside(LaneState& state, const std::vector<double>& phi, double amount, Side& side) {
    const KernelProblem& pb = side.solver->mesh().problem();
    move_to(state, amount, side);
    state.set_phi(side.robot, pb, 0, phi.data());
    measure_gaps(state, side);
    for (int k = 0; k < pb.contacts; ++k) {
        const double gap = slack_[k] + side.gap[k] - here_.gap[k];
        if (!(gap > 0)) return kNaN;
        state.slack(k, 0) = gap;
        state.multiplier(k, 0) = multiplier_[k] * slack_[k] * (side.barrier[k] / here_.barrier[k]) / gap;
    }
    side.solver->factorise(state);
    int negative;
    return side.solver->stability(state, negative);
}

double Sensitivities::follow_stability(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi,
                                       const Direction& direction) {
    const double step = kStabilitySteps * direction.step;
    double by = kNaN;
    if (shift(solver, q, direction, step, plus_) && shift(solver, q, direction, -step, minus_))
        by = (stability_beside(state, phi, step, plus_) - stability_beside(state, phi, -step, minus_)) / (2 * step);
    for (std::size_t k = 0; k < slack_.size(); ++k) state.slack(static_cast<int>(k), 0) = slack_[k];
    rest(solver, state, q, phi);
    solver.factorise(state);
    return by;
}

void Sensitivities::compute_body(FrictionSolver& solver, LaneState& state, const Configuration& q, const std::vector<double>& phi,
                                 const std::vector<Direction>& directions, double spacing, BodyDerivatives& out) {
    const KernelProblem& pb = solver.mesh().problem();
    const std::size_t count = directions.size();
    const bool released = std::all_of(phi.begin(), phi.end(), [](double value) { return value == 0; });
    solver.factorise(state);
    start(solver, state, q, directions);
    int negative;
    out.stability = released ? solver.stability(state, negative) : kNaN;
    out.stability_by.assign(count, kNaN);
    read_points(solver, state, spacing, pb.length, out.point);
    const std::size_t points = out.point.size() / 4;
    out.point_by.assign(3 * points * count, kNaN);
    slack_.resize(pb.contacts);
    for (int k = 0; k < pb.contacts; ++k) slack_[k] = state.slack(k, 0);
    here_.solver = &solver;
    measure_gaps(state, here_);
    for (std::size_t j = 0; j < count; ++j) {
        const double step = directions[j].step;
        if (!measure_change(solver, state, q, phi, directions[j])) {
            rest(solver, state, q, phi);
            continue;
        }
        move_to(state, step, plus_);
        read_points(*plus_.solver, state, spacing, pb.length, above_);
        move_to(state, -step, minus_);
        read_points(*minus_.solver, state, spacing, pb.length, below_);
        rest(solver, state, q, phi);
        for (std::size_t k = 0; above_.size() == out.point.size() && below_.size() == out.point.size() && k < points; ++k)
            for (std::size_t i = 0; i < 3; ++i) out.point_by[(3 * k + i) * count + j] = (above_[4 * k + i] - below_[4 * k + i]) / (2 * step);
        if (released) out.stability_by[j] = follow_stability(solver, state, q, phi, directions[j]);
    }
}

}  // namespace ctr
