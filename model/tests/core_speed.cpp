// What the core takes of a processor for a bound of the three-tube robot (Table II): cold, at certificate accuracy, and along
// a path by 1 degree or 0.5 mm a step; with Newton steps of the frictionless solution and of the slowest corner.
//   cmake -S model -B build/core -DCTR_PYTHON=OFF -DCTR_TESTS=ON && cmake --build build/core && build/core/core_speed [ROW [COUNT]]
// Where others use the machine, count instructions instead, of two counts, whose difference leaves out what comes first:
//   valgrind --tool=callgrind --callgrind-out-file=/dev/null build/core/core_speed cold 10
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <random>
#include <vector>

#include "ctr/bound.hpp"

namespace {

constexpr int kStepsOfAPath = 60;

ctr::Robot three_tubes() {
    ctr::Robot robot;
    robot.tubes = {{1.32e-3, 1.195e-3, 0.0507, 0.039, 0.0, {{0.150, 0, 1 / 0.265}}},
                   {1.1525e-3, 0.975e-3, 0.0507, 0.039, 0.017, {{0.017, 0, 0}, {0.150, 0, 1 / 0.265}}},
                   {0.9125e-3, 0.8e-3, 0.0145, 0.0145 / 1.3, 0.017, {{0.184, 0, 0}, {0.0864, 0, 1 / 0.055}}}};
    robot.pairs = {{4.25e-5, 0.2, 1.195e-3, 1.1525e-3}, {6.25e-5, 0.2, 0.975e-3, 0.9125e-3}};
    ctr::validate(robot);
    return robot;
}

double processor_ms() {
    timespec time;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return 1e3 * time.tv_sec + 1e-6 * time.tv_nsec;
}

class Row {
  public:
    template <class Work> void take(const ctr::BoundSolver& solver, const Work& work) {
        const double start = processor_ms();
        work();
        taken_.push_back(processor_ms() - start);
        frictionless_ += solver.frictionless().iterations;
        int slowest = 0;
        for (int k = 0; k < solver.corners(); ++k) slowest = std::max(slowest, solver.corner(k).iterations);
        corners_ += slowest;
        if (!solver.all_converged()) ++failed_;
    }

    void print(const char* name) {
        const std::size_t count = taken_.size();
        std::sort(taken_.begin(), taken_.end());
        double mean = 0;
        for (const double time : taken_) mean += time / count;
        std::printf("%-12s %6zu %8.3f %8.3f %8.3f %8.2f %8.2f %8d\n", name, count, mean, taken_[count / 2], taken_[count * 99 / 100],
                    frictionless_ / count, corners_ / count, failed_);
    }

  private:
    std::vector<double> taken_;
    double frictionless_ = 0, corners_ = 0;
    int failed_ = 0;
};

// Rotations anywhere, tube 3 with its base between two places.
class Configurations {
  public:
    Configurations(double back, double front) : back_(back), front_(front) {}

    ctr::Configuration next() { return {{angle(), angle(), angle()}, {0, -0.017, uniform(back_, front_)}}; }

  private:
    double uniform(double a, double b) { return std::uniform_real_distribution<double>(a, b)(random_); }
    double angle() { return uniform(-M_PI, M_PI); }

    double back_, front_;
    std::mt19937 random_{5};
};

void cold(const char* name, int count, const ctr::Accuracy& accuracy) {
    ctr::BoundSolver solver(three_tubes());
    Configurations configurations(-0.1204, -0.034);
    Row row;
    for (int k = 0; k < count; ++k) {
        const ctr::Configuration q = configurations.next();
        row.take(solver, [&] { solver.solve(q, accuracy); });
    }
    row.print(name);
}

void along_paths(const char* name, int count, double turn, double move) {
    ctr::BoundSolver solver(three_tubes());
    Configurations configurations(-0.12, -0.065);
    Row row;
    for (int k = 0; k < count; ++k) {
        ctr::Configuration q = configurations.next();
        solver.solve(q, ctr::Accuracy::search());
        for (int step = 0; step < kStepsOfAPath; ++step) {
            q.theta[2] += turn;
            q.l[2] += move;
            row.take(solver, [&] { solver.follow(q, ctr::Accuracy::search()); });
        }
    }
    row.print(name);
}

}  // namespace

int main(int count, char** arguments) {
    const char* wanted = count > 1 ? arguments[1] : "all";
    const int given = count > 2 ? std::atoi(arguments[2]) : 0;
    bool known = false;
    auto asked = [&](const char* name) {
        const bool is = !std::strcmp(wanted, "all") || !std::strcmp(wanted, name);
        if (is && !known) std::printf("%-12s %6s %8s %8s %8s %8s %8s %8s   (ms of a processor)\n", "", "solves", "mean", "median", "99 %", "steps", "corners", "FAILED");
        known = known || is;
        return is;
    };
    auto many = [&](int usual) { return given > 0 ? given : usual; };
    if (asked("cold")) cold("cold", many(1000), ctr::Accuracy::search());
    if (asked("certificate")) cold("certificate", many(200), ctr::Accuracy::certificate());
    if (asked("rotation")) along_paths("rotation", many(20), M_PI / 180, 0);
    if (asked("translation")) along_paths("translation", many(20), 0, 0.5e-3);
    if (!known) std::fprintf(stderr, "core_speed: there is no row \"%s\"; rows are cold, certificate, rotation, translation\n", wanted);
    return known ? 0 : 2;
}
