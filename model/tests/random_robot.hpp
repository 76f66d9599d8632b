// Random robots with a configuration, and the count of laws that did not hold.
#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <random>
#include <vector>

#include "ctr/robot.hpp"

namespace tests {

struct Case {
    ctr::Robot robot;
    ctr::Configuration q;
};

// n tubes, straight then curved, one robot in five fully retracted: clearances 0.01 to 3 mm or 2 % of the radius of curvature,
// mu 0 to 0.5, nu -0.3 to 0.5.
inline Case random_case(std::mt19937& random, int n) {
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

// How far extremes go: largest friction coefficient, bend of a tube (rad), bending stiffnesses (N m^2).
struct Ends {
    double friction, bend, softest, stiffest;
};
constexpr Ends kMakeable = {0.5, M_PI, 1e-3, 0.1};
constexpr Ends kWide = {2, 2 * M_PI, 1e-4, 1};  // beyond: friction may lock the tubes, so that they have to snap

// n tubes at the ends of what somebody can make: one to three sections each, bent up to half round and up to what the material
// bears when they are straightened (8 %), neighbours up to 100 times as stiff, clearances 5 um to 3 mm or 2 % of the radius of
// curvature, mu 0 to 0.5, nu -0.9 to 0.5, 20 mm to half a metre long, collars anywhere or all together, tips 0.01 mm apart.
inline Case extreme_case(std::mt19937& random, int n, const Ends& ends = kMakeable) {
    auto uniform = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
    auto log_uniform = [&](double a, double b) { return std::pow(10.0, uniform(std::log10(a), std::log10(b))); };
    constexpr double kMostStrain = 0.08;
    Case made;
    std::vector<double> outer_radius(n), sharpest(n);
    double radius = log_uniform(2e-4, 1e-3);
    for (int i = n - 1; i >= 0; --i) outer_radius[i] = radius *= uniform(1.1, 1.6);
    const bool together = uniform(0, 1) < 0.3, gently = uniform(0, 1) < 0.5;
    double base = -uniform(0, 0.05), tip = log_uniform(0.02, 0.2);
    for (int i = 0; i < n; ++i) {
        const double EI = log_uniform(ends.softest, ends.stiffest), length = tip - base;
        made.robot.tubes.push_back({outer_radius[i], outer_radius[i] / 1.09, EI, EI / (1 + uniform(-0.9, 0.5)), 0.001, {}});
        std::vector<double> parts;
        double sum = 0;
        for (int k = 1 + static_cast<int>(uniform(0, 3)); k > 0; --k) sum += parts.emplace_back(uniform(0.1, 1));
        double left = ends.bend;  // rad
        for (const double part : parts) {
            const double long_ = length * part / sum, most = std::min(kMostStrain / outer_radius[i], left / long_);
            const double curvature = uniform(0, 1) < 0.3 ? 0 : gently ? uniform(0, std::min(most, 20.0)) : uniform(0, most);
            const double towards = uniform(-M_PI, M_PI);
            left -= curvature * long_;
            sharpest[i] = std::max(sharpest[i], curvature);
            made.robot.tubes[i].sections.push_back({long_, curvature * std::cos(towards), curvature * std::sin(towards)});
        }
        made.q.theta.push_back(uniform(-M_PI, M_PI));
        made.q.l.push_back(base);
        base -= together ? uniform(0.001, 0.002) : uniform(0.001, 0.1);
        tip += uniform(0, 1) < 0.3 ? 1e-5 : together ? uniform(0, 0.002) : uniform(0, 0.06);
    }
    for (int i = 0; i + 1 < n; ++i) {
        const double most = std::min(3e-3, 0.02 / std::max({sharpest[i], sharpest[i + 1], 1.0}));
        const double friction = uniform(0, ends.friction);
        made.robot.pairs.push_back({log_uniform(5e-6, most), friction, outer_radius[i] / 1.09, outer_radius[i + 1]});
    }
    return made;
}

inline std::atomic<int> checks = 0, failures = 0;

inline void expect(bool holds, const char* law, int seed) {
    ++checks;
    if (holds) return;
    ++failures;
    std::printf("seed %d: %s does not hold\n", seed, law);
}

}  // namespace tests
