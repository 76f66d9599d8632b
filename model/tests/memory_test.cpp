// What a workspace holds, and that solves after the first few do not ask for memory. glibc only: counts what malloc hands out.
//   cmake -S model -B build/core -DCTR_PYTHON=OFF -DCTR_TESTS=ON && cmake --build build/core && build/core/memory_test
#include <malloc.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <random>

#include "ctr/bound.hpp"
#include "ctr/tip_solver.hpp"

namespace {

long asked = 0, held = 0;  // times, bytes

void* counted(void* p) {
    ++asked;
    held += static_cast<long>(malloc_usable_size(p));
    return p;
}

}  // namespace

// Stand in for the library's own, for operator new and for the workspace's aligned arrays.
extern "C" {
void* __libc_malloc(std::size_t size);
void* __libc_memalign(std::size_t alignment, std::size_t size);
void __libc_free(void* p);
void* malloc(std::size_t size) { return counted(__libc_malloc(size)); }
void* aligned_alloc(std::size_t alignment, std::size_t size) { return counted(__libc_memalign(alignment, size)); }
void free(void* p) {
    if (p) held -= static_cast<long>(malloc_usable_size(p));
    __libc_free(p);
}
}

namespace {

// Tubes of 0.1 to 0.3 m, each half straight and half curved, the innermost the longest.
ctr::Robot nested(int count) {
    ctr::Robot robot;
    for (int i = 0; i < count; ++i) {
        const double inner = 5e-4 + 2e-4 * (count - 1 - i), EI = 0.05 / (1 + i);
        robot.tubes.push_back({inner + 1.5e-4, inner, EI, EI / 1.3, 0.01, {}});
        robot.tubes.back().sections = {{0.05 + 0.04 * i, 0, 0}, {0.05, 0, 4.0 + 3 * i}};
        if (i > 0) robot.pairs.push_back({5e-5, 0.2, inner + 2e-4, inner + 1.5e-4});
    }
    ctr::validate(robot);
    return robot;
}

ctr::Configuration anywhere(const ctr::Robot& robot, std::mt19937& random) {
    auto uniform = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
    ctr::Configuration q;
    for (int i = 0; i < robot.count(); ++i) {
        q.theta.push_back(uniform(-M_PI, M_PI));
        q.l.push_back(i == 0 ? 0.0 : q.l.back() - uniform(0.011, 0.025));
    }
    ctr::validate(robot, q);
    return q;
}

// Runs the work twice; how often the second time asked for memory.
template <class Work>
long asked_again(Work work) {
    work();
    const long before = asked;
    work();
    return asked - before;
}

}  // namespace

int main() {
    constexpr int kSolves = 6, kSteps = 12;
    long failures = 0;
    std::printf("tubes  kB per workspace  asked for memory again by %d solves: search, certificate, %d steps on, tips, derivatives\n", kSolves, kSteps);
    for (int tubes = 1; tubes <= 5; ++tubes) {
        const ctr::Robot robot = nested(tubes);
        std::mt19937 random(7);
        std::vector<ctr::Configuration> all;
        for (int k = 0; k < kSolves; ++k) all.push_back(anywhere(robot, random));
        const long before = held;
        ctr::BoundSolver solver(robot);
        const std::vector<double> phi(tubes > 1 ? tubes - 1 : 1, 1.0);
        auto solve = [&](const ctr::Accuracy& accuracy) {
            return asked_again([&] {
                for (const ctr::Configuration& q : all) solver.solve(q, accuracy);
            });
        };
        ctr::Configuration q = all[0];
        auto walk = [&] {
            for (int k = 0; k < 3; ++k) {
                q = all[k];
                solver.solve(q, ctr::Accuracy::search());
                for (int step = 0; step < kSteps; ++step) {
                    q.theta.back() += 0.017;
                    q.l.back() += step % 3 ? 0 : 2e-4;
                    solver.follow(q, ctr::Accuracy::search());
                }
            }
        };
        const long search = solve(ctr::Accuracy::search());
        const long walks = asked_again(walk);
        const long workspace = held - before;
        const long certificate = solve(ctr::Accuracy::certificate());
        ctr::TipSolver tip(robot);
        const std::vector<ctr::Direction> directions{{{{static_cast<int>(ctr::number_names(robot).size()) - 1, 1.0}}, 1e-7}};
        std::vector<ctr::TipDerivative> derivatives;
        const long tips = asked_again([&] {
            for (const ctr::Configuration& q : all) tip.solve(q, ctr::Accuracy::search(), phi);
        });
        const long derived = asked_again([&] {
            for (const ctr::Configuration& q : all) {
                if (tip.solve(q, ctr::Accuracy::search(), phi) == ctr::Status::failed) continue;
                tip.differentiate(directions, derivatives);
            }
        });
        std::printf("%5d %17.0f %10ld %10ld %10ld %10ld %10ld\n", tubes, workspace / 1024.0, search, certificate, walks, tips, derived);
        failures += search + certificate + walks + tips + derived;
        if (tubes <= 3 && workspace > 2 << 20) ++failures;
    }
    return failures > 0;
}
