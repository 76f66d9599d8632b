// Extrapolation of the last solutions along a path: the first guess of a warm start where the mesh keeps its layout.
#pragma once

#include <array>
#include <vector>

#include "ctr/friction_solver.hpp"

namespace ctr {

class Predictor {
  public:
    void forget() { count_ = 0; }
    bool knows_any() const { return count_ > 0; }
    // Remembers the solutions at q, instead of the oldest of three.
    void take(const Configuration& q, const Mesh& mesh, const std::vector<LaneState*>& states);
    // Whether at least two of them lie on a straight line with q, in order, on meshes laid out like this one.
    bool reaches(const Configuration& q, const Mesh& mesh);
    // Fills the state with that index, on the central path at a level [N/m]; base angles must be set afterwards.
    void give(const Mesh& mesh, std::size_t index, double level, LaneState& state) const;
    // The latest solution with that index as it was remembered, on its own mesh.
    void restore(std::size_t index, double level, LaneState& state) const;
    const Mesh& last_mesh() const { return past_[0].mesh; }
    const Configuration& last() const { return past_[0].q; }

  private:
    struct Past {
        Configuration q;
        Mesh mesh;
        std::vector<std::vector<double>> unknowns, log_slack;  // per state; [node][stride][lane], [contact][lane]
    };
    bool place(const Configuration& q, const Past& past, double& t) const;

    std::array<Past, 3> past_;  // the latest first
    std::array<double, 3> weight_{};
    int count_ = 0, used_ = 0;
};

}  // namespace ctr
