// What tip loads and weight ask of the common curvature: their moment about every cross section in front of the plate.
#pragma once

#include <vector>

#include "ctr/friction_solver.hpp"
#include "ctr/shape.hpp"

namespace ctr {

// Moments of the loads beyond a cross section on the present shape of each lane, filled into the state. They depend on the
// shape, so that a solve repeats this between its Newton steps; nothing is done for a robot without loads.
class LoadMoments {
  public:
    // Loads and weights are those of `robot`. The moments bend the shape that they are taken from. changes, per lane: by how
    // much they differ at most from those before, over the largest and the robot's own.
    void update(const FrictionSolver& solver, const Robot& robot, LaneState& state, double base_l, double* changes);

  private:
    Backbone backbone_;
    BackboneTracer tracer_;
};

}  // namespace ctr
