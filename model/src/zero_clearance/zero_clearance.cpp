#include "ctr/zero_clearance.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "ctr/watch.hpp"

namespace ctr {
namespace {

constexpr double kTolerance = 1e-10;      // torque imbalance over EI * precurvature
constexpr double kSettled = 3e-5;         // rad; Newton's method leaves the square of its last step
constexpr double kAligned = 1.0;          // rad; pairs turned less than this against each other have one well
constexpr double kDistinct = 0.1;         // rad between the angles of different equilibria
constexpr int kMaxNewton = 12;
constexpr double kFirstCorrection = 0.35; // rad: a larger first corrector step means the predictor left the branch
constexpr double kFirstStep = 0.5, kLongestStep = 0.5, kShortestStep = 1e-5;  // of the continuation
constexpr double kBifurcationStep = 1e-3;
constexpr double kRate = 1e-3;            // m, over which the twist of a given shape is taken

double larger(double most, double value) { return value <= most ? most : value; }  // a NaN stays

}  // namespace

bool ZeroClearance::correct(double scale, double first_step_limit) {
    double previous = 1e300;
    for (int k = 0; k < kMaxNewton; ++k) {
        Watch::look();
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

// shape(t, s): angles of another configuration near by, of tubes counted from the innermost.
template <class Shape>
void ZeroClearance::begin_from(const Robot& robot, const Configuration& q, const Shape& shape) {
    build(robot, q);
    for (int k = 0; k < nodes_; ++k)
        for (int t = 0; t < n_; ++t) {
            const double s = s_[k], behind = std::max(s - kRate, 0.0);
            x_[k * ld_ + 2 * t] = k == 0 && is_clamped(t) ? base_theta_[t] : shape(t, s);
            x_[k * ld_ + 2 * t + 1] = k < nodes_ - 1 || s < end_s_[t] ? (shape(t, s + kRate) - shape(t, behind)) / (s + kRate - behind) : 0.0;
        }
}

template <class Shape>
double ZeroClearance::farthest_from(const Shape& shape) const {
    double most = 0;
    for (int k = 0; k < nodes_; ++k)
        for (int t = 0; t < n_; ++t) most = larger(most, std::fabs(x_[k * ld_ + 2 * t] - shape(t, s_[k])));
    return most;
}

// Straight from the nearest shape of the guide, each solution from the one before, by shorter steps where the next is not
// reached.
bool ZeroClearance::follow_guide(const Robot& robot, const Configuration& q) {
    const int tubes = n_;
    Configuration from;
    const std::size_t row = robot.guide->nearest(q, from);
    const GivenAngles given = robot.guide->shape(row);
    std::vector<double> turns(tubes);
    for (int t = 0; t < tubes; ++t) turns[t] = from.theta[tubes - 1 - t] - robot.guide->theta[row * tubes + tubes - 1 - t];
    const auto shape = [&](int t, double s) { return given.at(tubes - 1 - t, s) + turns[t]; };
    begin_from(robot, from, shape);
    if (!correct(1.0, 1e9) || farthest_from(shape) > kAligned) {  // the branch has none without clearance: its own shape
        begin_from(robot, q, shape);
        return false;
    }
    const double length = Guide::steps(from, q);
    double done = 0, step = length > 1 ? 1 / length : 1;
    ZeroClearance before;
    while (done < 1 && length > 0) {
        const double next = done + step > 1 - 1e-9 ? 1 : done + step;
        Configuration at = q;
        for (int i = 0; i < tubes && next < 1; ++i) {
            at.theta[i] = from.theta[i] + next * (q.theta[i] - from.theta[i]);
            at.l[i] = from.l[i] + next * (q.l[i] - from.l[i]);
        }
        std::swap(*this, before);
        begin_from(robot, at, [&](int t, double s) { return before.theta(t, s); });
        if (correct(1.0, Guide::kCorrection)) {
            done = next;
            step = std::min(2 * step, length > 1 ? 1 / length : 1.0);
            continue;
        }
        step *= 0.5;
        if (step * length < Guide::kShortest) {
            begin_from(robot, q, [&](int t, double s) { return before.theta(t, s); });
            return false;
        }
        std::swap(*this, before);
    }
    return true;
}

bool ZeroClearance::solve(const Robot& robot, const Configuration& q) {
    build(robot, q);
    iterations_ = negative_ = 0;
    unique_ = nodes_ < 2 || is_convex();
    if (nodes_ < 2) return true;
    if (!unique_ && robot.guide) {
        const bool done = follow_guide(robot, q);
        unique_ = false;
        if (!done) return false;
    } else if (!(unique_ && correct(1.0, 1e9))) {
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

double ZeroClearance::imbalance() const {
    ZeroClearance fresh = *this;
    return nodes_ < 2 ? 0.0 : fresh.assemble(1.0, false);
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
