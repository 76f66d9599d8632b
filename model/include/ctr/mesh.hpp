// Elements and possible contacts along the arc length, laid out for the kernels.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "ctr/kernel.hpp"
#include "ctr/robot.hpp"

namespace ctr {

// How finely the tubes are discretised, and how hard their contacts are. Elements are small where contact forces
// concentrate: at pair ends, entries and section joints. Lengths in m.
struct Accuracy {
    double finest = 2e-3;           // element length at tips of overlaps
    double coarsest = 6e-3;         // element length far away
    double growth = 0.4;            // increase of the element length per distance from a tip, collar, joint or the plate
    double contact_finest = 4e-4;   // spacing of contact points at the same places
    double contact_coarsest = 2e-3;
    double barrier = 0.3;           // last barrier level, in units of BarrierPath
    double refinement = 1;          // of the elements of tubes by themselves
    bool exact = false;             // finish on the exact geometry, exact_geometry.hpp
    bool operator==(const Accuracy&) const = default;
    static Accuracy search() { return {}; }
    static Accuracy certificate() { return {5e-4, 2.5e-3, 0.2, 1.25e-4, 5e-4, 0.027}; }
    static Accuracy exact_geometry() {
        Accuracy made = certificate();
        made.exact = true;
        made.barrier = 1.5e-4;
        return made;
    }
    // Elements and spacings of contact points shorter by a factor, those of single tubes too: for convergence studies.
    Accuracy refined(double factor) const {
        Accuracy made = *this;
        for (double* length : {&made.finest, &made.coarsest, &made.contact_finest, &made.contact_coarsest}) *length /= factor;
        made.refinement = factor;
        return made;
    }
};

// What a mesh owns; KernelProblem points into it.
struct MeshArrays {
    struct Break { double s; std::uint64_t members; };  // members: a number for each set of what stands there
    std::vector<Break> breaks_, found_;
    std::vector<double> break_s_;
    std::vector<double> s_, length_, precurvature_, stiffness_, pair_stiffness_, mixed_stiffness_, torsional_, bending_, outer_radius_;
    std::vector<double> shaft_stiffness_, shaft_angle_;
    std::vector<BendingLaw> laws_;
    std::vector<double> contact_shape_, contact_xi_, contact_weight_, contact_s_, half_square_, outer_arm_, inner_arm_, scale_;
    std::vector<int> interval_elements_;  // [interval between breaks]
    std::vector<int> node_unknowns_, element_tubes_, element_contacts_, element_unknowns_, element_regime_, contact_begin_, contact_pair_, shaft_node_;
    std::vector<std::pair<int, unsigned>> ghosts_;  // rows of stiffness beyond one for each number of tubes: tubes present, which are ghosts
    int tubes_ = 0;
    Accuracy accuracy_;
    bool has_laws_ = false;  // cross sections obey laws of their own
};

// Tubes inside the mesh are counted from the innermost; see kernel.hpp.
class Mesh : private MeshArrays {
  public:
    Mesh() = default;
    Mesh(const Mesh& other) : MeshArrays(other) { publish(); }
    Mesh(Mesh&& other) noexcept : MeshArrays(std::move(other)) { publish(); }
    Mesh& operator=(const Mesh& other) {
        MeshArrays::operator=(other);
        publish();
        return *this;
    }
    Mesh& operator=(Mesh&& other) noexcept {
        MeshArrays::operator=(std::move(other));
        publish();
        return *this;
    }
    // Rebuilds for a configuration (validated by the caller); keeps its memory.
    void build(const Robot& robot, const Configuration& q, const Accuracy& accuracy);

    // Another mesh's elements and contact points at a robot or configuration a little way off, in the same number. False where
    // collars, joints or tips meet in another order or a shaft becomes compliant.
    // Nodes keep their shares of the way between collars, joints and tips: what a path history goes along.
    bool move(const Mesh& from, const Robot& robot, const Configuration& q);
    // Nodes stand where build() would place so many: what derivatives of solutions on meshes of their own are taken along.
    bool build_like(const Mesh& from, const Robot& robot, const Configuration& q);
    bool build_elements_like(const Mesh& from, const Robot& robot, const Configuration& q);  // without contact points

    // Tubes of which only a share of the softening is left, 0: bending linearly. Until the next build() or move().
    void soften(const Robot& robot, double share);

    // Whether both have the same elements and contact points between the same collars, joints and tips.
    bool laid_out_like(const Mesh& other) const;

    const KernelProblem& problem() const { return problem_; }
    const std::vector<double>& s() const { return s_; }              // [node] arc length from the plate, m
    const std::vector<double>& breaks() const { return break_s_; }   // collars, joints, tips, the plate; ascending, m
    const std::vector<int>& element_tubes() const { return element_tubes_; }
    // True where the mean bending is free (in front of the plate); behind it tubes bend against the axis.
    bool mean_is_free(int element) const { return element_regime_[element] % 2 == 0; }
    bool has_ghosts() const { return !ghosts_.empty(); }
    bool is_ghost(int element, int tube) const {
        const int row = element_regime_[element] / 2;
        return row >= tubes_ && (ghosts_[row - tubes_].second >> tube & 1);
    }
    const BendingLaw* laws() const { return laws_.data(); }  // [tube], of linear round ones too
    const std::vector<double>& contact_s() const { return contact_s_; }
    const std::vector<double>& contact_weight() const { return contact_weight_; }

  private:
    void find_breaks(const Robot& robot, const Configuration& q);
    void count_elements(const Robot& robot, const Configuration& q);
    void place_nodes();
    bool take_layout(const Mesh& from, const Robot& robot, const Configuration& q);
    bool fill_as(const Mesh& from, const Robot& robot, const Configuration& q);
    void carry_contacts(const Mesh& from);
    void fill_elements(const Robot& robot, const Configuration& q);
    void place_contacts();
    int stiffness_row(const Robot& robot, const Configuration& q, int tubes, double middle);
    void fill_pairs(const Robot& robot);
    void fill_regimes(const Robot& robot);
    void fill_laws(const Robot& robot);
    void publish();

    KernelProblem problem_{};
};

}  // namespace ctr
