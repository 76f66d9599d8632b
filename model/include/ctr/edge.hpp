// Checking a leg: everything the planner asks about a sequence of configurations, in one call.
#pragma once

#include <vector>

#include "ctr/bound.hpp"
#include "ctr/sdf.hpp"

namespace ctr {

struct LegSample {
    double position_bound = 0;  // m
    double tangent_bound = 0;   // rad
    double stability = 0;
    double max_strain = 0;
    double clearance = 0;       // smallest over the frictionless and every corner shape, less the outer radius, m
    double motion = 0;          // largest displacement of any body point since the previous sample, m
    Vec3 tip{0, 0, 0};          // frictionless
    Vec3 tangent{0, 0, 1};
    Status status = Status::failed;
};

// A leg is abandoned at the first sample that breaks one of these; the sample itself is still reported.
struct LegLimits {
    double stability = -1e300;
    double max_strain = 1e300;
    double clearance = -1e300;
};

// Clearance of everything in front of the plate, in all shapes, at points no farther apart than `spacing`.
double clearance(const BoundSolver& bound, const SignedDistanceField& field, double spacing);

// Walks the configurations in order, each solve starting from the one before. Returns the samples made.
std::vector<LegSample> check_leg(BoundSolver& solver, const std::vector<Configuration>& configurations,
                                 const MeshDensity& density, const SignedDistanceField& field, double spacing,
                                 const LegLimits& limits);

}  // namespace ctr
