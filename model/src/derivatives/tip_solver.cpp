#include "ctr/tip_solver.hpp"

namespace ctr {

void TipSolver::begin(const Configuration& q, const Accuracy& accuracy) {
    if (begun_ && q.theta == q_.theta && q.l == q_.l && accuracy == accuracy_) return;
    begun_ = false;  // until it has: the work may be called off
    q_ = q;
    accuracy_ = accuracy;
    zero_.solve(solver_.robot(), q);
    solver_.build(q, accuracy);
    const KernelProblem& pb = solver_.mesh().problem();
    shared_.resize(pb, 1);
    phi_.assign(solver_.robot().pairs.size() + 1, 0.0);
    shared_.set_phi(solver_.robot(), pb, 0, phi_.data());
    const BarrierPath path = BarrierPath::shared();
    solver_.start(shared_, q_, zero_, path.first);
    solver_.solve(shared_, path, &convergence_);
    shared_is_good_ = convergence_.converged;
    begun_ = true;
}

Status TipSolver::solve(const Configuration& q, const Accuracy& accuracy, const std::vector<double>& phi) {
    begin(q, accuracy);
    phi_ = phi;
    const KernelProblem& pb = solver_.mesh().problem();
    state_.resize(pb, 1);
    state_.set_phi(solver_.robot(), pb, 0, phi.data());
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
    if (convergence_.converged) solver_.finish(state_, convergence_);
    tracer_.trace(solver_, state_, 0, 1, q_.l.back(), &backbone_);
    if (!convergence_.converged) return Status::failed;
    return solver_.turns_away(state_) ? Status::unstable : Status::converged;
}

}  // namespace ctr
