// The elements of the zero-clearance model and what they are made of.
#include <algorithm>
#include <cmath>

#include "ctr/kernel.hpp"
#include "ctr/zero_clearance.hpp"

namespace ctr {
namespace {

#include "zero_clearance/angles.hpp"

constexpr double kElementTurn = 0.45;      // element length times the rate at which angles decay: below 1e-6 m at the tip
constexpr double kLongestElement = 0.05;  // m
constexpr double kMergeDistance = 1e-7;   // m

}  // namespace

bool ZeroClearance::is_clamped(int t) const { return -base_l_[t] <= kMergeDistance && shaft_[t] == 0; }

double ZeroClearance::transmission_stiffness(int t) const { return 1 / (shaft_[t] - base_l_[t] / gj_[t]); }

// Rate at which the angles decay or oscillate around a middle of an element, 1/m.
double ZeroClearance::turn_rate(const Robot& robot, double middle) const {
    double size[kMaxTubes], total = 0, most = 0;
    for (int t = 0; t < n_; ++t) {
        if (middle > end_s_[t]) {
            size[t] = 0;
            continue;
        }
        const Section& here = section_at(robot.tubes[n_ - 1 - t], middle - base_l_[t]);
        size[t] = ei_[t] * std::hypot(here.curvature_x, here.curvature_y);
        total += ei_[t];
    }
    for (int t = 0; t < n_; ++t) {
        double sum = 0;
        for (int l = 0; l < n_; ++l) sum += l != t ? size[l] : 0.0;
        most = std::max(most, size[t] * sum / (total * gj_[t]));
    }
    return std::sqrt(most);
}

void ZeroClearance::place_nodes(const Robot& robot, const std::vector<double>& breaks, bool retracted) {
    // beyond the second longest tube nothing twists
    const double end = retracted ? *std::max_element(end_s_.begin(), end_s_.end()) : n_ > 1 ? end_s_[1] : 0.0;
    s_.assign(1, 0.0);
    for (double b : breaks) {
        if (b > end + kMergeDistance) break;
        const double from = s_.back(), span = b - from;
        if (span <= kMergeDistance) continue;
        const double longest = std::min(kLongestElement, kElementTurn / std::max(turn_rate(robot, from + 0.5 * span), 1e-3));
        const int count = std::max(1, static_cast<int>(std::ceil(span / longest - 1e-9)));
        for (int k = 1; k <= count; ++k) s_.push_back(from + span * k / count);
    }
    nodes_ = static_cast<int>(s_.size());
}

// Row of P and EI for so many tubes, some of which are ghosts (bits); made where it is not there yet.
int ZeroClearance::stiffness_row(int tubes, unsigned ghosts) {
    const int row = ghosts ? static_cast<int>(P_.size()) / (n_ * n_) : tubes;
    if (ghosts) P_.resize(P_.size() + static_cast<std::size_t>(n_) * n_);
    ei_row_.resize(P_.size() / n_, 0.0);
    double total = 0;
    for (int t = 0; t < tubes; ++t) total += ei_row_[row * n_ + t] = ei_[t] * (ghosts >> t & 1 ? kGhostShare : 1.0);
    const double* EI = &ei_row_[static_cast<std::size_t>(row) * n_];
    for (int t = 0; t < tubes; ++t)
        for (int l = 0; l < tubes; ++l) P_[(row * n_ + t) * n_ + l] = (t == l ? EI[t] : 0.0) - EI[t] * EI[l] / total;
    return row;
}

void ZeroClearance::build(const Robot& robot, const Configuration& q) {
    n_ = robot.count();
    ld_ = 2 * n_;
    ei_.resize(n_);
    gj_.resize(n_);
    base_theta_.resize(n_);
    base_l_.resize(n_);
    shaft_.resize(n_);
    end_s_.resize(n_);
    breaks_.assign(1, 0.0);
    scale_moment_ = 1e-12;
    for (int t = 0; t < n_; ++t) {
        const int i = n_ - 1 - t;
        const Tube& tube = robot.tubes[i];
        ei_[t] = tube.bending_stiffness;
        gj_[t] = tube.torsional_stiffness;
        base_theta_[t] = q.theta[i];
        base_l_[t] = q.l[i];
        shaft_[t] = tube.shaft_compliance;
        double s = q.l[i];
        for (const Section& section : tube.sections) {
            s += section.length;
            if (s > 0) breaks_.push_back(s);
            scale_moment_ = std::max(scale_moment_, tube.bending_stiffness * std::hypot(section.curvature_x, section.curvature_y));
        }
        end_s_[t] = s;
    }
    std::sort(breaks_.begin(), breaks_.end());
    place_nodes(robot, breaks_, is_retracted(robot, q));
    tubes_.assign(nodes_, n_);
    row_.assign(nodes_, n_);
    v_.assign(static_cast<std::size_t>(nodes_) * kGaussPoints * n_ * 2, 0.0);
    P_.assign(static_cast<std::size_t>(n_ + 1) * n_ * n_, 0.0);
    ei_row_.clear();
    for (int m = 1; m <= n_; ++m) stiffness_row(m, 0);
    unsigned last_ghosts = 0;
    for (int e = 0; e + 1 < nodes_; ++e) {
        const double middle = 0.5 * (s_[e] + s_[e + 1]);
        int m = 0;
        unsigned ghosts = 0;
        for (int t = 0; t < n_; ++t)
            if (middle < end_s_[t]) m = t + 1;
        for (int t = 0; t < m; ++t)
            if (middle > end_s_[t]) ghosts |= 1u << t;
        tubes_[e] = m;
        row_[e] = ghosts && e > 0 && tubes_[e - 1] == m && ghosts == last_ghosts ? row_[e - 1] : stiffness_row(m, ghosts);
        last_ghosts = ghosts;
        for (int t = 0; t < m; ++t)
            for (int g = 0; g < kGaussPoints; ++g)
                precurvature_at(robot.tubes[n_ - 1 - t], s_[e] + kPoint[g] * (s_[e + 1] - s_[e]) - base_l_[t], middle - base_l_[t],
                                &v_[((e * kGaussPoints + g) * n_ + t) * 2]);
    }
    tip_s_.clear();
    tip_v_.clear();
    double s = q.l[n_ - 1];
    for (const Section& section : robot.tubes[n_ - 1].sections)
        if ((s += section.length) > s_.back()) {
            const double begin = std::max(s - section.length, s_.back()), inside = 0.5 * (begin + s) - base_l_[0];
            tip_s_.push_back(s);
            tip_v_.resize(tip_v_.size() + 4);
            precurvature_at(robot.tubes[n_ - 1], begin - base_l_[0], inside, &tip_v_[tip_v_.size() - 4]);
            precurvature_at(robot.tubes[n_ - 1], s - base_l_[0], inside, &tip_v_[tip_v_.size() - 2]);
        }
    const std::size_t vector = static_cast<std::size_t>(nodes_) * ld_, block = vector * ld_;
    x_.assign(vector, 0.0);
    r_.resize(vector);
    step_.resize(vector);
    tangent_.resize(vector);
    A_.resize(block);
    U_.resize(block);
    for (int k = 0; k < nodes_; ++k)
        for (int t = 0; t < n_; ++t) x_[k * ld_ + 2 * t] = base_theta_[t];
}

}  // namespace ctr
