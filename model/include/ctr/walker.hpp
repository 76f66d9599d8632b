// Bounds for whoever moves step by step: each solve starts from the one before.
#pragma once

#include <memory>

#include "ctr/model.hpp"

namespace ctr {

class BoundSolver;

class Walker {
  public:
    Walker(const Robot& robot, const Accuracy& accuracy);  // throws InvalidInput for robots of too many tubes
    ~Walker();

    // The bound at a configuration, one row. Long ways are walked in steps, so that the branch is that of the path. Other
    // solutions are not looked for.
    BoundRows step(const Configuration& q);
    // A walk as ctr::check_path, from where it stands, if that is the first configuration, or stood before its last step.
    std::vector<PathSample> check_path(const std::vector<Configuration>& corners, const SignedDistanceField& field, const PathDensity& density,
                                       const PathLimits& limits, bool keep_shapes);
    // Whether the last step started from nothing: the first one, and where no solution near the last one was found.
    bool started_cold() const { return cold_; }
    int solves() const { return solves_; }  // of the last step
    BoundShapes shapes() const;             // where it stands; throws InvalidInput before the first step

  private:
    std::unique_ptr<BoundSolver> solver_;
    Robot robot_;
    Accuracy accuracy_;
    bool begun_ = false, cold_ = true;
    int solves_ = 0;
};

}  // namespace ctr
