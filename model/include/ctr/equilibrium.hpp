// Solutions kept so that their balance can be evaluated again, apart from the solver that found them.
#pragma once

#include <memory>
#include <vector>

#include "ctr/lane_state.hpp"
#include "ctr/mesh.hpp"
#include "ctr/robot.hpp"

namespace ctr {

class FrictionSolver;
class ZeroClearance;
struct Shape;

class Equilibrium {
  public:
    using Values = std::vector<std::vector<double>>;

    virtual ~Equilibrium() = default;
    // Largest imbalance of moments over the robot's own, EI * precurvature. theta: angles of each tube at its stations, rad;
    // force: normal forces of each pair at its contact points, N; outermost first, as a Shape has them.
    virtual double residual(const Values& theta, const Values& force) const = 0;
    // Fills in what a Shape has along its tubes.
    virtual void lay_out(Shape&) const {}
};

// Where a solve with contacts takes place: shared by the friction states of one configuration.
struct Setting {
    Robot robot;
    Configuration q;
    Accuracy accuracy;
    Mesh mesh;
};

// With clearance and friction: angles and forces as they are given, all else as it was solved for.
class ContactEquilibrium : public Equilibrium {
  public:
    ContactEquilibrium(std::shared_ptr<const Setting> setting, const LaneState& state, int lane);
    double residual(const Values& theta, const Values& force) const override;
    void lay_out(Shape& shape) const override;

  private:
    void set_angles(const Values& theta, LaneState& state) const;
    void set_forces(const Values& force, LaneState& state) const;

    std::shared_ptr<const Setting> setting_;
    LaneState::Kept kept_;
};

// Of the zero-clearance model, whose elements have no nodes at a shape's stations: from the unknowns it was solved for.
class ZeroClearanceEquilibrium : public Equilibrium {
  public:
    ZeroClearanceEquilibrium(const Robot& robot, const Configuration& q, ZeroClearance solution);
    double residual(const Values& theta, const Values& force) const override;
    void lay_out(Shape& shape) const override;

  private:
    Robot robot_;
    Configuration q_;
    std::shared_ptr<const ZeroClearance> solution_;
};

}  // namespace ctr
