// Checking a path of legs: everything the planner asks about a motion, in one call.
#pragma once

#include <algorithm>
#include <vector>

#include "ctr/bound.hpp"
#include "ctr/sdf.hpp"

namespace ctr {

struct PathSample {
    int segment = 0;            // leg the sample lies on
    double fraction = 0;        // of that leg
    double position_bound = 0;  // m
    double tangent_bound = 0;   // rad
    double stability = 0;
    double max_strain = 0;
    double clearance = 0;       // smallest over the frictionless and every corner shape, and between, less the outer radius, m
    double motion = 0;          // largest displacement of any body point in any of these shapes since the previous sample, m
    int solves = 0;             // configurations solved since the previous sample, those not accepted among them
    Vec3 tip{0, 0, 0};          // frictionless
    Vec3 tangent{0, 0, 1};
    std::vector<Vec3> corner_tips;
    std::vector<double> nearest_phi;  // friction state between the corners, interpolated, that is nearer than they are; NaN if none is
    Status status = Status::failed;
    // Of every shape, only if asked for:
    std::vector<double> body;              // x, y, z, outer radius of every point looked up, frictionless and corners
    std::vector<double> shape_stability;   // (1 + C) friction included
    std::vector<double> shape_max_strain;  // (1 + C)
};

// A path is abandoned at the first sample that breaks one of these; the sample itself is still reported.
struct PathLimits {
    double stability = -1e300;
    double max_strain = 1e300;
    double clearance = -1e300;  // m
};

// How densely a path is walked. A step is never longer than the joint steps allow, and moves no body point of any shape
// farther than `motion`, save a corner that leaps: no step is short enough for that. Where `near` is smaller, it moves
// none farther than the clearance it starts with, but at least `near`: with distances being 1-Lipschitz that is enough to
// notice an obstacle.
struct PathDensity {
    double rotation = 0.18;     // rad, any tube base
    double translation = 5e-3;  // m
    double motion = 20e-3;      // m
    double near = 2e-3;         // m
    double point_spacing = 1.5e-3;  // m, between the points of a shape that are looked up in the field
    bool between_corners = false;   // whether shapes in friction states between the corners are looked up, too, interpolated

    // Motion that a step may have which starts with a clearance.
    double allowed(double clearance) const { return std::clamp(clearance, std::min(near, motion), motion); }
};

// Clearance of everything in front of the plate, in all shapes, at points no farther apart than `spacing`.
double clearance(const BoundSolver& bound, const SignedDistanceField& field, double spacing);

// Walks the straight lines between consecutive configurations, each solve starting from the one before. The first sample
// is the first configuration; every corner of the path is a sample. A jump that no shorter step removes ends the walk as
// UNSTABLE: the robot snapped.
// Points of the body of a shape on the solver's mesh, no farther apart than `spacing`, with the outer radius: x, y, z, r appended
// to `out`. They stand at the same arc lengths for every shape of one configuration.
void collect_points(const BoundSolver& bound, const Backbone& shape, double spacing, std::vector<double>& out);

// goes_on: from the shapes that the solver has at the first configuration, where it stands there; solved from scratch otherwise.
std::vector<PathSample> check_path(BoundSolver& solver, const std::vector<Configuration>& corners, const Accuracy& mesh,
                                   const SignedDistanceField& field, const PathDensity& density, const PathLimits& limits,
                                   bool keep_shapes = false, bool goes_on = false);

}  // namespace ctr
