// Random solves of the core as a plain executable: laws with stated tolerances, and something to run under sanitizers.
//   cmake -S model -B build/core -DCTR_PYTHON=OFF -DCTR_TESTS=ON && cmake --build build/core && build/core/core_test [SOLVES]
#include <algorithm>
#include <atomic>
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

struct Tally {
    int status[4] = {};
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
    walk(seed, made, random, tally);
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
    int status[4];
    for (int k = 0; k < 4; ++k) status[k] = tallies[0].status[k] + tallies[1].status[k];
    std::printf("%d random robots of 1 to 4 tubes: %d CONVERGED, %d MULTIPLE, %d UNSTABLE, %d FAILED; %d laws broken\n", solves,
                status[0], status[1], status[2], status[3], tests::failures.load());
    const int walks = tallies[0].walks + tallies[1].walks, lost = tallies[0].lost + tallies[1].lost;
    std::printf("%d histories of 4 legs: %d without an equilibrium to go on to, %d snaps\n", walks, lost, tallies[0].snaps + tallies[1].snaps);
    return tests::failures || status[3] * 1000 > solves || lost * 100 > walks;
}
