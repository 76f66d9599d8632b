#include "ctr/robot.hpp"

#include <cmath>
#include <cstdio>

namespace ctr {
namespace {

[[noreturn]] void reject(const char* what, int index, double value, const char* unit, const char* rule) {
    char text[256];
    std::snprintf(text, sizeof text, "%s of tube %d = %g %s: %s", what, index + 1, value, unit, rule);
    throw InvalidInput(text);
}

constexpr double kNestingTolerance = 1e-9;  // m; joint values come from decimal files

}  // namespace

const Section& section_at(const Tube& tube, double from_base) {
    double end = 0;
    for (const Section& section : tube.sections)
        if (from_base < (end += section.length)) return section;
    return tube.sections.back();
}

void validate(const Robot& robot) {
    const int n = robot.count();
    if (n < 1) throw InvalidInput("a robot needs at least one tube");
    if (static_cast<int>(robot.pairs.size()) != n - 1)
        throw InvalidInput("a robot of n tubes needs n - 1 contact pairs");
    for (int i = 0; i < n; ++i) {
        const Tube& tube = robot.tubes[i];
        if (!(tube.bending_stiffness > 0) || !std::isfinite(tube.bending_stiffness))
            reject("bending stiffness", i, tube.bending_stiffness, "N m^2", "must be positive and finite");
        if (!(tube.torsional_stiffness > 0) || !std::isfinite(tube.torsional_stiffness))
            reject("torsional stiffness", i, tube.torsional_stiffness, "N m^2", "must be positive and finite");
        if (!(tube.collar_length >= 0) || !std::isfinite(tube.collar_length))
            reject("collar length", i, tube.collar_length, "m", "must not be negative");
        if (tube.sections.empty()) reject("number of sections", i, 0, "", "must be at least one");
        for (const Section& section : tube.sections) {
            if (!(section.length > 0) || !std::isfinite(section.length))
                reject("section length", i, section.length, "m", "must be positive and finite");
            if (!std::isfinite(section.curvature_x) || !std::isfinite(section.curvature_y))
                reject("precurvature", i, section.curvature_x + section.curvature_y, "1/m", "must be finite");
        }
    }
    for (int j = 0; j + 1 < n; ++j) {
        const Pair& pair = robot.pairs[j];
        if (!(pair.clearance > 0) || !std::isfinite(pair.clearance))
            reject("clearance inside the bore", j, pair.clearance, "m", "must be positive and finite");
        if (!(pair.friction >= 0) || !std::isfinite(pair.friction))
            reject("friction coefficient inside the bore", j, pair.friction, "", "must not be negative");
        if (!(pair.outer_inner_radius >= 0) || !(pair.inner_outer_radius >= 0))
            reject("contact radius inside the bore", j, pair.inner_outer_radius, "m", "must not be negative");
    }
}

void validate(const Robot& robot, const Configuration& q) {
    const int n = robot.count();
    if (static_cast<int>(q.theta.size()) != n || static_cast<int>(q.l.size()) != n)
        throw InvalidInput("theta_b and l_b need one value per tube");
    for (int i = 0; i < n; ++i) {
        if (!std::isfinite(q.theta[i]) || std::fabs(q.theta[i]) > 1e6)
            reject("theta_b", i, q.theta[i], "rad", "must be finite and below 1e6 rad");
        if (!std::isfinite(q.l[i])) reject("l_b", i, q.l[i], "m", "must be finite");
    }
    if (q.l[0] > kNestingTolerance) reject("l_b", 0, q.l[0], "m", "must not be in front of the front plate (<= 0)");
    if (q.l[0] + robot.tubes[0].length() <= 0)
        reject("l_b", 0, q.l[0], "m", "must leave the tube's tip in front of the front plate");
    for (int i = 0; i + 1 < n; ++i) {
        if (q.l[i] - q.l[i + 1] < robot.tubes[i + 1].collar_length - kNestingTolerance)
            reject("l_b", i + 1, q.l[i + 1], "m", "must lie behind the outer tube's base by the collar length");
        if (q.l[i] + robot.tubes[i].length() > q.l[i + 1] + robot.tubes[i + 1].length() + kNestingTolerance)
            reject("l_b", i + 1, q.l[i + 1], "m", "must let the tube's tip reach at least as far as the outer tube's");
    }
}

}  // namespace ctr
