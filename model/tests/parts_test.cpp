// Laws of the parts that plans, fits and histories are made of, on random robots; something to run under sanitizers.
//   build/core/parts_test [ROBOTS [FIRST]]
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <random>
#include <vector>

#include "ctr/bound.hpp"
#include "ctr/walk.hpp"
#include "ctr/history.hpp"
#include "ctr/sensitivities.hpp"
#include "ctr/tip_solver.hpp"
#include "progress.hpp"
#include "random_robot.hpp"
#include "residuals.hpp"

namespace {

using ctr::Vec3;
using tests::Case;
using tests::expect;

double distance(const Vec3& a, const Vec3& b) { return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]); }

Vec3 turned(const Vec3& p, double angle) {
    return {std::cos(angle) * p[0] - std::sin(angle) * p[1], std::sin(angle) * p[0] + std::cos(angle) * p[1], p[2]};
}

Case with_all_turned(Case made, double angle) {
    for (double& theta : made.q.theta) theta += angle;
    return made;
}

double uniform(std::mt19937& random, double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); }

int derived = 0, walked = 0, softened = 0;  // robots whose checks were not left out, for want of a solution to begin with

// Distances from the plane normal . p = 0, as large as the grid and not a number more, so that a sanitizer sees a look beyond.
struct PlaneField {
    std::vector<float> values;
    ctr::SignedDistanceField field;
    Vec3 normal;

    PlaneField(int nx, int ny, int nz, double spacing, const Vec3& origin, const Vec3& normal) : normal(normal) {
        for (int i = 0; i < nx; ++i)
            for (int j = 0; j < ny; ++j)
                for (int k = 0; k < nz; ++k)
                    values.push_back(static_cast<float>(normal[0] * (origin[0] + i * spacing) + normal[1] * (origin[1] + j * spacing) +
                                                        normal[2] * (origin[2] + k * spacing)));
        values.shrink_to_fit();
        field.values = values.data();
        field.nx = nx, field.ny = ny, field.nz = nz;
        field.spacing = spacing;
        field.origin = origin;
    }
};

// Trilinear interpolation of a plane's distances is exact inside and never more than the distance outside, also in grids of
// a single layer.
void check_distances(int seed) {
    std::mt19937 random(seed);
    const int size[3] = {2 + seed % 4, 1 + seed % 3, 1 + seed / 2 % 3};
    const double pitch = uniform(random, 0, M_PI), yaw = uniform(random, 0, 2 * M_PI);
    Vec3 normal{std::sin(pitch) * std::cos(yaw), std::sin(pitch) * std::sin(yaw), std::cos(pitch)};
    const Vec3 origin{-0.01, -0.02, 0.03};
    const PlaneField plane(size[0], size[1], size[2], 0.01, origin, normal);
    for (int k = 0; k < 200; ++k) {
        Vec3 inside, anywhere;
        for (int i = 0; i < 3; ++i) {
            inside[i] = origin[i] + 0.01 * (size[i] - 1) * (k < 8 ? k >> i & 1 : uniform(random, 0, 1));
            anywhere[i] = origin[i] + uniform(random, -0.1, 0.1);
        }
        expect(std::fabs(plane.field.sample(inside) - ctr::dot(normal, inside)) < 1e-7, "a plane's distances are interpolated exactly", seed);
        expect(plane.field.sample(anywhere) <= ctr::dot(normal, anywhere) + 1e-7, "outside the grid a distance is a lower bound", seed);
    }
    expect(std::isnan(plane.field.sample({std::nan(""), 0, 0})), "the distance of no point is no number", seed);
}

// A common rotation turns the zero-clearance shape, and the room around it where a wall is normal to the axis.
void check_zero_clearance(int seed, const Case& made) {
    ctr::ZeroClearance first, second, other;
    if (!first.solve(made.robot, made.q)) return;
    const Case second_case = with_all_turned(made, 0.7);
    if (!second.solve(second_case.robot, second_case.q)) return;
    expect(first.residual() < 1e-9, "zero clearance: residual below 1e-9", seed);
    if (first.is_unique()) {
        expect(distance(turned(first.tip().p, 0.7), second.tip().p) < 1e-9, "zero clearance: a common rotation turns the tip", seed);
        expect(first.search_other(0, other) < 0, "zero clearance: where one is known to be all, no other is found", seed);
        const PlaneField wall(2, 2, 9, 0.05, {0, 0, -0.1}, {0, 0, 1});
        ctr::Frame tip;
        const double room = first.clearance(made.robot, wall.field, 1e-3, tip);
        expect(std::fabs(room - second.clearance(made.robot, wall.field, 1e-3, tip)) < 1e-6, "zero clearance: a common rotation leaves the room", seed);
        expect(room < 1e-3, "zero clearance: the robot begins at the plate", seed);
    } else if (first.search_other(0, other) >= 0) {
        expect(other.residual() < 1e-9 && !other.negative_pivots(), "zero clearance: another equilibrium is one, and stable", seed);
    }
    std::mt19937 random(seed);  // the same object for a robot of another size, and back
    const Case alone = tests::random_case(random, 1);
    if (other.solve(alone.robot, alone.q) && other.solve(made.robot, made.q) && first.is_unique())
        expect(distance(other.tip().p, first.tip().p) < 1e-9, "zero clearance: nothing is left of another robot", seed);
}

