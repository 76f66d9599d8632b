// The bound, looked up instead of solved: shapes and deviations on a regular grid over the joint coordinates that matter.
//
// A configuration is turned so that tube 1 stands at zero; what is left are the rotations of each tube against its outer
// neighbour (periodic) and the base translations that the drive moves. Between grid points shapes are interpolated by cubic,
// bounds by linear polynomials.
#pragma once

#include <vector>

#include "ctr/bound.hpp"
#include "ctr/walk.hpp"
#include "ctr/sdf.hpp"

namespace ctr {

constexpr int kStations = 24;  // points of the outermost centreline, evenly spaced from the plate (not counted) to the tip
constexpr int kMostAxes = 6;

struct FieldAxis {
    int tube = 0;          // relative rotation of this tube against the outer one, or base translation of this tube
    bool rotation = true;
    double lower = 0, step = 1;
    int count = 1;
};

// What one grid point holds.
struct FieldEntry {
    float position = 0, tangent = 0, stability = 0, strain = 0;  // m, rad, -, -
    float valid = 0;                                            // 1: stable and everything converged
    float point[kStations][3] = {};   // m, tube 1 turned to zero
    float tip_tangent[3] = {};
    float envelope[kStations] = {};   // m, largest deviation of a corner's outermost centreline
};
constexpr int kFieldFloats = sizeof(FieldEntry) / sizeof(float);

class BoundField {
  public:
    // values: [grid points, last axis fastest][kFieldFloats]. margin: added to every bound and envelope, m.
    BoundField(const Robot& robot, std::vector<FieldAxis> axes, const float* values, double margin);

    // Entry at a configuration; invalid if any grid point around it is, or if it lies off the grid. Stations counted from the
    // tip that are no multiple of `every` stay empty, and envelopes unless it is 1; then all but the tip are linear.
    FieldEntry sample(const Configuration& q, int every = 1) const;
    // As ctr::check_path, by lookup: cheap enough for tens of thousands of motions a second.
    std::vector<PathSample> check_path(const std::vector<Configuration>& corners, const SignedDistanceField& field,
                                       const PathDensity& density, const PathLimits& limits) const;

  private:
    PathSample measure(const Configuration& q, const SignedDistanceField& field, double spacing, FieldEntry& entry) const;
    double clearance(const Configuration& q, const FieldEntry& entry, const SignedDistanceField& field, double spacing) const;

    Robot robot_;
    std::vector<FieldAxis> axes_;
    std::vector<long> stride_;
    const float* values_;
    double margin_;
};

// Solves one grid point.
FieldEntry field_entry(BoundSolver& solver, const Configuration& q, const Accuracy& accuracy);

}  // namespace ctr
