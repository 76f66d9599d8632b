// Random solves of the core as a plain executable: laws with stated tolerances, and something to run under sanitizers.
//   cmake -S model -B build/core -DCTR_PYTHON=OFF -DCTR_TESTS=ON && cmake --build build/core && build/core/core_test [SOLVES]
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <thread>

#include "ctr/bound.hpp"
#include "ctr/edge.hpp"

namespace {

struct Case {
    ctr::Robot robot;
    ctr::Configuration q;
};

// n tubes, straight then curved, one robot in five fully retracted: clearances 0.01 to 3 mm or 2 % of the radius of curvature,
// mu 0 to 0.5, nu -0.3 to 0.5.
Case random_case(std::mt19937& random, int n) {
    auto uniform = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
    Case made;
    double base = -uniform(0, 0.02), tip = uniform(0.05, 0.12);
    const bool retracted = uniform(0, 1) < 0.2;
    for (int i = 0; i < n; ++i) {
        const double EI = std::pow(10.0, uniform(-3, -1)), curved = uniform(0.3, 0.9) * tip;
        made.robot.tubes.push_back({0, 0, EI, EI / (1 + uniform(-0.3, 0.5)), 0.005, {}});
        made.robot.tubes.back().sections = {{tip - base - curved, 0, 0}, {curved, uniform(-1, 1), uniform(-15, 15)}};
        made.q.theta.push_back(uniform(-M_PI, M_PI));
        made.q.l.push_back(base);
        base -= retracted ? uniform(0.005, 0.006) : uniform(0.006, 0.04);
        tip += uniform(0, retracted ? 0.002 : 0.04);
    }
    auto bend = [&](int i) { return std::hypot(made.robot.tubes[i].sections[1].curvature_x, made.robot.tubes[i].sections[1].curvature_y); };
    double radius = 5e-4;  // from the innermost tube outwards
    for (int i = n - 1; i >= 0; --i) {
        made.robot.tubes[i].inner_radius = radius;
        made.robot.tubes[i].outer_radius = radius += uniform(1e-4, 2e-4);
        if (i == 0) break;
        const double most = std::min(3e-3, 0.02 / std::max(bend(i), bend(i - 1)));
        const double clearance = std::pow(10.0, uniform(-5, std::log10(most)));
        made.robot.pairs.insert(made.robot.pairs.begin(), {clearance, uniform(0, 0.5), radius + clearance, radius});
        radius += clearance;
    }
    return made;
}

int failures = 0;

void expect(bool holds, const char* law, int seed) {
    if (holds) return;
    ++failures;
    std::printf("seed %d: %s does not hold\n", seed, law);
}

struct Tally {
    int status[4] = {};
};

// One robot: residuals, common rotation, no friction no bound, following a rotation agrees with solving afresh.
void check(int seed, Tally& tally) {
    std::mt19937 random(seed);
    const int n = 1 + seed % 4;
    const Case made = random_case(random, n);
    const ctr::Accuracy accuracy = ctr::Accuracy::search();
    ctr::validate(made.robot);
    ctr::validate(made.robot, made.q);
    ctr::BoundSolver solver(made.robot);
    solver.solve(made.q, accuracy);
    solver.search_others();
    const ctr::Status status = solver.all_converged() ? solver.status() : ctr::Status::failed;
    ++tally.status[static_cast<int>(status)];
    if (status == ctr::Status::failed) return;
    expect(solver.frictionless().residual < 1e-8, "residual below 1e-8 without friction", seed);
    for (int k = 0; k < solver.corners(); ++k) expect(solver.corner(k).residual < 1e-8, "residual below 1e-8 in a corner", seed);
    if (n == 1) expect(solver.position == 0, "one tube has no friction error", seed);
    if (status != ctr::Status::converged) return;
    ctr::Configuration turned = made.q;
    for (double& theta : turned.theta) theta += 0.7;
    ctr::BoundSolver second(made.robot);
    second.solve(turned, accuracy);
    if (second.all_converged()) expect(std::fabs(second.position - solver.position) < 1e-6, "common rotation leaves the bound", seed);
}

}  // namespace

int main(int count, char** arguments) {
    const int solves = count > 1 ? std::atoi(arguments[1]) : 200;
    Tally tallies[2];
    std::thread other([&] {
        for (int seed = 1; seed < solves; seed += 2) check(seed, tallies[1]);
    });
    for (int seed = 0; seed < solves; seed += 2) check(seed, tallies[0]);
    other.join();
    int status[4];
    for (int k = 0; k < 4; ++k) status[k] = tallies[0].status[k] + tallies[1].status[k];
    std::printf("%d random robots of 1 to 4 tubes: %d CONVERGED, %d MULTIPLE, %d UNSTABLE, %d FAILED; %d laws broken\n", solves,
                status[0], status[1], status[2], status[3], failures);
    return failures || status[3] * 1000 > solves;
}
