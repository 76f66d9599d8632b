#include "ctr/friction_solver.hpp"

#include <algorithm>
#include <cmath>

#include "contact/load_moments.hpp"
#include "exact/exact_geometry.hpp"

namespace ctr {
namespace {

constexpr double kHardClearance = 3e-3;   // of the innermost tube's length. The tip error of the barrier goes with the
                                          // clearance, rounding in the gaps with its inverse: smaller ones get a softer barrier

constexpr double kResidual = 1e-8;        // of EI * precurvature
constexpr double kMostRounding = 1e-6;    // of the same, where elements are so short that rounding leaves more
constexpr double kShort = 2e-4;            // m, elements below which rounding leaves more
constexpr double kDigits = 2048 * 2.2e-16;

// Of EI * precurvature, N m.
double largest_moment(const Robot& robot) {
    double largest = 1e-9;
    for (const Tube& tube : robot.tubes)
        for (const Section& section : tube.sections)
            largest = std::max(largest, tube.bending_stiffness * std::hypot(section.curvature_x, section.curvature_y));
    return largest;
}

}  // namespace

double FrictionSolver::barrier_unit(const Robot& robot) {
    const double length = robot.tubes.back().length();
    return largest_moment(robot) / (length * length);
}

FrictionSolver::FrictionSolver(const Robot& robot) : robot_(robot) {
    if (robot.loaded()) loads_ = std::make_unique<LoadMoments>();
}

FrictionSolver::~FrictionSolver() = default;

void FrictionSolver::build(const Configuration& q, const Accuracy& accuracy) {
    mesh_.build(robot_, q, accuracy);
    scale(q, accuracy);
}

void FrictionSolver::adopt(const Mesh& mesh, const Configuration& q, const Accuracy& accuracy) {
    mesh_ = mesh;
    scale(q, accuracy);
}

void FrictionSolver::scale(const Configuration& q, const Accuracy& accuracy) {
    base_l_ = q.l.back();
    loads_first_ = false;
    last_barrier_ = accuracy.barrier;
    is_exact_ = accuracy.exact;
    if (is_exact_) {
        double clearance = 0;
        for (const Pair& pair : robot_.pairs) clearance = std::max(clearance, pair.clearance);
        const double hard = kHardClearance * robot_.tubes.back().length();
        if (clearance > 0) last_barrier_ *= std::clamp(hard / clearance, 1.0, 10.0);
        if (!exact_) exact_ = std::make_unique<ExactGeometry>();
        exact_->build(*this, q);
    }
    moment_scale_ = largest_moment(robot_);
    barrier_unit_ = barrier_unit(robot_);
    tolerance_ = std::clamp(rounding(), kResidual, kMostRounding);
}

// What the digits of the offsets leave of the balance: they are of the size of clearances, and the curvature of an element
// takes their differences over the square of its length.
double FrictionSolver::rounding() const {
    double clearance = 0, stiffest = 0, shortest = 1e300;
    for (const Pair& pair : robot_.pairs) clearance += pair.clearance;
    for (const Tube& tube : robot_.tubes) stiffest = std::max(stiffest, tube.bending_stiffness);
    for (int e = 0; e < mesh_.problem().elements; ++e) shortest = std::min(shortest, mesh_.problem().length[e]);
    if (shortest > kShort) return 0;
    return kDigits * stiffest * clearance / (shortest * shortest) / moment_scale_;
}

bool FrictionSolver::take(const FrictionSolver& from, const Robot& robot, const Configuration& q) {
    robot_ = robot;
    moment_scale_ = from.moment_scale_;
    tolerance_ = from.tolerance_;
    barrier_unit_ = barrier_unit(robot);
    last_barrier_ = from.last_barrier_;
    base_l_ = q.l.back();
    if (!robot.loaded()) loads_ = nullptr;
    else if (!loads_) loads_ = std::make_unique<LoadMoments>();
    return mesh_.build_like(from.mesh_, robot, q);
}

bool FrictionSolver::move_along(const Configuration& q) {
    base_l_ = q.l.back();
    std::swap(mesh_, left_);
    if (mesh_.move(left_, robot_, q)) return true;
    std::swap(mesh_, left_);
    return false;
}

// angle(t, s): of a tube counted from the innermost at an arc length.
template <class Angle>
void FrictionSolver::fill_lane(LaneState& state, int lane, const Configuration& q, const Angle& angle, double level) {
    const KernelProblem& pb = mesh_.problem();
    const int n = robot_.count();
    for (int k = 0; k < pb.nodes; ++k) {
        for (int i = 0; i < pb.stride; ++i) state.unknown(k, i, lane) = 0;
        for (int t = 0; t < n; ++t) state.unknown(k, 5 * t, lane) = k <= pb.shaft_node[t] ? q.theta[n - 1 - t] : angle(t, mesh_.s()[k]);
    }
    for (int k = 0; k < pb.contacts; ++k) {
        const int p = pb.contact_pair[k];
        state.slack(k, lane) = pb.half_square_clearance[p];
        state.multiplier(k, lane) = level * barrier_unit_ * pb.barrier_scale[p] * pb.contact_weight[k] / pb.half_square_clearance[p];
    }
}

void FrictionSolver::start(LaneState& state, const Configuration& q, const ZeroClearance& guess, double level) {
    state.forget_exact();
    for (int lane = 0; lane < state.lanes(); ++lane)
        fill_lane(state, lane, q, [&](int t, double s) { return guess.theta(t, s); }, level);
}

void FrictionSolver::start_lane(LaneState& state, int lane, const Configuration& q, const GivenAngles& guess, double level) {
    state.forget_exact();
    fill_lane(state, lane, q, [&](int t, double s) { return guess.at(robot_.count() - 1 - t, s); }, level);
}

void FrictionSolver::read_angles(const LaneState& state, int lane, const GivenAngles& like, std::vector<double>& theta) const {
    const KernelProblem& pb = mesh_.problem();
    const std::vector<double>& s = mesh_.s();
    std::vector<double> own_s, own;
    for (int t = pb.tubes - 1; t >= 0; --t) {
        own_s.clear();
        own.clear();
        for (int k = 0; k < pb.nodes; ++k) {
            if (k > pb.shaft_node[t] && 5 * t >= pb.node_unknowns[k]) continue;  // beyond its end
            own_s.push_back(s[k]);
            own.push_back(state.unknown(k, 5 * t, lane));
        }
        const GivenAngles along{own_s.data(), own.data(), own_s.size()};
        for (std::size_t k = 0; k < like.count; ++k) theta.push_back(along.at(0, like.s[k]));
    }
}

void FrictionSolver::spread(const LaneState& from, LaneState& to) const {
    for (int lane = 0; lane < to.lanes(); ++lane) copy(from, to, lane);
}

void FrictionSolver::copy(const LaneState& from, LaneState& to, int lane) const {
    const KernelProblem& pb = mesh_.problem();
    for (int k = 0; k < pb.nodes; ++k)
        for (int i = 0; i < pb.stride; ++i) to.unknown(k, i, lane) = from.unknown(k, i, 0);
    for (int k = 0; k < pb.contacts; ++k) {
        to.multiplier(k, lane) = from.multiplier(k, 0);
        to.slack(k, lane) = from.slack(k, 0);
    }
    to.copy_exact(from, pb, lane);
}

void FrictionSolver::recentre(LaneState& state, double level) {
    const KernelProblem& pb = mesh_.problem();
    for (int k = 0; k < pb.contacts; ++k) {
        const double eps = level * barrier_unit_ * pb.barrier_scale[pb.contact_pair[k]] * pb.contact_weight[k];
        const double balanced = std::sqrt(eps);
        for (int lane = 0; lane < state.lanes(); ++lane) {
            double &lambda = state.multiplier(k, lane), &w = state.slack(k, lane);
            if (lambda * pb.half_square_clearance[pb.contact_pair[k]] > eps && lambda * balanced > w) w = eps / lambda;  // in contact: keep the force
            else lambda = eps / w;
        }
    }
}

void FrictionSolver::set_base(LaneState& state, const Configuration& q) {
    const KernelProblem& pb = mesh_.problem();
    for (int k = 0; k < pb.nodes; ++k)
        for (int t = 0; t < pb.tubes; ++t) {
            // by node: where breaks were merged, a collar and the node it became stand at different arc lengths
            if (k > pb.shaft_node[t] || 5 * t < pb.node_unknowns[k]) continue;  // an unknown there
            for (int lane = 0; lane < state.lanes(); ++lane) state.unknown(k, 5 * t, lane) = q.theta[pb.tubes - 1 - t];
        }
    // A tube is clamped in the middle of the next one where that begins. A state that was carried from another mesh may have
    // an offset there, of a place beside: nothing would take it back, and the shapes of a long history would drift.
    for (int pair = 0; pair + 1 < pb.tubes; ++pair)
        for (int k = 0; k < pb.nodes && 1 + 5 * pair >= pb.node_unknowns[k]; ++k)
            for (int i = 1 + 5 * pair; i < 5 + 5 * pair; ++i)
                for (int lane = 0; lane < state.lanes(); ++lane) state.unknown(k, i, lane) = 0;
}

}  // namespace ctr
