// Random solves of the core as a plain executable: laws with stated tolerances, and something to run under sanitizers.
//   cmake -S model -B build/core -DCTR_PYTHON=OFF -DCTR_TESTS=ON && cmake --build build/core && build/core/core_test [ROBOTS [FIRST]]
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <ctime>
#include <random>
#include <string>
#include <thread>

#include "ctr/bound.hpp"
#include "ctr/history.hpp"
#include "progress.hpp"
#include "random_robot.hpp"
#include "residuals.hpp"

namespace {

using tests::Case;
using tests::expect;
using tests::random_case;

constexpr int kMostTubes = 6;

enum Kind { ordinary, extreme, wide };
constexpr const char* kKinds[] = {"ordinary", "extreme", "wide"};

struct Tally {
    int status[3][kMostTubes + 1][5] = {};  // by kind of robot and number of tubes
    double longest = 0;                     // s of a processor, of a bound
    int walks = 0, lost = 0, snaps = 0;
};

// Of this thread's processor: others share the machine.
double processor_s() {
    timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

// Half of the robots are extreme, one in ten of those beyond what can be made.
Kind kind_of(int seed) {
    const int six = seed / kMostTubes;
    return six % 2 == 0 ? ordinary : six % 20 == 19 ? wide : extreme;
}

Case case_of(int seed, std::mt19937& random, int n) {
    const Kind kind = kind_of(seed);
    return kind == ordinary ? random_case(random, n) : tests::extreme_case(random, n, kind == wide ? tests::kWide : tests::kMakeable);
}

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

void report(int seed, int n, Kind kind, const ctr::BoundSolver& solver) {
    int reached = 0;
    for (int k = 0; k < solver.corners(); ++k) reached += solver.corner(k).converged;
    std::printf("seed %d, %s, %d tubes: %s, frictionless %s, %d of %d corners\n", seed, kKinds[kind], n, solver.overtwisted() ? "OVERTWISTED" : "FAILED",
                solver.frictionless().converged ? "reached" : "not reached", reached, solver.corners());
}

// Of a share of successes among trials, at 95 % (Wilson).
std::array<double, 2> interval(int successes, int trials) {
    constexpr double z = 1.96;
    if (trials == 0) return {0, 1};
    const double share = static_cast<double>(successes) / trials, spread = z * z / trials;
    const double middle = share + spread / 2, half = z * std::sqrt(share * (1 - share) / trials + spread / (4 * trials));
    return {std::max(0.0, (middle - half) / (1 + spread)), std::min(1.0, (middle + half) / (1 + spread))};
}

void print_row(Kind kind, const char* tubes, const int* status) {
    const int solved = status[0] + status[1] + status[2] + status[3];
    const std::array<double, 2> ends = interval(status[3], solved);
    std::printf("| %s | %s | %d | %d | %d | %.2f %% (%.2f to %.2f) | %d | %d |\n", kKinds[kind], tubes, solved + status[4], status[4], status[3],
                solved ? 100.0 * status[3] / solved : 0.0, 100 * ends[0], 100 * ends[1], status[2], status[1]);
}

// One robot: residuals, common rotation, no friction no bound, following a rotation agrees with solving afresh.
void check(int seed, Tally& tally) {
    std::mt19937 random(seed);
    const int n = 1 + seed % kMostTubes;
    const Kind kind = kind_of(seed);
    const Case made = case_of(seed, random, n);
    const ctr::Accuracy accuracy = ctr::Accuracy::search();
    ctr::validate(made.robot);
    ctr::validate(made.robot, made.q);
    ctr::BoundSolver solver(made.robot);
    const double begun = processor_s();
    solver.solve(made.q, accuracy);
    tally.longest = std::max(tally.longest, processor_s() - begun);
    solver.search_others();
    const ctr::Status status = solver.all_converged() ? solver.status() : solver.overtwisted() ? ctr::Status::overtwisted : ctr::Status::failed;
    ++tally.status[kind][n][static_cast<int>(status)];
    if (!solver.all_converged()) return report(seed, n, kind, solver);
    tests::expect_residuals(solver, seed);
    if (n == 1) expect(solver.position == 0, "one tube has no friction error", seed);
    if (kind == ordinary && n <= 4) walk(seed, made, random, tally);
    if (status != ctr::Status::converged || kind != ordinary || n > 4) return;
    ctr::Configuration turned = made.q;
    for (double& theta : turned.theta) theta += 0.7;
    ctr::BoundSolver second(made.robot);
    second.solve(turned, accuracy);
    if (second.all_converged()) expect(std::fabs(second.position - solver.position) < 1e-6, "common rotation leaves the bound", seed);
}

}  // namespace

int main(int count, char** arguments) {
    const int solves = count > 1 ? std::atoi(arguments[1]) : 200, first = count > 2 ? std::atoi(arguments[2]) : 0;
    Tally tallies[2];
    tests::Progress progress(solves);
    std::atomic<int> next = first;
    auto work = [&](Tally& tally) {
        for (int seed = next++; seed < first + solves; seed = next++) {
            check(seed, tally);
            progress.advance();
        }
    };
    std::thread other(work, std::ref(tallies[1]));
    work(tallies[0]);
    other.join();
    int failed = 0, made = 0;
    std::printf("| robots | tubes | drawn | OVERTWISTED | FAILED | share of the others (95 %%) | UNSTABLE | MULTIPLE |\n|---|---|---|---|---|---|---|---|\n");
    for (const Kind kind : {ordinary, extreme, wide}) {
        int all[5] = {};
        for (int n = 1; n <= kMostTubes; ++n) {
            int status[5];
            for (int k = 0; k < 5; ++k) all[k] += status[k] = tallies[0].status[kind][n][k] + tallies[1].status[kind][n][k];
            print_row(kind, std::to_string(n).c_str(), status);
            if (kind == wide || n == 1) continue;
            failed += status[3];
            made += status[0] + status[1] + status[2] + status[3];
        }
        print_row(kind, "all", all);
    }
    std::printf("%d random robots of 1 to %d tubes: FAILED %d of %d of two tubes or more that can be made, at most 1 in 1,000 may; longest bound %.1f s of a processor; %d laws broken\n", solves,
                kMostTubes, failed, made, std::max(tallies[0].longest, tallies[1].longest), tests::failures.load());
    const int walks = tallies[0].walks + tallies[1].walks, lost = tallies[0].lost + tallies[1].lost;
    std::printf("%d histories of 4 legs: %d without an equilibrium to go on to, %d snaps\n", walks, lost, tallies[0].snaps + tallies[1].snaps);
    return tests::failures || failed * 1000 > std::max(made, 1000) || lost * 100 > walks;
}
