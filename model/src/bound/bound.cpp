#include "ctr/bound.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "bound/carried_state.hpp"
#include "bound/predictor.hpp"
#include "ctr/watch.hpp"

namespace ctr {
namespace {

// For all corners of a bound that Newton's method does not reach by itself: operations of an elimination, which take ten seconds
// or so.
constexpr double kFarWork = 1e10;
constexpr double kRest = 0.25;  // of it, for corners that are tried from those that were reached
constexpr int kLong = 100;  // Newton steps of a corner after which the next ones are tried from those that were reached

}  // namespace

BoundSolver::BoundSolver(const Robot& robot)
    : solver_(robot), pairs_(robot.count() - 1), predictor_(std::make_unique<Predictor>()) {
    phi_.resize(std::max(pairs_, 1));
    visit_all_corners();
}

void BoundSolver::visit_all_corners() {
    signs_.clear();
    lay_out(pairs_ < kMostTubesOfAllCorners ? 1 << pairs_ : 0);
}

void BoundSolver::visit_corners(std::vector<signed char> signs) {
    signs_ = std::move(signs);
    lay_out(pairs_ ? static_cast<int>(signs_.size()) / pairs_ : 1);
}

void BoundSolver::lay_out(int corners) {
    corners_ = corners;
    lanes_ = lanes_for(corners);
    have_solution_ = false;
    const std::size_t batches = std::max(1, (corners_ + lanes_ - 1) / lanes_);
    corner_convergence_.assign(batches * lanes_, {});
    batches_.resize(std::min(batches, batches_.size()));
    while (batches_.size() < batches) batches_.push_back(std::make_unique<LaneState>());
    if (shares_steps())
        for (const auto& batch : batches_) batch->share_steps(*batches_.front());
    states_.assign(1, &frictionless_);
    for (const auto& batch : batches_) states_.push_back(batch.get());
    corner_backbones.resize(corners_);
}

BoundSolver::~BoundSolver() = default;

void BoundSolver::prepare(const Configuration& q, const Accuracy& accuracy) {
    q_ = q;
    accuracy_ = accuracy;
    multiple_ = false;
    solver_.build(q, accuracy);
}

void BoundSolver::solve_frictionless() {
    const KernelProblem& pb = solver_.mesh().problem();
    frictionless_.resize(pb, 1);
    std::fill(phi_.begin(), phi_.end(), 0.0);
    frictionless_.set_phi(solver_.robot(), pb, 0, phi_.data());
    const BarrierPath shared = BarrierPath::shared();
    solver_.start(frictionless_, q_, zero_, shared.first);
    solver_.solve(frictionless_, shared, &frictionless_convergence_);
    const int steps = frictionless_convergence_.iterations;
    shared_is_good_ = frictionless_convergence_.converged;
    if (shared_is_good_) {
        shared_.resize(pb, 1);
        solver_.spread(frictionless_, shared_);
        solver_.solve(frictionless_, BarrierPath::onward(solver_.last_barrier()), &frictionless_convergence_);
        frictionless_convergence_.iterations += steps;
    }
    if (!frictionless_convergence_.converged) {
        solver_.start(frictionless_, q_, zero_, BarrierPath::kFirst);
        solver_.reach(frictionless_, BarrierPath::kFirst, frictionless_convergence_);
    }
    stability_ = solver_.stability(frictionless_, negative_);
}

void BoundSolver::set_corner_phi(std::size_t batch) {
    for (int lane = 0; lane < lanes_; ++lane) {
        const int corner = std::min(static_cast<int>(batch) * lanes_ + lane, corners_ - 1);  // spare lanes repeat the last
        for (int pair = 0; pair < pairs_; ++pair) phi_[pair] = sign(corner, pair);
        batches_[batch]->set_phi(solver_.robot(), solver_.mesh().problem(), lane, phi_.data());
    }
}

// From the frictionless iterate where friction states part, or from far where that was not reached; returns the way on.
BarrierPath BoundSolver::set_out(LaneState& state) {
    if (shared_is_good_) {
        solver_.spread(shared_, state);
        return BarrierPath::parted(solver_.last_barrier());
    }
    const BarrierPath path = BarrierPath::cold(solver_.last_barrier());
    solver_.start(state, q_, zero_, path.first);
    return path;
}

void BoundSolver::solve_corners() {
    const KernelProblem& pb = solver_.mesh().problem();
    grant_far_steps(1 - kRest);
    unfactored_.assign(batches_.size(), shares_steps());
    std::fill(corner_convergence_.begin(), corner_convergence_.end(), Convergence());
    is_far_.assign(corners_, false);
    for (std::size_t b = 0; b < batches_.size(); ++b) {
        Watch::tell(static_cast<double>(b) / static_cast<double>(batches_.size()));
        LaneState& state = *batches_[b];
        state.resize(pb, lanes_);
        set_corner_phi(b);
        Convergence* result = &corner_convergence_[b * lanes_];
        const BarrierPath path = set_out(state);
        solver_.solve(state, path, result);
        for (int lane = 0; lane < lanes_; ++lane)
            if (!result[lane].converged) reach_corner(b, lane);
    }
    if (!all_converged() && frictionless_convergence_.converged) reach_rest();
}

void BoundSolver::grant_far_steps(double share) {
    const KernelProblem& pb = solver_.mesh().problem();
    took_long_ = false;
    far_steps_ = static_cast<int>(share * kFarWork / (static_cast<double>(pb.nodes) * pb.stride * pb.stride * pb.stride));
}

// Within what is left of the effort granted; one friction state that is not reached leaves no bound, and no more effort.
void BoundSolver::reach_far(LaneState& state, double level, Convergence& result) {
    if (far_steps_ <= 0) return;
    const bool found = solver_.reach(state, level, result, std::min(far_steps_, FrictionSolver::kMostSteps));
    far_steps_ = found ? far_steps_ - result.iterations : 0;
}

// Where friction leaves no equilibrium near the frictionless one, or Newton's method does not find it.
void BoundSolver::reach_corner(std::size_t batch, int lane) {
    const int corner = static_cast<int>(batch) * lanes_ + lane;
    if (corner >= corners_) {  // spare lanes repeat the last corner
        corner_convergence_[corner] = corner_convergence_[corners_ - 1];
        return;
    }
    unfactored_[batch] = true;
    set_trial(corner);
    const BarrierPath path = set_out(trial_);
    Convergence& result = corner_convergence_[corner];
    const bool is_among_many = corners_ > kLanes, tries = took_long_ || is_among_many;
    if (!tries || !reach_from_neighbour(corner, result, !took_long_)) {
        if (tries) set_out(trial_);
        reach_far(trial_, path.first, result);
        took_long_ = took_long_ || result.iterations > kLong;
    }
    is_far_[corner] = result.converged;
    keep_trial(corner);
}

void BoundSolver::set_trial(int corner) {
    const KernelProblem& pb = solver_.mesh().problem();
    trial_.resize(pb, 1);
    for (int pair = 0; pair < pairs_; ++pair) phi_[pair] = sign(corner, pair);
    trial_.set_phi(solver_.robot(), pb, 0, phi_.data());
}

// As the solution of a corner; spare lanes repeat the last one.
void BoundSolver::keep_trial(int corner) {
    LaneState& batch = *batches_[corner / lanes_];
    const int lane = corner % lanes_, lanes = corner < corners_ - 1 ? lane + 1 : lanes_;
    for (int k = lane; k < lanes; ++k) {
        solver_.copy(trial_, batch, k);
        corner_convergence_[corner - lane + k] = corner_convergence_[corner];
    }
}

int BoundSolver::neighbour(int corner, int pair) const {
    if (signs_.empty()) return corner ^ (1 << (pairs_ - 1 - pair));
    for (int k = 0; k < corners_; ++k) {
        bool turned = true;
        for (int p = 0; p < pairs_ && turned; ++p) turned = (sign(k, p) == sign(corner, p)) != (p == pair);
        if (turned) return k;
    }
    return corner;
}

// Into trial_, from a corner that was reached and in which the friction of one pair has the other sign. Once friction has made
// the robot snap in one corner, which takes hundreds of steps to follow, most others lie beyond the same snap. only_far: from
// corners alone that were hard to reach as well.
bool BoundSolver::reach_from_neighbour(int corner, Convergence& result, bool only_far) {
    constexpr double kMotion = 10;  // in degrees, what turned friction is like
    const BarrierPath path = BarrierPath::warm(kMotion, solver_.last_barrier());
    for (int pair = 0; pair < pairs_ && far_steps_ > 0; ++pair) {
        const int from = neighbour(corner, pair);
        if (from == corner || !corner_convergence_[from].converged || (only_far && !is_far_[from])) continue;
        trial_.copy_lane(corner_state(from), corner_lane(from), 0, solver_.mesh().problem());
        solver_.recentre(trial_, path.first);
        solver_.solve(trial_, path, &result);
        far_steps_ -= result.iterations;
        if (result.converged && !solver_.turns_away(trial_)) return true;
    }
    return result.converged = false;
}

// Once effort is spent and some corners were reached, the others are tried from these.
void BoundSolver::reach_rest() {
    grant_far_steps(kRest);
    while (far_steps_ > 0 && reach_from_neighbours() && !all_converged()) {}
    for (int corner = 0; corner < corners_ && far_steps_ > 0 && !overtwisted(); ++corner) {
        Convergence& result = corner_convergence_[corner];
        if (result.converged) continue;
        set_trial(corner);
        const BarrierPath path = set_out(trial_);
        reach_far(trial_, path.first, result);
        keep_trial(corner);
        while (result.converged && far_steps_ > 0 && reach_from_neighbours()) {}
    }
}

// Every corner that was not reached; whether one was.
bool BoundSolver::reach_from_neighbours() {
    bool any = false;
    for (int corner = 0; corner < corners_; ++corner) {
        if (corner_convergence_[corner].converged) continue;
        Convergence result;
        set_trial(corner);
        if (!reach_from_neighbour(corner, result)) continue;
        any = true;
        corner_convergence_[corner] = result;
        unfactored_[corner / lanes_] = true;
        keep_trial(corner);
    }
    return any;
}

void BoundSolver::solve(const Configuration& q, const Accuracy& accuracy) {
    cold_ = true;
    have_solution_ = false;  // until there is one: the work may be called off
    predictor_->forget();
    zero_.solve(solver_.robot(), q);
    prepare(q, accuracy);
    solve_frictionless();
    solve_corners();
    measure();
    have_solution_ = all_converged();
}

namespace {

// Largest joint motion between two configurations, in degrees or half millimetres.
double joint_motion(const Configuration& a, const Configuration& b) {
    double most = 0;
    for (std::size_t i = 0; i < a.theta.size(); ++i)
        most = std::max({most, std::fabs(a.theta[i] - b.theta[i]) * 57.3, std::fabs(a.l[i] - b.l[i]) / 0.5e-3});
    return most;
}

}  // namespace

void BoundSolver::remember() {
    predictor_->take(q_, solver_.mesh(), states_);
}

// The last solution is carried over to the mesh of this configuration; where it is a batch, to all its lanes.
bool BoundSolver::follow_last() {
    carried_.resize(states_.size());
    for (std::size_t k = 0; k < states_.size(); ++k) {
        predictor_->restore(k, solver_.last_level(), *states_[k]);
        carried_[k].take(predictor_->last_mesh(), *states_[k]);
    }
    return carried_[0].fits(solver_.mesh()) && follow_from(false);
}

// Of one state: frictionless, then the batches. Extrapolated, or the last solution carried over to the new mesh.
bool BoundSolver::advance(std::size_t index, LaneState& state, bool predicted, Convergence* result) {
    const double last = solver_.last_barrier();
    const BarrierPath path = predicted ? BarrierPath::predicted(last) : BarrierPath::warm(joint_motion(predictor_->last(), q_), last);
    if (predicted) predictor_->give(solver_.mesh(), index, solver_.last_level(), state);
    else carried_[index].give(solver_.mesh(), state);
    solver_.set_base(state, q_);
    if (!predicted) solver_.recentre(state, path.first);
    solver_.solve(state, path, result);
    return std::all_of(result, result + state.lanes(), [](const Convergence& c) { return c.converged; });
}

bool BoundSolver::follow_from(bool predicted) {
    unfactored_.assign(batches_.size(), shares_steps());
    const KernelProblem& pb = solver_.mesh().problem();
    frictionless_.resize(pb, 1);
    std::fill(phi_.begin(), phi_.end(), 0.0);
    frictionless_.set_phi(solver_.robot(), pb, 0, phi_.data());
    if (!advance(0, frictionless_, predicted, &frictionless_convergence_)) return false;
    for (std::size_t b = 0; b < batches_.size(); ++b) {
        batches_[b]->resize(pb, lanes_);
        set_corner_phi(b);
        if (!advance(b + 1, *batches_[b], predicted, &corner_convergence_[b * lanes_])) return false;
    }
    return true;
}

void BoundSolver::follow(const Configuration& q, const Accuracy& accuracy, bool retrying) {
    if (!have_solution_) return solve(q, accuracy);
    if (!retrying) remember();
    prepare(q, accuracy);
    const bool predicted = predictor_->reaches(q, solver_.mesh()) && follow_from(true);
    if (!predicted && !follow_last()) return solve(q, accuracy);
    cold_ = false;
    stability_ = solver_.stability(frictionless_, negative_);
    measure();
}

void BoundSolver::begin_at(const Configuration& q, const Accuracy& accuracy) {
    const auto is_there = [&](const Configuration& at) { return at.theta == q.theta && at.l == q.l; };
    if (have_solution_ && all_converged() && is_there(q_)) return;
    if (have_solution_ && predictor_->knows_any() && is_there(predictor_->last())) return follow(q, accuracy, true);
    solve(q, accuracy);
}

std::vector<double> BoundSolver::shape_stabilities() {
    std::vector<double> found{stability_};
    double stability[kMostLanes];
    for (std::size_t b = 0; b < batches_.size(); ++b) {
        if (unfactored_[b]) solver_.factorise(*batches_[b]);
        solver_.stabilities(*batches_[b], stability);
        for (int lane = 0; lane < lanes_ && static_cast<int>(found.size()) <= corners_; ++lane) found.push_back(stability[lane]);
    }
    return found;
}

bool BoundSolver::all_converged() const {
    return frictionless_convergence_.converged &&
           std::all_of(corner_convergence_.begin(), corner_convergence_.end(), [](const Convergence& c) { return c.converged; });
}

Status BoundSolver::status() const {
    if (!frictionless_convergence_.converged) return frictionless_convergence_.overtwisted ? Status::overtwisted : Status::failed;
    if (negative_ > 0 || stability_ <= 0) return Status::unstable;
    return multiple_ ? Status::multiple : Status::converged;
}

Status BoundSolver::corner_status(int k) const {
    if (corner_convergence_[k].converged) return status();
    return corner_convergence_[k].overtwisted ? Status::overtwisted : Status::failed;
}

bool BoundSolver::overtwisted() const {
    return frictionless_convergence_.overtwisted ||
           std::any_of(corner_convergence_.begin(), corner_convergence_.end(), [](const Convergence& c) { return c.overtwisted; });
}

int BoundSolver::iterations() const {
    int sum = frictionless_convergence_.iterations;
    for (const Convergence& c : corner_convergence_) sum = std::max(sum, c.iterations);
    return sum;
}

void BoundSolver::measure() {
    tracer_.trace(solver_, frictionless_, 0, 1, q_.l.back(), &backbone);
    for (int k = 0; k < corners_; k += lanes_)
        tracer_.trace(solver_, corner_state(k), 0, std::min(lanes_, corners_ - k), q_.l.back(), &corner_backbones[k]);
    const std::size_t nodes = backbone.frame.size();
    envelope.assign(nodes, 0.0);
    position = tangent = 0;
    worst_corner = 0;
    max_strain = backbone.max_strain;
    for (int k = 0; k < corners_; ++k) {
        const Backbone& other = corner_backbones[k];
        max_strain = std::max(max_strain, other.max_strain);
        for (std::size_t i = 0; i < nodes; ++i) {
            const Vec3 &a = backbone.frame[i].p, &b = other.frame[i].p;
            envelope[i] = std::max(envelope[i], std::sqrt((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) + (a[2] - b[2]) * (a[2] - b[2])));
        }
        const Vec3 &a = backbone.tip.p, &b = other.tip.p;
        const double distance = std::sqrt((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) + (a[2] - b[2]) * (a[2] - b[2]));
        if (distance > position) {
            position = distance;
            worst_corner = k;
        }
        const Vec3 u = backbone.tip.tangent(), v = other.tip.tangent(), w = cross(u, v);
        tangent = std::max(tangent, std::atan2(std::sqrt(dot(w, w)), dot(u, v)));
    }
    if (!all_converged()) {
        position = tangent = std::numeric_limits<double>::quiet_NaN();
        std::fill(envelope.begin(), envelope.end(), position);
    }
}

}  // namespace ctr
