// Carrying a solution from one mesh to the next, where a translation has moved the nodes: the first guess of a warm start.
#pragma once

#include <vector>

#include "ctr/friction_solver.hpp"

namespace ctr {

// A copy of an iterate with the mesh it lives on.
class CarriedState {
  public:
    void take(const Mesh& mesh, const LaneState& state);
    // Whether the meshes have as many collars, tips and joints, so that arc lengths correspond one by one.
    bool fits(const Mesh& mesh) const { return !breaks_.empty() && mesh.breaks().size() == breaks_.size(); }
    // Fills a state on another mesh, by arc length where it does not fit; base angles must be set afterwards.
    void give(const Mesh& mesh, LaneState& state) const;

  private:
    struct PairContacts {
        std::vector<double> s, density, slack;  // multiplier per length and slack, lane fastest
    };
    double image(const std::vector<double>& breaks, double s, double& stretch) const;

    int stride_ = 1, lanes_ = 1;
    std::vector<double> breaks_, s_, unknowns_;
    std::vector<PairContacts> pairs_;
};

}  // namespace ctr
