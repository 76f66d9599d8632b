// Random solves of the core as a plain executable: laws with stated tolerances, and something to run under sanitizers.
//   cmake -S model -B build/core -DCTR_PYTHON=OFF -DCTR_TESTS=ON && cmake --build build/core && build/core/core_test [SOLVES]
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

// n tubes within the 2 % rule: clearances 0.01 to 0.5 mm, mu 0 to 0.5, nu -0.3 to 0.5, straight then curved.
Case random_case(std::mt19937& random, int n) {
    auto uniform = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
    Case made;
    double radius = 3e-3, base = -uniform(0, 0.02), tip = uniform(0.05, 0.12);
    for (int i = 0; i < n; ++i) {
        const double wall = uniform(1e-4, 2e-4), EI = std::pow(10.0, uniform(-3, -1));
        ctr::Tube tube{radius, radius - wall, EI, EI / (1 + uniform(-0.3, 0.5)), 0.005, {}};
        const double length = tip - base, curved = uniform(0.3, 0.9) * (tip > 0 ? tip : length);
        tube.sections = {{length - curved, 0, 0}, {curved, uniform(-1, 1), uniform(-15, 15)}};
        made.robot.tubes.push_back(tube);
        made.q.theta.push_back(uniform(-M_PI, M_PI));
        made.q.l.push_back(base);
        const double clearance = std::pow(10.0, uniform(-5, -3.3));
        if (i + 1 < n) made.robot.pairs.push_back({clearance, uniform(0, 0.5), radius - wall, radius - wall - clearance});
        radius -= wall + clearance;
        base -= uniform(0.006, 0.04);
        tip += uniform(0, 0.04);
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
    return failures || status[3] * 100 > solves;
}
