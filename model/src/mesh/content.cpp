// What tubes and pairs give the elements of a mesh: lengths, precurvatures, stiffnesses, laws.
#include <algorithm>
#include <cmath>

#include "ctr/mesh.hpp"

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"

// Shafts stiffer than this would only cost digits: they turn by less than 1e-8 rad.
constexpr double kRigidShaft = 1e-7;  // rad / (N m)

}  // namespace

void Mesh::fill_elements(const Robot& robot, const Configuration& q) {
    const int n = robot.count(), elements = static_cast<int>(s_.size()) - 1;
    length_.resize(elements);
    element_regime_.resize(elements);
    element_unknowns_.resize(elements);
    precurvature_.assign(static_cast<std::size_t>(elements) * n * 4, 0.0);
    node_unknowns_.assign(elements + 1, 0);
    shaft_stiffness_.assign(n, 0.0);
    shaft_angle_.assign(n, 0.0);
    shaft_node_.assign(n, -1);
    ghosts_.clear();
    for (int e = 0; e < elements; ++e) {
        length_[e] = s_[e + 1] - s_[e];
        const double middle = 0.5 * (s_[e] + s_[e + 1]);
        element_regime_[e] = stiffness_row(robot, q, element_tubes_[e], middle) * 2 + (middle < 0 ? 1 : 0);
        element_unknowns_[e] = 5 * element_tubes_[e] - (middle < q.l[0] ? 0 : 4);
        node_unknowns_[e + 1] = element_unknowns_[e];  // a tube that begins at a node is clamped there
        for (int t = 0; t < element_tubes_[e]; ++t) {
            const double base = q.l[n - 1 - t];
            for (int g = 0; g < 2; ++g)
                precurvature_at(robot.tubes[n - 1 - t], s_[e] + kGauss[g] * length_[e] - base, middle - base,
                                &precurvature_[((e * 2 + g) * n + t) * 2]);
            if (shaft_node_[t] >= 0) continue;
            shaft_node_[t] = e;
            shaft_angle_[t] = q.theta[n - 1 - t];
            const double compliance = robot.tubes[n - 1 - t].shaft_compliance;
            if (compliance < kRigidShaft) continue;
            shaft_stiffness_[t] = 1 / compliance;
            node_unknowns_[e] = 5 * t + 1;  // its angle there is free too
        }
    }
}

// Row of the stiffnesses of an element with so many tubes: one for each number of tubes, and one for each set of ghosts.
int Mesh::stiffness_row(const Robot& robot, const Configuration& q, int tubes, double middle) {
    const int n = robot.count();
    unsigned which = 0;
    for (int t = 0; t < tubes; ++t)
        if (ctr::is_ghost(robot.tubes[n - 1 - t], middle - q.l[n - 1 - t])) which |= 1u << t;
    if (which == 0) return tubes - 1;
    const std::pair<int, unsigned> row{tubes, which};
    const auto found = std::find(ghosts_.begin(), ghosts_.end(), row);
    const int place = static_cast<int>(found - ghosts_.begin());
    if (found == ghosts_.end()) ghosts_.push_back(row);
    return n + place;
}

void Mesh::fill_pairs(const Robot& robot) {
    const int n = robot.count();
    half_square_.resize(n);
    outer_arm_.resize(n);
    inner_arm_.resize(n);
    scale_.resize(n);
    for (int p = 0; p < n - 1; ++p) {
        const Pair& pair = robot.pairs[n - 2 - p];
        half_square_[p] = 0.5 * pair.clearance * pair.clearance;
        outer_arm_[p] = pair.outer_inner_radius / pair.clearance;
        inner_arm_[p] = pair.inner_outer_radius / pair.clearance;
        scale_[p] = pair.clearance;
    }
}

void Mesh::fill_laws(const Robot& robot) {
    const int n = robot.count();
    tubes_ = n;
    has_laws_ = !robot.linear_round() || robot.loaded();
    const int rows = n + static_cast<int>(ghosts_.size());
    laws_.resize(static_cast<std::size_t>(rows) * n);
    for (int row = 0; row < rows; ++row)
        for (int t = 0; t < n; ++t) {
            const Tube& tube = robot.tubes[n - 1 - t];
            const double knee = std::min(tube.softening_strain / tube.outer_radius, 1e50);
            laws_[row * n + t] = {bending_[row * n + t], tube.ovality, tube.ovality_axis, knee, tube.softening_fraction};
        }
}

void Mesh::soften(const Robot& robot, double share) {
    for (std::size_t i = 0; i < laws_.size(); ++i)
        laws_[i].fraction = 1 - share * (1 - robot.tubes[tubes_ - 1 - i % tubes_].softening_fraction);
}

// P = diag(EI) - EI EI^T / sum(EI) where the mean bending is free, diag(EI) behind the plate; C and D are its sums over
// the tubes inside a pair (docs/model.md).
void Mesh::fill_regimes(const Robot& robot) {
    const int n = robot.count();
    const int rows = n + static_cast<int>(ghosts_.size());
    const std::size_t size = static_cast<std::size_t>(2 * rows) * n * n;
    bending_.resize(static_cast<std::size_t>(rows) * n);
    outer_radius_.resize(bending_.size());
    for (int row = 0; row < rows; ++row)
        for (int t = 0; t < n; ++t) {
            const Tube& tube = robot.tubes[n - 1 - t];
            const bool ghost = row >= n && (ghosts_[row - n].second >> t & 1);
            bending_[row * n + t] = tube.bending_stiffness * (ghost ? kGhostShare : 1.0);
            outer_radius_[row * n + t] = ghost ? 0.0 : tube.outer_radius;
        }
    stiffness_.assign(size, 0.0);
    pair_stiffness_.assign(size, 0.0);
    mixed_stiffness_.assign(size, 0.0);
    for (int row = 0; row < rows; ++row)
        for (int guided = 0; guided < 2; ++guided) {
            const std::size_t base = static_cast<std::size_t>(row * 2 + guided) * n * n;
            const int m = row < n ? row + 1 : ghosts_[row - n].first;
            const double* EI = &bending_[static_cast<std::size_t>(row) * n];
            double total = 0;
            for (int t = 0; t < m; ++t) total += EI[t];
            for (int t = 0; t < m; ++t)
                for (int l = 0; l < m; ++l) {
                    stiffness_[base + t * n + l] = (t == l ? EI[t] : 0.0) - (guided ? 0.0 : EI[t] * EI[l] / total);
                }
            for (int p = 0; p < m; ++p)
                for (int t = 0; t < m; ++t) {
                    double sum = 0;
                    for (int l = 0; l <= p; ++l) sum += stiffness_[base + l * n + t];
                    mixed_stiffness_[base + p * n + t] = sum;
                }
            for (int p = 0; p < m; ++p)
                for (int r = 0; r < m; ++r) {
                    double sum = 0;
                    for (int l = 0; l <= r; ++l) sum += mixed_stiffness_[base + p * n + l];
                    pair_stiffness_[base + p * n + r] = sum;
                }
        }
    torsional_.resize(n);
    for (int t = 0; t < n; ++t) torsional_[t] = robot.tubes[n - 1 - t].torsional_stiffness;
}

}  // namespace ctr
