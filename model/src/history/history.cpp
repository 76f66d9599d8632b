#include "ctr/history.hpp"

#include <algorithm>
#include <cmath>

#include "bound/carried_state.hpp"
#include "history/put_back.hpp"

namespace ctr {
namespace {

constexpr double kMostStretch = 1.2;    // of the elements between two breaks, before the mesh is made anew
constexpr double kShortestStep = 1e-3;  // of the longest
constexpr double kApart = 5e-5;         // m, that collars, joints and tips keep from each other until they change their order
constexpr double kHasty = 1.5;          // of the change of friction aimed at: a step is repeated shorter
constexpr double kUnhurried = 0.02;     // of the longest step: not for such a reason
constexpr double kDegree = 0.017453292519943295;

// Longest joint motion between two configurations in units of the longest steps.
double motion(const Configuration& a, const Configuration& b, const HistoryOptions& options) {
    double most = 0;
    for (std::size_t i = 0; i < a.theta.size(); ++i)
        most = std::max({most, std::fabs(b.theta[i] - a.theta[i]) / options.rotation, std::fabs(b.l[i] - a.l[i]) / options.translation});
    return most;
}

Configuration between(const Configuration& a, const Configuration& b, double part) {
    Configuration q = a;
    for (std::size_t i = 0; i < a.theta.size(); ++i) {
        q.theta[i] += part * (b.theta[i] - a.theta[i]);
        q.l[i] += part * (b.l[i] - a.l[i]);
    }
    return part == 1 ? b : q;
}

}  // namespace

History::History(const Robot& robot, const Accuracy& accuracy, const HistoryOptions& options)
    : options_(options), accuracy_(accuracy), solver_(robot), starter_(robot), carried_(std::make_unique<CarriedState>()) {
    const int pairs = robot.count() - 1;
    for (int p = 0; p < pairs; ++p) {
        inner_arm_.push_back(robot.pairs[pairs - 1 - p].inner_outer_radius);
        outer_arm_.push_back(robot.pairs[pairs - 1 - p].outer_inner_radius);
    }
    identify();
}

History::~History() = default;

Status History::start(const Configuration& q, const std::vector<double>& phi) {
    status_ = Status::failed;  // until it is there, if it gets there
    status_ = starter_.solve(q, accuracy_, phi);
    convergence_ = starter_.convergence();
    q_ = q;
    solver_.build(q, accuracy_);
    const KernelProblem& pb = solver_.mesh().problem();
    state_.resize(pb, 1);
    state_.set_phi(solver_.robot(), pb, 0, phi.data());
    state_.follow_slip(nullptr);
    solver_.spread(starter_.state(), state_);
    phi_.resize(pb.contacts);
    psi_.assign(pb.contacts, 0.0);
    for (int k = 0; k < pb.contacts; ++k) phi_[k] = phi[pb.tubes - 2 - pb.contact_pair[k]];
    energy_ = {};
    steps_ = snaps_ = 0;
    pending_slip_.assign(phi.size(), 0.0);
    built_breaks_ = solver_.mesh().breaks();
    publish_law();
    take_stock();
    return status_;
}

// Elastic energy and the torques of the actuators as they are.
void History::take_stock() {
    const KernelProblem& pb = solver_.mesh().problem();
    double level[kLanes], moment[kLanes], gap[kLanes];
    std::fill(level, level + kLanes, solver_.last_level());
    solver_.converge_load_moments(state_);
    kernel(1).residual(pb, state_.view(), level, moment, gap);
    elastic_ = elastic_energy();
    torque_.resize(pb.tubes);
    for (int t = 0; t < pb.tubes; ++t) torque_[t] = base_torque(t);
}

bool History::try_step(const Configuration& q) {
    double most = 0;  // degrees or half millimetres
    for (std::size_t i = 0; i < q.l.size(); ++i)
        most = std::max({most, std::fabs(q.theta[i] - q_.theta[i]) / kDegree, std::fabs(q.l[i] - q_.l[i]) / 0.5e-3});
    carried_->take(solver_.mesh(), state_);
    move_mesh(q);
    refer(q);
    solver_.set_base(state_, q);
    const BarrierPath path = BarrierPath::warm(most, solver_.last_barrier());
    solver_.recentre(state_, path.first);
    state_.follow_slip(&law_);
    solver_.solve(state_, path, &convergence_);
    return has_factors_ = convergence_.converged;
}

// Largest change of a tube's angle at any of its material points.
double History::largest_turn(const Configuration& q) const {
    const KernelProblem& pb = solver_.mesh().problem();
    double most = 0;
    for (int e = 0; e < pb.elements; ++e)
        for (int t = 0; t < pb.element_tubes[e]; ++t) {
            const int i = pb.tubes - 1 - t;
            const double s = solver_.mesh().s()[e + 1] - q.l[i] + before_.q.l[i];
            most = std::max(most, std::fabs(state_.unknown(e + 1, 5 * t, 0) - old_angle(t, s)));
        }
    return most;
}

// Where between two parts of the way the breaks change their order, kept apart from it so that no element is tiny.
History::Crossing History::find_crossing(const Configuration& from, const Configuration& target, double done, double next) const {
    double longest = 0;
    for (std::size_t i = 0; i < from.l.size(); ++i) longest = std::max(longest, std::fabs(target.l[i] - from.l[i]));
    Crossing crossing{done, next};
    while ((crossing.after - crossing.before) * longest > 0.1 * kApart) {
        const double middle = 0.5 * (crossing.before + crossing.after);
        (leaves_mesh(between(from, target, middle)) ? crossing.after : crossing.before) = middle;
    }
    crossing.before -= kApart / longest;
    if (crossing.before < done + 0.1 * kApart / longest) crossing.before = done;
    crossing.after = std::min(1.0, crossing.after + kApart / longest);
    return crossing;
}

Status History::advance(const Configuration& target) {
    return put_back_if_interrupted([&] { return move(target); });
}

Status History::move(const Configuration& target) {
    energy_ = {};
    steps_ = snaps_ = 0;
    if (status_ == Status::failed) return status_;
    const Configuration from = q_;
    const double length = motion(from, target, options_);
    if (length == 0) return status_;
    double done = 0, step = std::min(1.0, 1 / length);
    while (done < 1) {
        double next = std::min(1.0, done + step);
        if (1 - next < 0.1 * step) next = 1;
        if (leaves_mesh(between(from, target, next))) {
            const Crossing crossing = find_crossing(from, target, done, next);
            if (crossing.before > done) next = crossing.before;
            else if (renew_mesh(between(from, target, crossing.after))) {
                done = crossing.after;
                continue;
            }
        }
        const Configuration q = between(from, target, next);
        const State kept = save();
        remember();
        held_ = false;
        const bool found = try_step(q), jumped = found && largest_turn(q) > kLargestTurn;
        const double change = found ? change_of_friction() : 0;
        const bool hasty = change > kHasty && (next - done) * length > kUnhurried;
        if (hasty || ((!found || jumped) && (next - done) * length > kShortestStep)) {
            restore(kept);
            step = (found && !jumped ? std::max(0.25, 1 / change) : 0.25) * (next - done);
            continue;
        }
        if (!found || jumped) {
            ++snaps_;
            if (!found && !slide(q)) {
                restore(kept);
                return status_ = Status::failed;
            }
        }
        finish_step(q);
        if (is_stretched(next == 1 ? 1 : kMostStretch)) renew_mesh(q_);
        done = next;
        step *= std::clamp(1 / std::max(change, 1e-3), 0.5, 2.0);
        step = std::min(step, 1 / length);
    }
    if (!has_factors_) solver_.factorise(state_);
    has_factors_ = true;
    return status_ = solver_.turns_away(state_) ? Status::unstable : Status::converged;
}

}  // namespace ctr
