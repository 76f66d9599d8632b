#include "ctr/tip_solver.hpp"

#include <algorithm>
#include <cmath>

namespace ctr {
namespace {

constexpr double kNear = 2e-3;      // m that a tip may be off a kept one: equilibria beside each other are farther apart
constexpr double kMotion = 0.5e-3;  // m of it that counts as a unit of BarrierPath::warm()

double distance(const Vec3& a, const Vec3& b) {
    const Vec3 apart{a[0] - b[0], a[1] - b[1], a[2] - b[2]};
    return std::sqrt(dot(apart, apart));
}

}  // namespace

void TipSolver::begin(const Configuration& q, const Accuracy& accuracy) {
    if (begun_ && q.theta == q_.theta && q.l == q_.l && accuracy == accuracy_) return;
    begun_ = is_shared_ = false;  // until it has: the work may be called off
    q_ = q;
    accuracy_ = accuracy;
    zero_.solve(solver_.robot(), q);
    solver_.build(q, accuracy);
    begun_ = true;
}

void TipSolver::share() {
    if (is_shared_) return;
    const KernelProblem& pb = solver_.mesh().problem();
    shared_.resize(pb, 1);
    constexpr double none[kMaxTubes] = {};
    shared_.set_phi(solver_.robot(), pb, 0, none);
    const BarrierPath path = BarrierPath::shared();
    solver_.start(shared_, q_, zero_, path.first);
    Convergence convergence;
    solver_.solve(shared_, path, &convergence);
    shared_is_good_ = convergence.converged;
    is_shared_ = true;
}

void TipSolver::solve_cold() {
    share();
    const KernelProblem& pb = solver_.mesh().problem();
    state_.resize(pb, 1);
    state_.set_phi(solver_.robot(), pb, 0, phi_.data());
    convergence_ = {};
    if (shared_is_good_) {
        solver_.spread(shared_, state_);
        solver_.solve(state_, BarrierPath::parted(solver_.last_barrier()), &convergence_);
    }
    if (!convergence_.converged) {
        if (shared_is_good_) solver_.spread(shared_, state_);
        else solver_.start(state_, q_, zero_, BarrierPath::kFirst);
        solver_.reach(state_, shared_is_good_ ? BarrierPath::kParting : BarrierPath::kFirst, convergence_);
    }
}

// From a kept solution; false where that leads nowhere or elsewhere.
bool TipSolver::solve_near(const KeptTip& kept) {
    const KernelProblem& pb = solver_.mesh().problem();
    const double moved = distance(zero_.tip().p, kept.believed);
    if (!(moved < kNear) || accuracy_.exact || !std::equal(kept.node_unknowns.begin(), kept.node_unknowns.end(), pb.node_unknowns, pb.node_unknowns + pb.nodes) ||
        !std::equal(kept.contact_begin.begin(), kept.contact_begin.end(), pb.contact_begin, pb.contact_begin + pb.elements + 1))
        return false;
    state_.resize(pb, 1);
    state_.put(kept.state, pb);
    state_.set_phi(solver_.robot(), pb, 0, phi_.data());
    solver_.set_base(state_, q_);
    const BarrierPath path = BarrierPath::warm(moved / kMotion, solver_.last_barrier());
    solver_.recentre(state_, path.first);
    solver_.solve(state_, path, &convergence_);
    if (!convergence_.converged) return false;
    solver_.finish(state_, convergence_);
    tracer_.trace(solver_, state_, 0, 1, q_.l.back(), &backbone_);
    return convergence_.converged && !solver_.turns_away(state_) && distance(tip().p, kept.tip) < kNear;
}

void TipSolver::keep(std::unique_ptr<KeptTip>& kept) const {
    const KernelProblem& pb = solver_.mesh().problem();
    if (!kept) kept = std::make_unique<KeptTip>();
    kept->node_unknowns.assign(pb.node_unknowns, pb.node_unknowns + pb.nodes);
    kept->contact_begin.assign(pb.contact_begin, pb.contact_begin + pb.elements + 1);
    kept->state = state_.keep(0);
    kept->believed = zero_.tip().p;
    kept->tip = tip().p;
}

Status TipSolver::solve(const Configuration& q, const Accuracy& accuracy, const std::vector<double>& phi, std::unique_ptr<KeptTip>* kept) {
    begin(q, accuracy);
    phi_ = phi;
    if (kept && *kept && solve_near(**kept)) {
        keep(*kept);
        return Status::converged;
    }
    solve_cold();
    if (convergence_.converged) solver_.finish(state_, convergence_);
    tracer_.trace(solver_, state_, 0, 1, q_.l.back(), &backbone_);
    const Status status = !convergence_.converged ? Status::failed : solver_.turns_away(state_) ? Status::unstable : Status::converged;
    if (kept && status == Status::converged) keep(*kept);
    else if (kept) kept->reset();
    return status;
}

}  // namespace ctr
