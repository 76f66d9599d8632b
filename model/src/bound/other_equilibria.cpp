// Other equilibria of a configuration: of the frictionless robot, and of its corners.
#include <algorithm>
#include <cmath>
#include <limits>

#include "ctr/bound.hpp"

namespace ctr {
namespace {

constexpr double kDistinct = 0.1;  // rad between angles of different equilibria
constexpr double kSame = 1e-5;     // m between bodies of one equilibrium that was solved twice

double largest_distance(const Backbone& a, const Backbone& b) {
    double most = 0;
    for (std::size_t i = 0; i < a.frame.size(); ++i) {
        const Vec3 &p = a.frame[i].p, &r = b.frame[i].p;
        const Vec3 apart{p[0] - r[0], p[1] - r[1], p[2] - r[2]};
        most = std::max(most, dot(apart, apart));
    }
    return std::sqrt(most);
}

}  // namespace

// Equilibria of corner k from the iterate of corner k ^ turned, for every `turned` but 0. Those at which a pivot is
// negative, where the robot would not rest, do not count.
std::vector<double> BoundSolver::corners_apart(const Configuration& q, const Accuracy& accuracy) {
    solve(q, accuracy);
    std::vector<double> apart(corners_, 0.0);
    if (!all_converged()) return std::vector<double>(corners_, std::numeric_limits<double>::infinity());
    const KernelProblem& pb = solver_.mesh().problem();
    LaneState other;
    Convergence result[kMostLanes];
    Backbone shapes[kMostLanes];
    double stability[kMostLanes];
    for (int turned = 1; turned < corners_; ++turned)
        for (std::size_t b = 0; b < batches_.size(); ++b) {
            other.resize(pb, lanes_);
            for (int lane = 0; lane < lanes_; ++lane) {
                const int corner = std::min(static_cast<int>(b) * lanes_ + lane, corners_ - 1), from = corner ^ turned;
                for (int pair = 0; pair < pairs_; ++pair) phi_[pair] = sign(corner, pair);
                other.set_phi(solver_.robot(), pb, lane, phi_.data());
                other.copy_lane(corner_state(from), corner_lane(from), lane, pb);
            }
            const BarrierPath path = BarrierPath::parted(solver_.last_barrier());
            solver_.recentre(other, path.first);
            solver_.solve(other, path, result);
            tracer_.trace(solver_, other, 0, lanes_, q.l.back(), shapes);
            bool is_weighed = false;  // which nobody needs where every corner is where it was
            for (int lane = 0; lane < lanes_; ++lane) {
                const std::size_t corner = b * lanes_ + lane;
                if (corner >= apart.size() || !result[lane].converged) continue;
                const double distance = largest_distance(shapes[lane], corner_backbones[corner]);
                if (distance > kSame && !is_weighed) {
                    solver_.stabilities(other, stability);
                    is_weighed = true;
                }
                if (distance <= kSame || stability[lane] > 0) apart[corner] = std::max(apart[corner], distance);
            }
        }
    return apart;
}

void BoundSolver::search_others() {
    multiple_ = false;
    if (!frictionless_convergence_.converged) return;
    const KernelProblem& pb = solver_.mesh().problem();
    int attempt = -1;
    while (!multiple_ && (attempt = zero_.search_other(attempt + 1, other_)) >= 0) {
        trial_.resize(pb, 1);
        std::fill(phi_.begin(), phi_.end(), 0.0);
        trial_.set_phi(solver_.robot(), pb, 0, phi_.data());
        Convergence found;
        const BarrierPath path = BarrierPath::cold(solver_.last_barrier());
        solver_.start(trial_, q_, other_, path.first);
        solver_.solve(trial_, path, &found);
        int negative = 0;
        if (!found.converged || solver_.stability(trial_, negative) <= 0 || negative > 0) continue;
        for (int k = 0; k < pb.nodes; ++k)
            for (int t = 0; t < pb.tubes; ++t)
                multiple_ = multiple_ || std::fabs(trial_.unknown(k, 5 * t, 0) - frictionless_.unknown(k, 5 * t, 0)) > kDistinct;
    }
}

}  // namespace ctr
