#include "ctr/mesh.hpp"

#include <algorithm>
#include <cmath>

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"
#include "mesh/merge_distance.hpp"

}  // namespace

void Mesh::build(const Robot& robot, const Configuration& q, const Accuracy& accuracy) {
    accuracy_ = accuracy;
    find_breaks(robot, q);
    count_elements(robot, q);
    place_nodes();
    fill_elements(robot, q);
    place_contacts();
    fill_pairs(robot);
    fill_regimes(robot);
    fill_laws(robot);
    publish();
}

bool Mesh::laid_out_like(const Mesh& other) const {
    return element_tubes_ == other.element_tubes_ && element_contacts_ == other.element_contacts_ && node_unknowns_ == other.node_unknowns_ &&
           std::equal(breaks_.begin(), breaks_.end(), other.breaks_.begin(), other.breaks_.end(),
                      [](const Break& a, const Break& b) { return a.members == b.members; });
}

bool Mesh::take_layout(const Mesh& from, const Robot& robot, const Configuration& q) {
    find_breaks(robot, q);
    if (!std::equal(breaks_.begin(), breaks_.end(), from.breaks_.begin(), from.breaks_.end(),
                    [](const Break& a, const Break& b) { return a.members == b.members; }))
        return false;
    accuracy_ = from.accuracy_;
    interval_elements_ = from.interval_elements_;
    element_tubes_ = from.element_tubes_;
    element_contacts_ = from.element_contacts_;
    return true;
}

bool Mesh::fill_as(const Mesh& from, const Robot& robot, const Configuration& q) {
    fill_elements(robot, q);
    fill_pairs(robot);
    fill_regimes(robot);
    fill_laws(robot);
    publish();
    return node_unknowns_ == from.node_unknowns_;
}

bool Mesh::build_elements_like(const Mesh& from, const Robot& robot, const Configuration& q) {
    if (!take_layout(from, robot, q)) return false;
    place_nodes();
    return fill_as(from, robot, q);
}

bool Mesh::build_like(const Mesh& from, const Robot& robot, const Configuration& q) {
    if (!build_elements_like(from, robot, q)) return false;
    carry_contacts(from);
    return true;
}

bool Mesh::move(const Mesh& from, const Robot& robot, const Configuration& q) {
    if (!take_layout(from, robot, q)) return false;
    s_.resize(from.s_.size());
    const std::vector<double>& breaks = from.break_s_;
    std::size_t b = 0;
    for (std::size_t k = 0; k < s_.size(); ++k) {
        const double s = from.s_[k];
        while (b + 2 < breaks.size() && s > breaks[b + 1] - 0.5 * kMergeDistance) ++b;  // a node on a break stays exactly there
        s_[k] = break_s_[b] + (s - breaks[b]) / (breaks[b + 1] - breaks[b]) * (break_s_[b + 1] - break_s_[b]);
    }
    if (!fill_as(from, robot, q)) return false;
    carry_contacts(from);
    return true;
}

void Mesh::carry_contacts(const Mesh& from) {
    contact_begin_ = from.contact_begin_;
    contact_pair_ = from.contact_pair_;
    contact_xi_ = from.contact_xi_;
    for (auto [mine, theirs] : {std::pair{&contact_weight_, &from.contact_weight_}, {&contact_s_, &from.contact_s_}, {&contact_shape_, &from.contact_shape_}})
        mine->resize(theirs->size());
    for (std::size_t e = 0; e < length_.size(); ++e)
        for (int k = contact_begin_[e]; k < contact_begin_[e + 1]; ++k) {
            contact_weight_[k] = from.contact_weight_[k] * (length_[e] / from.length_[e]);
            contact_s_[k] = s_[e] + contact_xi_[k] * length_[e];
            hermite(contact_xi_[k], length_[e], &contact_shape_[4 * k]);
        }
    publish();
}

void Mesh::publish() {
    problem_.tubes = tubes_;
    problem_.nodes = static_cast<int>(s_.size());
    problem_.elements = static_cast<int>(length_.size());
    problem_.contacts = static_cast<int>(contact_pair_.size());
    problem_.stride = 5 * problem_.tubes - 4;
    problem_.node_unknowns = node_unknowns_.data();
    problem_.element_tubes = element_tubes_.data();
    problem_.element_unknowns = element_unknowns_.data();
    problem_.element_regime = element_regime_.data();
    problem_.length = length_.data();
    problem_.precurvature = precurvature_.data();
    problem_.stiffness = stiffness_.data();
    problem_.pair_stiffness = pair_stiffness_.data();
    problem_.mixed_stiffness = mixed_stiffness_.data();
    problem_.torsional_stiffness = torsional_.data();
    problem_.bending_stiffness = bending_.data();
    problem_.outer_radius = outer_radius_.data();
    problem_.law = has_laws_ ? laws_.data() : nullptr;
    problem_.shaft_stiffness = shaft_stiffness_.data();
    problem_.shaft_angle = shaft_angle_.data();
    problem_.shaft_node = shaft_node_.data();
    problem_.contact_begin = contact_begin_.data();
    problem_.contact_pair = contact_pair_.data();
    problem_.contact_shape = contact_shape_.data();
    problem_.contact_xi = contact_xi_.data();
    problem_.contact_weight = contact_weight_.data();
    problem_.half_square_clearance = half_square_.data();
    problem_.outer_torque_arm = outer_arm_.data();
    problem_.inner_torque_arm = inner_arm_.data();
    problem_.barrier_scale = scale_.data();
}

}  // namespace ctr
