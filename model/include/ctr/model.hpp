// A robot and its solvers, for whoever asks, on as many threads as they like: shapes, bounds and tips of one configuration or
// of many. Configurations must be valid; `threads` = 0 takes every core.
#pragma once

#include <memory>
#include <vector>

#include "ctr/robot.hpp"
#include "ctr/sensitivities.hpp"
#include "ctr/shape.hpp"
#include "ctr/walk.hpp"

namespace ctr {

class SolverPool;
struct TipMemory;  // tip_solver.hpp

// The friction bound with the shapes that it is between.
struct BoundShapes {
    double position = 0, tangent = 0;  // m, rad
    Shape frictionless;
    std::vector<Shape> corners;
    std::vector<double> phi;           // [corner][pair] signs in itertools.product((1, -1)) order, outermost pair first
    std::vector<double> envelope;      // (N) m
    int worst_corner = 0;
};

// Tips of K configurations.
struct TipRows {
    explicit TipRows(std::size_t rows) : tip(rows), tangent(rows), status(rows, Status::failed) {}
    std::vector<Vec3> tip, tangent;
    std::vector<Status> status;
};

// Bounds of K configurations: NaN where a solve failed, all but residual and status where the frictionless one did.
struct BoundRows : TipRows {
    explicit BoundRows(std::size_t rows);
    std::vector<double> position_bound, tangent_bound, stability, max_strain, residual;
};

// Tips of K friction states, and their derivatives by P parameters: [row][plane][parameter], NaN where there are none.
struct FrictionTipRows : TipRows {
    FrictionTipRows(std::size_t rows, std::size_t parameters);
    std::vector<double> residual, max_strain;
    std::vector<double> tip_by, tangent_by;
    std::size_t parameters;
};

// Zero-clearance shapes of K configurations in front of the plate: clearance [m], -inf without a stable solution.
struct ClearanceRows {
    explicit ClearanceRows(std::size_t rows) : clearance(rows), tip(rows) {}
    std::vector<double> clearance;
    std::vector<Vec3> tip;
};

// The outermost centreline in front of the plate, of the frictionless shape and every corner.
struct Body {
    std::vector<Vec3> point;     // [shape][N] m
    std::vector<double> radius;  // (N) m
    std::size_t shapes = 0;
};

// Bodies of S friction states of one configuration: N points each, at the same arc lengths.
struct FrictionBodies {
    std::vector<double> point;       // [state][N][4] m: position and outer radius
    std::vector<Status> status;      // (S) converged or failed
    std::vector<double> max_strain;  // (S)
    std::vector<double> stability;   // (S), as FrictionSolver::stabilities
};

// Equilibria in friction states that were solved from given shapes.
struct BranchRows : TipRows {
    explicit BranchRows(std::size_t rows) : TipRows(rows) {}
    std::vector<double> stability, theta;  // (S), as FrictionSolver::stabilities; [state][tube][K] where they were given
};

class Model {
  public:
    explicit Model(const Robot& robot);  // throws InvalidInput
    ~Model();
    const Robot& robot() const { return robot_; }

    Shape zero_clearance(const Configuration& q) const;
    Shape solve(const Configuration& q, const Accuracy& accuracy, const std::vector<double>& phi);  // phi per pair, outermost first
    // Over all corners, or over those that move the tip farthest, which may miss a part of the bound but take n^2 solves at most.
    // Throws InvalidInput, as all that needs all corners, for robots of too many tubes.
    BoundShapes bound(const Configuration& q, const Accuracy& accuracy, bool extremes_only = false);
    Body body(const Configuration& q, const Accuracy& accuracy);
    // The frictionless robot, from which bodies in friction states are solved, with points no farther apart than `spacing`.
    FrictionlessStart begin_states(const Configuration& q, const Accuracy& accuracy);
    FrictionBodies friction_bodies(const FrictionlessStart& start, const FrictionStates& states, double spacing);
    // From given shapes: unstable where the robot would turn away from the solution.
    BranchRows solve_from(const Configuration& q, const Accuracy& accuracy, const GivenShapes& given);
    // (C) m, see BoundSolver.
    std::vector<double> corners_apart(const Configuration& q, const Accuracy& accuracy);
    std::vector<PathSample> check_path(const std::vector<Configuration>& corners, const Accuracy& accuracy, const SignedDistanceField& field,
                                       const PathDensity& density, const PathLimits& limits, bool keep_shapes);

    BoundRows bounds(const std::vector<Configuration>& all, const Accuracy& accuracy, int threads);
    TipRows zero_clearance_tips(const std::vector<Configuration>& all, int threads);
    ClearanceRows zero_clearance_clearances(const std::vector<Configuration>& all, const SignedDistanceField& field, double spacing, int threads);
    // phi: [row][pair], outermost pair first. Rows of one configuration that follow each other share their mesh.
    // memory: solutions near which those of as many places, one a row, are sought.
    FrictionTipRows friction_tips(const std::vector<Configuration>& all, const double* phi, const std::vector<Direction>& directions,
                                  const Accuracy& accuracy, int threads, TipMemory* memory = nullptr,
                                  const std::vector<std::size_t>& places = {}) const;
    // The body in one friction state; without any point where it has no solution.
    BodyDerivatives body_derivatives(const Configuration& q, const Accuracy& accuracy, const std::vector<double>& phi,
                                     const std::vector<Direction>& directions, double spacing) const;

  private:
    Robot robot_;
    std::unique_ptr<SolverPool> solvers_;
};

}  // namespace ctr