// Exact geometry: residuals, common rotation, one tube is the curve it was made as.
void check_exact(int seed, const Case& made) {
    ctr::BoundSolver solver(made.robot), second(made.robot);
    const ctr::Accuracy accuracy = ctr::Accuracy::exact_geometry();
    solver.solve(made.q, accuracy);
    if (!solver.all_converged()) return;
    tests::expect_residuals(solver, seed);
    second.solve(with_all_turned(made, 0.7).q, accuracy);
    if (solver.status() == ctr::Status::converged && second.all_converged()) {
        const Vec3 tip = solver.backbone.frame.back().p;
        expect(distance(turned(tip, 0.7), second.backbone.frame.back().p) < 1e-6, "exact: a common rotation turns the tip", seed);
        expect(std::fabs(solver.position - second.position) < 1e-6, "exact: a common rotation leaves the bound", seed);
    }
    if (made.robot.count() > 1) return;
    ctr::ZeroClearance alone;
    if (alone.solve(made.robot, made.q))
        expect(distance(alone.tip().p, solver.backbone.frame.back().p) < 1e-7, "exact: one tube is as it was made", seed);
}

// A step for differences of a number: small against the gaps that are left in contact, large against rounding.
double small_step(const std::string& name, double value) {
    if (name.find("clearance") != std::string::npos) return 1e-11;
    if (name.find("length") != std::string::npos || name.rfind("l_b", 0) == 0) return 1e-9;
    return name.rfind("theta", 0) == 0 ? 1e-5 : 1e-5 * std::max(1e-3, std::fabs(value));
}

// The derivatives of a solution by another formulation: a right-hand side and two backbones a direction.
void differentiate_each(const Case& made, const ctr::Accuracy& accuracy, const std::vector<double>& phi, const ctr::TipSolver& solved,
                        const std::vector<ctr::Direction>& directions, std::vector<ctr::TipDerivative>& out) {
    ctr::FrictionSolver solver(made.robot);
    solver.build(made.q, accuracy);
    ctr::LaneState state;
    state.resize(solver.mesh().problem(), 1);
    state.set_phi(made.robot, solver.mesh().problem(), 0, phi.data());
    solver.spread(solved.state(), state);
    solver.converge_load_moments(state);
    ctr::Sensitivities().compute_each(solver, state, made.q, phi, directions, out);
}

