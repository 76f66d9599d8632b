#include "ctr/history.hpp"

#include <algorithm>
#include <cmath>

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

// What tells a robot and the accuracy of its mesh from others.
std::vector<double> identity(Robot robot, const Accuracy& accuracy) {
    std::vector<double> values{accuracy.finest, accuracy.coarsest, accuracy.growth, accuracy.contact_finest, accuracy.contact_coarsest,
                               accuracy.barrier, accuracy.refinement, accuracy.exact ? 1.0 : 0.0};
    for (const Tube& tube : robot.tubes) values.push_back(static_cast<double>(tube.sections.size()));
    std::vector<double*> all;
    const std::size_t n = robot.tubes.size();
    Configuration none{std::vector<double>(n, 0.0), std::vector<double>(n, 0.0)};
    numbers(robot, none, all);
    for (const double* value : all) values.push_back(*value);
    return values;
}

}  // namespace

History::History(const Robot& robot, const Accuracy& accuracy, const HistoryOptions& options)
    : options_(options), accuracy_(accuracy), solver_(robot), starter_(robot) {
    const int pairs = robot.count() - 1;
    for (int p = 0; p < pairs; ++p) {
        inner_arm_.push_back(robot.pairs[pairs - 1 - p].inner_outer_radius);
        outer_arm_.push_back(robot.pairs[pairs - 1 - p].outer_inner_radius);
    }
    identity_ = identity(robot, accuracy);
}

Status History::start(const Configuration& q, const std::vector<double>& phi) {
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

History::Iterate History::iterate() const {
    const KernelProblem& pb = solver_.mesh().problem();
    Iterate at;
    at.unknowns.reserve(static_cast<std::size_t>(pb.nodes) * pb.stride);
    for (int k = 0; k < pb.nodes; ++k)
        for (int i = 0; i < pb.stride; ++i) at.unknowns.push_back(state_.unknown(k, i, 0));
    for (int k = 0; k < pb.contacts; ++k) {
        at.multiplier.push_back(state_.multiplier(k, 0));
        at.slack.push_back(state_.slack(k, 0));
    }
    return at;
}

void History::put(const Iterate& at) {
    const KernelProblem& pb = solver_.mesh().problem();
    for (int k = 0; k < pb.nodes; ++k)
        for (int i = 0; i < pb.stride; ++i) state_.unknown(k, i, 0) = at.unknowns[static_cast<std::size_t>(k) * pb.stride + i];
    for (int k = 0; k < pb.contacts; ++k) {
        state_.multiplier(k, 0) = at.multiplier[k];
        state_.slack(k, 0) = at.slack[k];
    }
    has_factors_ = false;
}

History::State History::save() const {
    return {q_, solver_.mesh(), iterate(), phi_, psi_, built_breaks_, pending_slip_, status_, convergence_, identity_};
}

void History::restore(const State& saved) {
    if (saved.owner != identity_) throw InvalidInput("a saved state of a history goes with its own robot and accuracy only");
    q_ = saved.q;
    status_ = saved.status;
    phi_ = saved.phi;
    psi_ = saved.psi;
    built_breaks_ = saved.built_breaks;
    pending_slip_ = saved.pending_slip;
    convergence_ = saved.convergence;
    solver_.adopt(saved.mesh, q_, accuracy_);
    state_.resize(solver_.mesh().problem(), 1);
    put(saved.iterate);
    hold(phi_);
    publish_law();
    take_stock();
}

// Elastic energy and the torques of the actuators as they are.
void History::take_stock() {
    const KernelProblem& pb = solver_.mesh().problem();
    double level[kLanes], moment[kLanes], gap[kLanes];
    std::fill(level, level + kLanes, solver_.last_level());
    solver_.weigh_out(state_);
    kernel(1).residual(pb, state_.view(), level, moment, gap);
    elastic_ = elastic_energy();
    torque_.resize(pb.tubes);
    for (int t = 0; t < pb.tubes; ++t) torque_[t] = base_torque(t);
}

void History::remember() {
    const KernelProblem& pb = solver_.mesh().problem();
    before_.q = q_;
    before_.breaks = solver_.mesh().breaks();
    before_.s = solver_.mesh().s();
    before_.unknowns.resize(static_cast<std::size_t>(pb.nodes) * pb.stride);
    for (int k = 0; k < pb.nodes; ++k)
        for (int i = 0; i < pb.stride; ++i) before_.unknowns[static_cast<std::size_t>(k) * pb.stride + i] = state_.unknown(k, i, 0);
    before_.pairs.resize(std::max(pb.tubes - 1, 0));
    for (OldContacts& old : before_.pairs) old = {};
    for (int e = 0; e < pb.elements; ++e)
        for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k) {
            const int p = pb.contact_pair[k];
            OldContacts& old = before_.pairs[p];
            old.s.push_back(solver_.mesh().contact_s()[k]);
            old.phi.push_back(phi_[k]);
            old.psi.push_back(psi_[k]);
            for (int plane = 0; plane < 2; ++plane) old.d.push_back(offset(e, k, plane));
        }
}

