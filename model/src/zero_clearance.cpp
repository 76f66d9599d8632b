#include "ctr/zero_clearance.hpp"

#include <algorithm>
#include <cmath>

#include "ctr/kernel.hpp"

namespace ctr {
namespace {

constexpr double kElementTurn = 0.45;      // element length times the rate at which angles decay: below 1e-6 m at the tip
constexpr double kLongestElement = 0.05;  // m
constexpr double kMergeDistance = 1e-7;   // m
constexpr double kTolerance = 1e-10;      // torque imbalance over EI * precurvature
constexpr double kSettled = 3e-5;         // rad; Newton's method leaves the square of its last step
constexpr double kAligned = 1.0;          // rad; pairs turned less than this against each other have one well
constexpr double kDistinct = 0.1;         // rad between the angles of different equilibria
constexpr double kConvexity = 1.02;       // margin for what the elements do not resolve
constexpr int kMaxNewton = 12;
constexpr double kFirstCorrection = 0.35; // rad: a larger first corrector step means the predictor left the branch
constexpr double kFirstStep = 0.5, kLongestStep = 0.5, kShortestStep = 1e-5;  // of the continuation
constexpr double kBifurcationStep = 1e-3;

#include "zero_clearance_blocks.hpp"

// Calls work with the number of tubes as a constant where it is a usual one.
template <class Work>
__attribute__((always_inline)) inline auto with_constant(int m, const Work& work) {
    switch (m) {
        case 2: return work(2);
        case 3: return work(3);
        case 4: return work(4);
        default: return work(m);
    }
}

double larger(double most, double value) { return value <= most ? most : value; }  // a NaN stays

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

void ZeroClearance::place_nodes(const Robot& robot, const std::vector<double>& breaks) {
    // beyond the second longest tube nothing twists
    const double end = n_ > 1 ? end_s_[1] : 0.0;
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
    place_nodes(robot, breaks_);
    tubes_.assign(nodes_, n_);
    v_.assign(static_cast<std::size_t>(nodes_) * kGaussPoints * n_ * 2, 0.0);
    P_.assign(static_cast<std::size_t>(n_ + 1) * n_ * n_, 0.0);
    for (int m = 1; m <= n_; ++m) {
        double total = 0;
        for (int t = 0; t < m; ++t) total += ei_[t];
        for (int t = 0; t < m; ++t)
            for (int l = 0; l < m; ++l) P_[(m * n_ + t) * n_ + l] = (t == l ? ei_[t] : 0.0) - ei_[t] * ei_[l] / total;
    }
    for (int e = 0; e + 1 < nodes_; ++e) {
        const double middle = 0.5 * (s_[e] + s_[e + 1]);
        int m = 0;
        for (int t = 0; t < n_; ++t)
            if (middle < end_s_[t]) ++m;
        tubes_[e] = m;
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

void ZeroClearance::clear_blocks() {
    std::fill(A_.begin(), A_.end(), 0.0);
    std::fill(U_.begin(), U_.end(), 0.0);
}

// The tubes behind the plate: torsion springs from the bases.
void ZeroClearance::add_transmissions(bool matrix) {
    for (int t = 0; t < n_; ++t) {
        if (is_clamped(t)) continue;
        const double k = transmission_stiffness(t);
        r_[2 * t] += k * (x_[2 * t] - base_theta_[t]);
        if (matrix) A_[2 * t * ld_ + 2 * t] += k;
    }
}

// Identity rows for angles that are fixed at the plate; returns the largest imbalance of the others.
double ZeroClearance::hold_fixed(bool matrix) {
    for (int t = 0; t < n_; ++t) {
        if (!is_clamped(t)) continue;
        const int i = 2 * t;
        r_[i] = 0;
        if (!matrix) continue;
        for (int j = 0; j < ld_; ++j) A_[i * ld_ + j] = A_[j * ld_ + i] = U_[i * ld_ + j] = 0;
        A_[i * ld_ + i] = 1;
    }
    for (int t = tubes_[0]; matrix && t < n_; ++t) A_[(2 * t + 1) * (ld_ + 1)] = 1;  // ends at the plate: no twist beyond it
    double worst = 0;
    for (int k = 0; k < nodes_; ++k) {
        const double length = s_[std::min(k + 1, nodes_ - 1)] - s_[std::max(k - 1, 0)];
        for (int i = 0; i < node_unknowns(k); ++i) worst = larger(worst, std::fabs(r_[k * ld_ + i]) / (i % 2 ? length : 1.0));
    }
    return worst;
}

double ZeroClearance::assemble(double scale, bool matrix) {
    std::fill(r_.begin(), r_.end(), 0.0);
    if (matrix) clear_blocks();
    add_transmissions(matrix);
    const int block = ld_ * ld_;
    for (int e = 0; e + 1 < nodes_; ++e) {
        const ElementData data{s_[e + 1] - s_[e], &P_[tubes_[e] * n_ * n_], gj_.data(), &v_[e * kGaussPoints * n_ * 2],
                               &x_[e * ld_], &x_[(e + 1) * ld_], &r_[e * ld_], &r_[(e + 1) * ld_],
                               &A_[e * block], &U_[e * block], &A_[(e + 1) * block], n_, ld_};
        if (matrix) with_constant(tubes_[e], [&](int m) __attribute__((always_inline)) { add_element(m, data, scale, true); });
        else with_constant(tubes_[e], [&](int m) __attribute__((always_inline)) { add_element(m, data, scale, false); });
    }
    return hold_fixed(matrix) / scale_moment_;
}

bool ZeroClearance::is_convex() {
    std::fill(r_.begin(), r_.end(), 0.0);
    clear_blocks();
    add_transmissions(true);
    const int block = ld_ * ld_;
    for (int e = 0; e + 1 < nodes_; ++e) {
        const ElementData data{s_[e + 1] - s_[e], &P_[tubes_[e] * n_ * n_], gj_.data(), &v_[e * kGaussPoints * n_ * 2],
                               &x_[e * ld_], &x_[(e + 1) * ld_], &r_[e * ld_], &r_[(e + 1) * ld_],
                               &A_[e * block], &U_[e * block], &A_[(e + 1) * block], n_, ld_};
        with_constant(tubes_[e], [&](int m) __attribute__((always_inline)) { add_least(m, data, kConvexity); });
    }
    hold_fixed(true);
    return factorise() == 0;
}

int ZeroClearance::factorise() {
    int negative = 0;
    const int block = ld_ * ld_;
    for (int k = 0; k < nodes_; ++k) {
        const int p = node_unknowns(k), q = k + 1 < nodes_ ? node_unknowns(k + 1) : 0;
        double *A = &A_[k * block], *U = &U_[k * block], *r = &r_[k * ld_], *next = A + block, *next_r = r + ld_;
        if (p == 6 && q == 6) negative += eliminate(6, 6, A, U, r, next, next_r, ld_);
        else if (p == 4 && q == 4) negative += eliminate(4, 4, A, U, r, next, next_r, ld_);
        else if (p == 8 && q == 8) negative += eliminate(8, 8, A, U, r, next, next_r, ld_);
        else negative += eliminate(p, q, A, U, r, next, next_r, ld_);
    }
    return negative;
}

void ZeroClearance::solve_system() {
    negative_ = factorise();
    const int block = ld_ * ld_;
    for (int k = nodes_ - 1; k >= 0; --k) {
        const int p = node_unknowns(k), q = k + 1 < nodes_ ? node_unknowns(k + 1) : 0;
        double* step = &step_[k * ld_];
        for (int i = p; i < ld_; ++i) step[i] = 0;
        substitute(p, q, &A_[k * block], &U_[k * block], &r_[k * ld_], step + ld_, step, ld_);
    }
}

bool ZeroClearance::correct(double scale, double first_step_limit) {
    double previous = 1e300;
    for (int k = 0; k < kMaxNewton; ++k) {
        residual_ = assemble(scale, true);
        if (!std::isfinite(residual_)) return false;
        const double imbalance = residual_;
        solve_system();
        ++iterations_;
        double largest = 0;
        for (int node = 0; node < nodes_; ++node)
            for (int t = 0; t < n_; ++t) largest = larger(largest, std::fabs(step_[node * ld_ + 2 * t]));
        if (!std::isfinite(largest)) return false;
        if (k == 0 && largest > first_step_limit) return false;
        if (k > 2 && largest > 0.9 * previous && imbalance > 1e3 * kTolerance) return false;  // not contracting: leave it
        previous = largest;
        for (std::size_t i = 0; i < x_.size(); ++i) x_[i] += step_[i];
        if (largest < kSettled) return true;
    }
    return assemble(scale, false) < kTolerance;
}

// Continuation of the precurvature, its square from 0 to 1 times the robot's own. A branch turns from minima to saddles at
// bifurcations only, which takes symmetric joints: what looks like it is a step that has left the branch, unless short
// steps say the same.
bool ZeroClearance::follow_branch() {
    double scale = 0, step = kFirstStep, tangent_step = 1;
    std::fill(tangent_.begin(), tangent_.end(), 0.0);
    int saddle = 0;
    while (scale < 1) {
        const double next = std::min(1.0, scale + step);
        best_ = x_;
        for (std::size_t i = 0; i < x_.size(); ++i) x_[i] += tangent_[i] * (next - scale) / tangent_step;
        const bool done = correct(next, kFirstCorrection);
        if (done && (negative_ <= saddle || step < kBifurcationStep)) {
            for (std::size_t i = 0; i < x_.size(); ++i) tangent_[i] = x_[i] - best_[i];
            tangent_step = next - scale;
            scale = next;
            saddle = negative_;
            step = std::min(1.5 * step, kLongestStep);
        } else {
            x_ = best_;
            step *= 0.5;
            if (step < kShortestStep) return false;
        }
    }
    return true;
}

bool ZeroClearance::solve(const Robot& robot, const Configuration& q) {
    build(robot, q);
    iterations_ = negative_ = 0;
    unique_ = nodes_ < 2 || is_convex();
    if (nodes_ < 2) return true;
    if (!(unique_ && correct(1.0, 1e9))) {
        for (int k = 0; k < nodes_; ++k)
            for (int t = 0; t < n_; ++t) {
                x_[k * ld_ + 2 * t] = base_theta_[t];
                x_[k * ld_ + 2 * t + 1] = 0;
            }
        if (!follow_branch()) return false;
    }
    residual_ = assemble(1.0, false);
    return residual_ < 10 * kTolerance;
}

// Newton's method on the full precurvature from the present angles plus `twist` [rad per tube] that grows linearly from the
// bases to the tips.
bool ZeroClearance::turn_and_correct(const std::vector<double>& twist) {
    for (int k = 0; k < nodes_; ++k)
        for (int t = 0; t < n_; ++t) x_[k * ld_ + 2 * t] += twist[t] * (s_[k] - base_l_[t]) / std::max(s_.back() - base_l_[t], 1e-9);
    iterations_ = 0;
    const bool done = correct(1.0, 1e9);
    residual_ = assemble(1.0, false);
    return done && residual_ < 10 * kTolerance;
}

int ZeroClearance::search_other(int from, ZeroClearance& other) const {
    constexpr double kTurns[] = {1.25, 1.0, 1.5, 3.0};
    constexpr int kCount = 4;
    if (unique_) return -1;
    std::vector<double> twist(n_);
    for (int attempt = from; attempt < kCount * (n_ - 1); ++attempt) {
        const int inner = attempt / kCount;  // pairs counted from the innermost
        const double tip = end_s_[inner + 1];
        const double between = std::remainder(theta(inner, tip) - theta(inner + 1, tip), 2 * 3.141592653589793);
        if (std::fabs(between) < kAligned) continue;
        for (int t = 0; t < n_; ++t) twist[t] = t <= inner ? std::copysign(kTurns[attempt % kCount], between) : 0.0;
        other = *this;
        if (!other.turn_and_correct(twist) || other.negative_pivots() > 0) continue;
        for (int t = 0; t < n_; ++t)
            if (std::fabs(other.theta(t, end_s_[t]) - theta(t, end_s_[t])) > kDistinct) return attempt;
    }
    return -1;
}

}  // namespace ctr