// One gradient of the tip says of every number what its own right-hand side and backbones say, and that is what solutions
// beside each other differ by; with shafts that twist, tubes that soften or are oval, precurvature that varies, loads. Turning
// everything turns the tip.
void check_derivatives(int seed, Case made) {
    std::mt19937 random(seed);
    for (ctr::Tube& tube : made.robot.tubes) {
        if (seed % 3 == 0) tube.shaft_compliance = uniform(random, 0.1, 2);
        if (seed % 5 < 2) tube.softening_strain = uniform(random, 2e-3, 1e-2), tube.softening_fraction = uniform(random, 0.3, 0.9);
        if (seed % 7 < 2) tube.ovality = uniform(random, -0.1, 0.1), tube.ovality_axis = uniform(random, -3, 3);
        for (ctr::Section& section : tube.sections) section.gradient = seed % 2 ? uniform(random, -2, 2) : 0;
    }
    const bool loaded = seed % 4 == 1;
    for (int i = 0; loaded && i < 3; ++i) made.robot.loads.tip_force[i] = uniform(random, -0.05, 0.05);
    std::vector<double> phi;
    for (std::size_t p = 0; p < made.robot.pairs.size(); ++p) phi.push_back(uniform(random, -1, 1));
    ctr::TipSolver solver(made.robot);
    const ctr::Accuracy accuracy = ctr::Accuracy::search();
    if (solver.solve(made.q, accuracy, phi) != ctr::Status::converged) return;
    ++derived;
    const std::vector<std::string> names = ctr::number_names(made.robot);
    std::vector<double*> values;
    ctr::numbers(made.robot, made.q, values);
    expect(values.size() == names.size(), "every number has a name", seed);
    const int n = made.robot.count(), count = static_cast<int>(names.size());
    std::vector<ctr::Direction> directions;
    for (int k = 0; k < count; ++k) directions.push_back({{{k, 1.0}}, small_step(names[k], *values[k])});
    directions.push_back({{}, 1e-5});
    for (int i = 0; i < n; ++i) directions.back().weights.push_back({count - 2 * n + i, 1});
    std::vector<ctr::TipDerivative> found, each;
    solver.differentiate(directions, found);
    differentiate_each(made, accuracy, phi, solver, directions, each);
    expect(found.size() == directions.size() && each.size() == directions.size(), "one derivative per direction", seed);
    const Vec3 tip = solver.tip().p;
    if (!loaded) expect(distance(found[count].position, {-tip[1], tip[0], 0}) < 1e-7, "turning everything turns the tip", seed);
    for (int k = 0; k < count; ++k) {
        const Vec3& by = found[k].position;
        expect(std::isnan(by[0]) == std::isnan(each[k].position[0]), "directions lead nowhere for both", seed);
        if (std::isnan(by[0])) continue;
        const double scale = std::max(1e-3, std::fabs(*values[k])), size = std::sqrt(ctr::dot(by, by));  // by a change of the whole number
        expect(distance(by, each[k].position) * scale < 1e-4 * size * scale + 1e-6, "the gradient is the sum of what follows", seed);
        const double turn = std::sqrt(ctr::dot(found[k].tangent, found[k].tangent));
        expect(distance(found[k].tangent, each[k].tangent) * scale < 1e-4 * turn * scale + 1e-4, "so is that of the tangent", seed);
        if ((seed + k) % 5) continue;
        // What a solve leaves of complementarity moves tips by up to 1e-9 m, which small steps of a clearance show; steps that
        // are much of the clearance show the third derivative. A wrong derivative is off at all of them.
        const bool is_gap = names[k].find("clearance") != std::string::npos;
        const double middle = *values[k];
        double off = std::numeric_limits<double>::infinity();
        bool both = true;
        for (const double step : is_gap ? std::vector<double>{1e-7, 1e-8, 2e-9} : std::vector<double>{1e-5 * scale}) {
            Vec3 ends[2], difference;
            for (int side = 0; side < 2; ++side) {
                *values[k] = middle + (side ? step : -step);
                ctr::TipSolver fresh(made.robot);
                both &= fresh.solve(made.q, accuracy, phi) == ctr::Status::converged;
                ends[side] = fresh.tip().p;
            }
            for (int i = 0; i < 3; ++i) difference[i] = (ends[1][i] - ends[0][i]) / (2 * step);
            both &= distance(ends[0], ends[1]) < 1e-4;  // else about to snap
            off = std::min(off, distance(by, difference));
        }
        *values[k] = middle;
        if (both) expect(off * scale < 1e-3 * size * scale + 1e-6, "a derivative is the limit of differences", seed);
    }
}

// Tubes that soften, however early and however far, have an equilibrium in every friction state: where Newton's method runs in
// circles around the knees, the softening is eased in. Their moments at the tip are in balance like any other.
void check_softening(int seed, Case made) {
    std::mt19937 random(seed);
    const double strain = uniform(random, 2e-3, 1e-2), fraction = uniform(random, 0.05, 0.6);
    ctr::BoundSolver linear(made.robot);
    linear.solve(made.q, ctr::Accuracy::search());
    if (linear.status() != ctr::Status::converged || linear.stability() < 2) return;  // softer ones may snap
    for (ctr::Tube& tube : made.robot.tubes) tube.softening_strain = strain, tube.softening_fraction = fraction;
    ctr::BoundSolver solver(made.robot);
    solver.solve(made.q, ctr::Accuracy::search());
    expect(solver.all_converged(), "softening: a bound is found", seed);
    ctr::TipSolver single(made.robot);
    const std::vector<double> released(made.robot.pairs.size(), 0.0);
    const bool found = single.solve(made.q, ctr::Accuracy::search(), released) != ctr::Status::failed;
    expect(found, "softening: a tip is found", seed);
    if (found && solver.all_converged() && solver.stability() > 1)
        expect(distance(single.tip().p, solver.backbone.frame.back().p) < 1e-5, "softening: both ways lead to one shape", seed);
    ++softened;
}