bool History::try_step(const Configuration& q) {
    double most = 0;  // degrees or half millimetres
    for (std::size_t i = 0; i < q.l.size(); ++i)
        most = std::max({most, std::fabs(q.theta[i] - q_.theta[i]) / kDegree, std::fabs(q.l[i] - q_.l[i]) / 0.5e-3});
    carried_.take(solver_.mesh(), state_);
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

// Mean change of the circumferential friction state in this step, weighted by force, over what is aimed at: less where little
// is left to change, so that friction that translations release decays as it should.
double History::change_of_friction() const {
    constexpr double kLeast = 0.2;
    const KernelProblem& pb = solver_.mesh().problem();
    double forces = 1e-12, changes = 0, present = 0;
    for (int e = 0; e < pb.elements; ++e)
        for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k) {
            if (friction_[k] == 0) continue;
            const double force = state_.multiplier(k, 0) * std::hypot(offset(e, k, 0), offset(e, k, 1));
            forces += force;
            changes += force * std::fabs(state_.phi_mu(k, 0) / friction_[k] - last_phi_[k]);
            present += force * std::fabs(last_phi_[k]);
        }
    return changes / (forces * options_.state_change * std::clamp(2 * present / forces, kLeast, 1.0));
}

void History::finish_step(const Configuration& q) {
    const KernelProblem& pb = solver_.mesh().problem();
    const double elastic = elastic_energy();
    phi_.resize(pb.contacts);
    psi_.resize(pb.contacts);
    for (int e = 0; e < pb.elements; ++e)
        for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k) {
            const int pair = pb.tubes - 2 - pb.contact_pair[k];
            const double mu = solver_.robot().pairs[pair].friction, c = solver_.robot().pairs[pair].clearance;
            const double slip = slip_of(e, k), trial = last_phi_[k] + slip / options_.breakaway;
            const double norm = std::max(1.0, std::hypot(trial, next_psi_[k]));
            phi_[k] = trial / norm;
            psi_[k] = next_psi_[k] / norm;
            if (held_ && mu > 0) {
                phi_[k] = state_.phi_mu(k, 0) / mu;
                psi_[k] = std::copysign(std::min(std::fabs(psi_[k]), std::sqrt(std::max(0.0, 1 - phi_[k] * phi_[k]))), psi_[k]);
            }
            const double d = std::hypot(offset(e, k, 0), offset(e, k, 1)), force = state_.multiplier(k, 0) * d * d / c;
            const double slid = slip - options_.breakaway * (phi_[k] - last_phi_[k]);
            const double loss = mu * force * phi_[k] * slid;
            energy_.loss += loss;
            if (!held_) energy_.smallest_loss = std::min(energy_.smallest_loss, loss);
            energy_.breakaway += 0.5 * mu * force * options_.breakaway * (phi_[k] * phi_[k] - last_phi_[k] * last_phi_[k]);
        }
    for (int t = 0; t < pb.tubes; ++t) {
        const double torque = base_torque(t);
        energy_.work += 0.5 * (torque + torque_[t]) * (q.theta[pb.tubes - 1 - t] - q_.theta[pb.tubes - 1 - t]);
        torque_[t] = torque;
    }
    energy_.elastic += elastic - elastic_;
    elastic_ = elastic;
    std::fill(pending_slip_.begin(), pending_slip_.end(), 0.0);
    q_ = q;
    ++steps_;
}

void History::mean_phi(double* phi) const {
    const KernelProblem& pb = solver_.mesh().problem();
    for (int pair = 0; pair + 1 < pb.tubes; ++pair) {
        double forces = 1e-300, sum = 0;
        for (int e = 0; e < pb.elements; ++e)
            for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k) {
                if (pb.contact_pair[k] != pb.tubes - 2 - pair) continue;
                const double force = state_.multiplier(k, 0) * std::hypot(offset(e, k, 0), offset(e, k, 1));
                forces += force;
                sum += force * phi_[k];
            }
        phi[pair] = sum / forces;
    }
}

double History::slip_of(int e, int k) const {
    const KernelProblem& pb = solver_.mesh().problem();
    const int p = pb.contact_pair[k];
    const double xi = pb.contact_xi[k];
    const double theta_in = (1 - xi) * state_.unknown(e, 5 * p, 0) + xi * state_.unknown(e + 1, 5 * p, 0);
    const double theta_out = (1 - xi) * state_.unknown(e, 5 * p + 5, 0) + xi * state_.unknown(e + 1, 5 * p + 5, 0);
    return inner_arm_[p] * theta_in - outer_arm_[p] * theta_out + across_[2 * k] * offset(e, k, 0) + across_[2 * k + 1] * offset(e, k, 1) -
           reference_[k];
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
