// Random solves of the core as a plain executable: laws with stated tolerances, and something to run under sanitizers.
//   cmake -S model -B build/core -DCTR_PYTHON=OFF -DCTR_TESTS=ON && cmake --build build/core && build/core/core_test [SOLVES]
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <random>
#include <thread>

#include "ctr/bound.hpp"
#include "ctr/history.hpp"
#include "progress.hpp"
#include "random_robot.hpp"

namespace {

using tests::Case;
using tests::expect;
using tests::random_case;

constexpr int kMostTubes = 6;

struct Tally {
    int status[2][kMostTubes + 1][4] = {};  // ordinary and extreme robots, by number of tubes
    double longest = 0;                     // s, of a bound
    int walks = 0, lost = 0, snaps = 0;
};

// One history: turns, translations of the innermost tube and both, there and back.
void walk(int seed, const Case& made, std::mt19937& random, Tally& tally) {
    auto uniform = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
    const std::size_t n = made.robot.tubes.size();
    ctr::History history(made.robot, ctr::Accuracy::search(), ctr::HistoryOptions());
    std::vector<double> phi(std::max<std::size_t>(n - 1, 1));
    for (double& value : phi) value = std::round(uniform(-1, 1));
    if (history.start(made.q, phi) == ctr::Status::failed) return;
    ++tally.walks;
    ctr::Configuration q = made.q;
    for (int leg = 0; leg < 4; ++leg) {
        if (leg % 3 != 1)
            for (std::size_t i = 1; i < n; ++i) q.theta[i] += uniform(-2, 2);
        if (leg % 3 != 0 && n > 1)  // collars of 5 mm stay apart, the innermost tube stays the longest
            q.l[n - 1] = made.q.l[n - 1] + (leg == 3 ? 0 : uniform(0, 1)) * (made.q.l[n - 2] - 5e-3 - made.q.l[n - 1]);
        if (history.advance(q) == ctr::Status::failed) {
            ++tally.lost;
            std::printf("seed %d: no equilibrium on leg %d of a history\n", seed, leg);
            return;
        }
        tally.snaps += history.snaps();
        for (std::size_t k = 0; k < history.phi().size(); ++k)
            expect(std::hypot(history.phi()[k], history.psi()[k]) < 1 + 1e-9, "friction within Coulomb's limit", seed);
        expect(history.energy().smallest_loss > -1e-12, "no contact gains energy", seed);
    }
}

// One robot: residuals, common rotation, no friction no bound, following a rotation agrees with solving afresh.
void check(int seed, Tally& tally) {
    std::mt19937 random(seed);
    const int n = 1 + seed % kMostTubes;
    const bool extreme = seed / kMostTubes % 2;
    const Case made = extreme ? tests::extreme_case(random, n) : random_case(random, n);
    const ctr::Accuracy accuracy = ctr::Accuracy::search();
    ctr::validate(made.robot);
    ctr::validate(made.robot, made.q);
    ctr::BoundSolver solver(made.robot);
    const auto begun = std::chrono::steady_clock::now();
    solver.solve(made.q, accuracy);
    tally.longest = std::max(tally.longest, std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count());
    solver.search_others();
    const ctr::Status status = solver.all_converged() ? solver.status() : ctr::Status::failed;
    ++tally.status[extreme][n][static_cast<int>(status)];
    if (status == ctr::Status::failed) return;
    const double tolerance = solver.solver().tolerance();
    const ctr::KernelProblem& mesh = solver.solver().mesh().problem();
    const bool coarse = *std::min_element(mesh.length, mesh.length + mesh.elements) > 2e-4;
    expect(tolerance == 1e-8 || (!coarse && tolerance <= 1e-6), "residual below 1e-8 where no element is short", seed);
    expect(solver.frictionless().residual < tolerance, "residual reached without friction", seed);
    for (int k = 0; k < solver.corners(); ++k) expect(solver.corner(k).residual < tolerance, "residual reached in a corner", seed);
    if (n == 1) expect(solver.position == 0, "one tube has no friction error", seed);
    if (!extreme && n <= 4) walk(seed, made, random, tally);
    if (status != ctr::Status::converged || extreme || n > 4) return;
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
    tests::Progress progress(solves);
    std::atomic<int> next = 0;
    auto work = [&](Tally& tally) {
        for (int seed = next++; seed < solves; seed = next++) {
            check(seed, tally);
            progress.advance();
        }
    };
    std::thread other(work, std::ref(tallies[1]));
    work(tallies[0]);
    other.join();
    auto count_of = [&](int extreme, int n, int k) { return tallies[0].status[extreme][n][k] + tallies[1].status[extreme][n][k]; };
    int failed[2] = {}, made[2] = {};
    std::printf("tubes  ordinary: robots FAILED UNSTABLE MULTIPLE   extreme: robots FAILED UNSTABLE MULTIPLE\n");
    for (int n = 1; n <= kMostTubes; ++n) {
        std::printf("%5d", n);
        for (int extreme = 0; extreme < 2; ++extreme) {
            int robots = 0;
            for (int k = 0; k < 4; ++k) robots += count_of(extreme, n, k);
            made[extreme] += robots;
            failed[extreme] += count_of(extreme, n, 3);
            std::printf("  %18d %6d %8d %8d", robots, count_of(extreme, n, 3), count_of(extreme, n, 2), count_of(extreme, n, 1));
        }
        std::printf("\n");
    }
    std::printf("%d random robots of 1 to %d tubes: FAILED %d of %d ordinary, %d of %d extreme ones; longest bound %.1f s; %d laws broken\n", solves,
                kMostTubes, failed[0], made[0], failed[1], made[1], std::max(tallies[0].longest, tallies[1].longest), tests::failures.load());
    const int walks = tallies[0].walks + tallies[1].walks, lost = tallies[0].lost + tallies[1].lost;
    std::printf("%d histories of 4 legs: %d without an equilibrium to go on to, %d snaps\n", walks, lost, tallies[0].snaps + tallies[1].snaps);
    return tests::failures || (failed[0] + failed[1]) * 1000 > std::max(solves, 1000) || lost * 100 > walks;
}
