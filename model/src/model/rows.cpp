// Many configurations, shared among threads.
#include <algorithm>
#include <limits>

#include "ctr/model.hpp"
#include "ctr/tip_solver.hpp"
#include "ctr/zero_clearance.hpp"
#include "model/answers.hpp"
#include "model/solver_pool.hpp"

namespace ctr {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr Vec3 kNowhere{kNaN, kNaN, kNaN};

void fill_tip(const TipSolver& solver, Status status, std::size_t k, FrictionTipRows& out) {
    out.tip[k] = solver.tip().p;
    out.tangent[k] = solver.tip().tangent();
    out.status[k] = status;
    out.residual[k] = solver.convergence().residual;
    out.max_strain[k] = solver.max_strain();
}

void fill_derivatives(const std::vector<TipDerivative>& by, std::size_t k, FrictionTipRows& out) {
    for (std::size_t j = 0; j < by.size(); ++j)
        for (std::size_t i = 0; i < 3; ++i) {
            out.tip_by[(k * 3 + i) * out.parameters + j] = by[j].position[i];
            out.tangent_by[(k * 3 + i) * out.parameters + j] = by[j].tangent[i];
        }
}

// First row of each run of rows of one configuration, and the end.
std::vector<std::size_t> runs(const std::vector<Configuration>& all) {
    std::vector<std::size_t> first;
    for (std::size_t k = 0; k < all.size(); ++k)
        if (k == 0 || all[k].theta != all[k - 1].theta || all[k].l != all[k - 1].l) first.push_back(k);
    first.push_back(all.size());
    return first;
}

}  // namespace

void fill_bound(const BoundSolver& solver, std::size_t k, BoundRows& out) {
    const bool found = solver.frictionless().converged;
    const Frame& tip = solver.backbone.tip;
    out.position_bound[k] = solver.position;
    out.tangent_bound[k] = solver.tangent;
    out.stability[k] = found ? solver.stability() : kNaN;
    out.max_strain[k] = found ? solver.max_strain : kNaN;
    out.residual[k] = solver.frictionless().residual;
    for (int c = 0; c < solver.corners(); ++c) out.residual[k] = std::max(out.residual[k], solver.corner(c).residual);
    out.status[k] = solver.all_converged() ? solver.status() : Status::failed;
    out.tip[k] = found ? tip.p : kNowhere;
    out.tangent[k] = found ? tip.tangent() : kNowhere;
}

BoundRows::BoundRows(std::size_t rows)
    : TipRows(rows), position_bound(rows), tangent_bound(rows), stability(rows), max_strain(rows), residual(rows) {}

FrictionTipRows::FrictionTipRows(std::size_t rows, std::size_t count)
    : TipRows(rows), residual(rows), max_strain(rows), tip_by(rows * 3 * count, kNaN), tangent_by(rows * 3 * count, kNaN), parameters(count) {}

BoundRows Model::bounds(const std::vector<Configuration>& all, const Accuracy& accuracy, int threads) {
    require_all_corners(robot_);
    BoundRows out(all.size());
    solvers_->parallel(all.size(), threads, [&](BoundSolver& solver, std::size_t k) {
        solver.solve(all[k], accuracy);
        solver.search_others();
        fill_bound(solver, k, out);
    });
    return out;
}

TipRows Model::zero_clearance_tips(const std::vector<Configuration>& all, int threads) {
    TipRows out(all.size());
    solvers_->parallel(all.size(), threads, [&](BoundSolver& solver, std::size_t k) {
        ZeroClearance& solution = solver.zero_clearance();
        const bool done = solution.solve(robot_, all[k]);
        const Frame tip = solution.tip();
        out.tip[k] = tip.p;
        out.tangent[k] = tip.tangent();
        out.status[k] = !done ? Status::failed : solution.negative_pivots() ? Status::unstable : Status::converged;
    });
    return out;
}

ClearanceRows Model::zero_clearance_clearances(const std::vector<Configuration>& all, const SignedDistanceField& field, double spacing, int threads) {
    ClearanceRows out(all.size());
    solvers_->parallel(all.size(), threads, [&](BoundSolver& solver, std::size_t k) {
        ZeroClearance& solution = solver.zero_clearance();
        const bool stable = solution.solve(robot_, all[k]) && !solution.negative_pivots();
        Frame tip;
        const double clearance = solution.clearance(robot_, field, spacing, tip);
        out.clearance[k] = stable ? clearance : -std::numeric_limits<double>::infinity();
        out.tip[k] = tip.p;
    });
    return out;
}

FrictionTipRows Model::friction_tips(const std::vector<Configuration>& all, const double* phi, const std::vector<Direction>& directions,
                                     const Accuracy& accuracy, int threads, TipMemory* memory, const std::vector<std::size_t>& places) const {
    const std::size_t pairs = robot_.pairs.size();
    std::unique_lock<std::mutex> having;
    if (memory) having = std::unique_lock(memory->busy, std::try_to_lock);
    for (const std::size_t place : places)
        if (having && place >= memory->places.size()) memory->places.resize(place + 1);
    FrictionTipRows out(all.size(), directions.size());
    const std::vector<std::size_t> first = runs(all);
    auto work = [&](TipSolver& solver, std::size_t run) {
        std::vector<TipDerivative> derivatives;
        for (std::size_t k = first[run]; k < first[run + 1]; ++k) {
            const Status status = solver.solve(all[k], accuracy, std::vector<double>(phi + k * pairs, phi + (k + 1) * pairs),
                                               having ? &memory->places[places[k]] : nullptr);
            fill_tip(solver, status, k, out);
            if (directions.empty() || status == Status::failed) continue;
            solver.differentiate(directions, derivatives);
            fill_derivatives(derivatives, k, out);
        }
    };
    share(first.size() - 1, threads, [&] { return std::make_unique<TipSolver>(robot_); }, work);
    return out;
}

BodyDerivatives Model::body_derivatives(const Configuration& q, const Accuracy& accuracy, const std::vector<double>& phi,
                                        const std::vector<Direction>& directions, double spacing) const {
    TipSolver solver(robot_);
    BodyDerivatives found;
    found.stability = kNaN;
    found.stability_by.assign(directions.size(), kNaN);
    if (solver.solve(q, accuracy, phi) != Status::failed) solver.differentiate_body(directions, spacing, found);
    return found;
}

}  // namespace ctr
