#include "ctr/robot.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace ctr {
namespace {

[[noreturn]] void reject(const char* what, int index, double value, const char* unit, const char* rule) {
    char text[256];
    std::snprintf(text, sizeof text, "%s of tube %d = %g %s: %s", what, index + 1, value, unit, rule);
    throw InvalidInput(text);
}

constexpr double kCollarDistance = 2e-5;    // m
constexpr double kNestingTolerance = 1e-9;  // m; joint values come from decimal files

}  // namespace

const Section& section_at(const Tube& tube, double from_base, double& begin) {
    begin = 0;
    for (const Section& section : tube.sections) {
        if (from_base < begin + section.length || &section == &tube.sections.back()) return section;
        begin += section.length;
    }
    return tube.sections.back();
}

const Section& section_at(const Tube& tube, double from_base) {
    double begin;
    return section_at(tube, from_base, begin);
}

void precurvature_at(const Tube& tube, double from_base, double inside, double* v) {
    if (is_ghost(tube, inside)) {
        v[0] = v[1] = 0;
        return;
    }
    double begin;
    const Section& section = section_at(tube, inside, begin);
    const double factor = 1 + section.gradient * (2 * (from_base - begin) / section.length - 1);
    v[0] = factor * section.curvature_y;
    v[1] = -factor * section.curvature_x;
}

double tip_s(const Robot& robot, const Configuration& q) {
    const std::size_t n = robot.tubes.size();
    double last = q.l[n - 1] + robot.tubes[n - 1].length();
    for (std::size_t i = 0; i + 1 < n; ++i)
        if (robot.tubes[i + 1].retractable) last = std::max(last, q.l[i] + robot.tubes[i].length());
    return last;
}

bool is_retracted(const Robot& robot, const Configuration& q) {
    for (std::size_t i = 0; i + 1 < robot.tubes.size(); ++i)
        if (q.l[i] + robot.tubes[i].length() > q.l[i + 1] + robot.tubes[i + 1].length() + kNestingTolerance) return true;
    return false;
}

bool Robot::loaded() const {
    double weight = 0, sum = 0;
    for (const Tube& tube : tubes) weight += tube.mass_per_length;
    for (int k = 0; k < 3; ++k)
        sum += std::fabs(loads.tip_force[k]) + std::fabs(loads.tip_moment[k]) + weight * std::fabs(loads.gravity[k]);
    return sum > 0;
}

bool Robot::softens() const {
    return std::any_of(tubes.begin(), tubes.end(), [](const Tube& tube) {
        return tube.softening_fraction < 1 && tube.softening_strain < kNeverSoft;
    });
}

bool Robot::linear_round() const {
    return !softens() && std::all_of(tubes.begin(), tubes.end(), [](const Tube& tube) { return tube.ovality == 0; });
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
        if (!(std::fabs(tube.ovality) < 1)) reject("ovality", i, tube.ovality, "", "must lie between -1 and 1");
        if (!std::isfinite(tube.ovality_axis)) reject("ovality axis", i, tube.ovality_axis, "rad", "must be finite");
        if (!(tube.softening_strain > 0)) reject("softening strain", i, tube.softening_strain, "", "must be positive");
        if (!(tube.softening_fraction > 0 && tube.softening_fraction <= 1))
            reject("softening fraction", i, tube.softening_fraction, "", "must lie in (0, 1]");
        if (!(tube.shaft_compliance >= 0) || !std::isfinite(tube.shaft_compliance))
            reject("shaft compliance", i, tube.shaft_compliance, "rad/(N m)", "must not be negative");
        if (!(tube.mass_per_length >= 0) || !std::isfinite(tube.mass_per_length))
            reject("mass per length", i, tube.mass_per_length, "kg/m", "must not be negative");
        if (tube.sections.empty()) reject("number of sections", i, 0, "", "must be at least one");
        for (const Section& section : tube.sections) {
            if (!(section.length > 0) || !std::isfinite(section.length))
                reject("section length", i, section.length, "m", "must be positive and finite");
            if (!std::isfinite(section.curvature_x) || !std::isfinite(section.curvature_y))
                reject("precurvature", i, section.curvature_x + section.curvature_y, "1/m", "must be finite");
            if (!(std::fabs(section.gradient) <= 2)) reject("precurvature gradient", i, section.gradient, "", "must lie in [-2, 2]");
        }
    }
    for (int k = 0; k < 3; ++k)
        if (!std::isfinite(robot.loads.tip_force[k]) || !std::isfinite(robot.loads.tip_moment[k]) ||
            !std::isfinite(robot.loads.gravity[k]))
            throw InvalidInput("loads must be finite");
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
        // the angle of a compliant shaft's collar is an unknown, for which a node has room once
        if (robot.tubes[i].shaft_compliance > 0 && q.l[i] - q.l[i + 1] < kCollarDistance)
            reject("l_b", i + 1, q.l[i + 1], "m", "must lie 0.02 mm behind the outer tube's base, whose shaft is compliant");
        if (!robot.tubes[i + 1].retractable && q.l[i] + robot.tubes[i].length() > q.l[i + 1] + robot.tubes[i + 1].length() + kNestingTolerance)
            reject("l_b", i + 1, q.l[i + 1], "m", "must let the tube's tip reach at least as far as the outer tube's");
    }
    if (robot.loaded() && is_retracted(robot, q)) throw InvalidInput("a robot that carries loads has its tips in order");
}

}  // namespace ctr