// What was saved is where it was, and goes on as it did.
void check_history(int seed, const Case& made) {
    const std::size_t n = made.robot.tubes.size();
    ctr::History history(made.robot, ctr::Accuracy::search(), ctr::HistoryOptions());
    const std::vector<double> released(n - 1, 0.0), loaded(n - 1, 1.0);
    if (history.start(made.q, released) == ctr::Status::failed) return;
    ctr::Configuration near = made.q, far = made.q;
    for (std::size_t i = 1; i < n; ++i) near.theta[i] += 0.2, far.theta[i] += 0.5;
    if (history.advance(near) == ctr::Status::failed) return;
    const ctr::History::State saved = history.save();
    if (history.advance(far) == ctr::Status::failed) return;
    const std::vector<double> phi = history.phi();
    const double residual = history.residual();
    history.restore(saved);
    expect(history.residual() == saved.convergence.residual, "history: with the residual it had", seed);
    expect(history.configuration().theta == near.theta && history.phi() == saved.phi, "history: back to what was saved", seed);
    ctr::Backbone beside;
    if (history.solve_beside(loaded, beside)) expect(!beside.frame.empty(), "history: a shape beside it has points", seed);
    expect(history.phi() == saved.phi, "history: it stays where it is while a state beside it is solved", seed);
    history.restore(saved);
    if (history.advance(far) == ctr::Status::failed) return expect(false, "history: what went once goes again", seed);
    expect(history.phi() == phi && history.residual() == residual, "history: goes on as it did, bit for bit", seed);
}

// A path past a wall: it begins where a solve of its own does, steps are within the density, no point of a body is nearer to the
// wall than said, a limit ends the walk at the first sample that breaks it.
void check_edges(int seed, const Case& made) {
    const std::size_t n = made.robot.tubes.size();
    const PlaneField wall(3, 2, 5, 0.2, {-0.2, -0.1, -0.4}, {1, 0, 0});
    ctr::SignedDistanceField field = wall.field;
    field.p_AB = {0.03, 0, 0};
    std::vector<ctr::Configuration> corners(3, made.q);
    for (std::size_t i = 1; i < n; ++i) corners[1].theta[i] += 0.3;
    corners[2] = corners[1];
    corners[2].l[n - 1] += n > 1 ? 0.3 * std::max(0.0, made.q.l[n - 2] - 5e-3 - made.q.l[n - 1]) : 2e-3;
    ctr::BoundSolver solver(made.robot), alone(made.robot);
    const ctr::Accuracy accuracy = ctr::Accuracy::search();
    const ctr::PathDensity density;
    const std::vector<ctr::PathSample> samples = ctr::check_path(solver, corners, accuracy, field, density, {}, true);
    expect(!samples.empty(), "edge: the first configuration is a sample", seed);
    alone.solve(corners[0], accuracy);
    if (!alone.all_converged() || samples.empty() || samples.back().status == ctr::Status::failed) return;
    ++walked;
    expect(std::fabs(samples[0].position_bound - alone.position) < 1e-9, "edge: it begins where a solve does", seed);
    double least = 1e9;
    for (const ctr::PathSample& sample : samples) {
        for (std::size_t k = 0; k + 3 < sample.body.size(); k += 4) {
            const Vec3 point{sample.body[k], sample.body[k + 1], sample.body[k + 2]};
            const double room = field.sample(point) - sample.body[k + 3];
            expect(room > sample.clearance - 1e-6, "edge: no point of a body is nearer than its clearance", seed);
        }
        if (sample.status != ctr::Status::unstable) expect(sample.motion <= density.motion * (1 + 1e-6), "edge: no step moves farther than allowed", seed);
        least = std::min(least, sample.clearance);
    }
    ctr::PathLimits limits;
    limits.clearance = 0.5 * (samples[0].clearance + least);
    const std::vector<ctr::PathSample> ended = ctr::check_path(solver, corners, accuracy, field, density, limits);
    for (std::size_t k = 0; k + 1 < ended.size(); ++k) expect(ended[k].clearance >= limits.clearance, "edge: a limit ends a walk at once", seed);
}

}  // namespace

int main(int count, char** arguments) {
    const int robots = count > 1 ? std::atoi(arguments[1]) : 30, first = count > 2 ? std::atoi(arguments[2]) : 0;
    tests::Progress progress(robots);
    for (int seed = first; seed < first + robots; ++seed) {
        std::mt19937 random(seed);
        const Case made = tests::random_case(random, 1 + seed % 3);
        check_distances(seed);
        check_zero_clearance(seed, made);
        check_derivatives(seed, made);
        check_softening(seed, made);
        check_history(seed, made);
        check_edges(seed, made);
        check_exact(seed, made);
        progress.advance();
    }
    if (robots >= 15) {  // fewer say nothing about how many there are
        for (const int count : {derived, walked}) expect(2 * count >= robots, "most robots have solutions to check", robots);
        expect(10 * softened >= robots, "some are far from snapping", robots);
    }
    std::printf("Parts of the core on %d random robots of 1 to 3 tubes: %d checks, %d laws broken\n", robots, tests::checks.load(),
                tests::failures.load());
    return tests::failures != 0;
}
