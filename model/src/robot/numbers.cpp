// Every number of a robot and of a configuration, in one order, and its name.
#include <string>

#include "ctr/sensitivities.hpp"

namespace ctr {

std::vector<std::string> number_names(const Robot& robot) {
    std::vector<std::string> names;
    const int n = robot.count();
    for (int i = 0; i < n; ++i) {
        const std::string tube = "tube." + std::to_string(i + 1) + ".";
        for (const char* name : {"outer_radius", "inner_radius", "bending_stiffness", "torsional_stiffness", "ovality", "ovality_axis",
                                 "softening_strain", "softening_fraction", "shaft_compliance", "mass_per_length"})
            names.push_back(tube + name);
        for (std::size_t k = 0; k < robot.tubes[i].sections.size(); ++k)
            for (const char* name : {"length", "curvature_x", "curvature_y", "gradient"})
                names.push_back(tube + "section." + std::to_string(k + 1) + "." + name);
    }
    for (int i = 0; i + 1 < n; ++i)
        for (const char* name : {"clearance", "friction", "outer_inner_radius", "inner_outer_radius"})
            names.push_back("pair." + std::to_string(i + 1) + "." + name);
    for (const char* name : {"tip_force", "tip_moment", "gravity"})
        for (int k = 1; k <= 3; ++k) names.push_back(std::string("loads.") + name + "." + std::to_string(k));
    for (const char* name : {"theta_b.", "l_b."})
        for (int i = 1; i <= n; ++i) names.push_back(name + std::to_string(i));
    return names;
}

void numbers(Robot& robot, Configuration& q, std::vector<double*>& all) {
    all.clear();
    for (Tube& t : robot.tubes) {
        for (double* value : {&t.outer_radius, &t.inner_radius, &t.bending_stiffness, &t.torsional_stiffness, &t.ovality, &t.ovality_axis,
                              &t.softening_strain, &t.softening_fraction, &t.shaft_compliance, &t.mass_per_length})
            all.push_back(value);
        for (Section& s : t.sections)
            for (double* value : {&s.length, &s.curvature_x, &s.curvature_y, &s.gradient}) all.push_back(value);
    }
    for (Pair& p : robot.pairs)
        for (double* value : {&p.clearance, &p.friction, &p.outer_inner_radius, &p.inner_outer_radius}) all.push_back(value);
    for (double* vector : {robot.loads.tip_force, robot.loads.tip_moment, robot.loads.gravity})
        for (int k = 0; k < 3; ++k) all.push_back(vector + k);
    for (double& value : q.theta) all.push_back(&value);
    for (double& value : q.l) all.push_back(&value);
}

}  // namespace ctr
