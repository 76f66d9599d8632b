// Path history: the mesh moves along, and what friction remembers goes with the material points.
#include "ctr/history.hpp"

#include <algorithm>
#include <cmath>

#include "bound/carried_state.hpp"

namespace ctr {
namespace {

constexpr double kMostRenewal = 0.1;    // rad, that a new mesh may turn a tube

// Interval of ascending values that holds x, and where in it.
int locate(const std::vector<double>& values, double x, double& part) {
    const auto it = std::upper_bound(values.begin(), values.end(), x);
    const int i = std::clamp(static_cast<int>(it - values.begin()) - 1, 0, static_cast<int>(values.size()) - 2);
    part = std::clamp((x - values[i]) / (values[i + 1] - values[i]), 0.0, 1.0);
    return i;
}

// Of the inner tube of a pair, counted from the innermost.
double axial_slip(int pair, const Configuration& a, const Configuration& b) {
    const std::size_t inner = a.l.size() - 1 - pair, outer = inner - 1;
    return b.l[inner] - a.l[inner] - b.l[outer] + a.l[outer];
}

}  // namespace

double History::offset(int e, int k, int plane) const {
    const KernelProblem& pb = solver_.mesh().problem();
    const int d = 1 + 5 * pb.contact_pair[k] + plane;
    const double* N = pb.contact_shape + 4 * k;
    return N[0] * state_.unknown(e, d, 0) + N[1] * state_.unknown(e, d + 2, 0) + N[2] * state_.unknown(e + 1, d, 0) +
           N[3] * state_.unknown(e + 1, d + 2, 0);
}

// Nodes move with collars, joints and tips; where these meet in another order, or elements would be stretched far, a new mesh
// takes over.
void History::move_mesh(const Configuration& q) {
    if (solver_.move_along(q)) return;
    solver_.build(q, accuracy_);
    built_breaks_ = solver_.mesh().breaks();
    state_.resize(solver_.mesh().problem(), 1);
    carried_->give(solver_.mesh(), state_);
}

bool History::is_stretched(double most) const {
    const std::vector<double>& now = solver_.mesh().breaks();
    for (std::size_t i = 0; i + 1 < now.size(); ++i) {
        const double ratio = (now[i + 1] - now[i]) / (built_breaks_[i + 1] - built_breaks_[i]);
        if (ratio > most || ratio < 1 / most) return true;
    }
    return false;
}

// Whether collars, joints and tips meet in another order there than on the mesh.
bool History::leaves_mesh(const Configuration& q) const {
    if (q.l == q_.l) return false;
    return !Mesh().move(solver_.mesh(), solver_.robot(), q);
}

// Puts the state on the mesh that any solver would use at q, here or a very little way off. What that moves is no slip, or
// pairs that do not translate would collect it as friction; the axial slip is left to the next step.
bool History::renew_mesh(const Configuration& q) {
    const State kept = save();
    remember();
    carried_->take(solver_.mesh(), state_);
    solver_.build(q, accuracy_);
    const KernelProblem& pb = solver_.mesh().problem();
    state_.resize(pb, 1);
    carried_->give(solver_.mesh(), state_);
    std::vector<double> phi(pb.contacts), psi(pb.contacts);
    for (int k = 0; k < pb.contacts; ++k) {
        const OldContact old = old_contact(pb.contact_pair[k], solver_.mesh().contact_s()[k]);
        phi[k] = old.phi;
        psi[k] = old.psi;
    }
    hold(phi);
    solver_.set_base(state_, q);
    const BarrierPath path = BarrierPath::warm(2, solver_.last_barrier());
    solver_.recentre(state_, path.first);
    Convergence renewed;
    solver_.solve(state_, path, &renewed);
    if (!renewed.converged || largest_turn(q) > kMostRenewal) {
        restore(kept);
        return false;
    }
    convergence_ = renewed;
    has_factors_ = true;
    phi_.swap(phi);
    psi_.swap(psi);
    built_breaks_ = solver_.mesh().breaks();
    for (int p = 0; p + 1 < pb.tubes; ++p) pending_slip_[p] += axial_slip(p, q_, q);
    q_ = q;
    take_stock();
    return true;
}

double History::old_angle(int tube, double s) const {
    double part;
    const int stride = solver_.mesh().problem().stride, e = locate(before_.s, s, part);
    const double *a = &before_.unknowns[static_cast<std::size_t>(e) * stride], *b = a + stride;
    return (1 - part) * a[5 * tube] + part * b[5 * tube];
}

History::OldContact History::old_contact(int pair, double s) const {
    OldContact contact;
    const OldContacts& old = before_.pairs[pair];
    if (old.s.size() < 2) return contact;
    double part;
    const int i = locate(old.s, s, part);
    contact.phi = (1 - part) * old.phi[i] + part * old.phi[i + 1];
    contact.psi = (1 - part) * old.psi[i] + part * old.psi[i + 1];
    const double dx = (1 - part) * old.d[2 * i] + part * old.d[2 * i + 2], dy = (1 - part) * old.d[2 * i + 1] + part * old.d[2 * i + 3];
    const double size = std::hypot(dx, dy);
    if (size == 0) return contact;
    contact.direction[0] = dx / size;
    contact.direction[1] = dy / size;
    return contact;
}

// What slip is counted from: the angles that the material points now in contact had, where the contact was.
void History::refer(const Configuration& q) {
    const Mesh& mesh = solver_.mesh();
    const KernelProblem& pb = mesh.problem();
    const int n = pb.tubes;
    for (auto* values : {&friction_, &reference_, &last_phi_, &next_psi_}) values->assign(pb.contacts, 0.0);
    across_.assign(2 * static_cast<std::size_t>(pb.contacts), 0.0);
    const bool corresponds = mesh.breaks().size() == before_.breaks.size();
    for (int k = 0; k < pb.contacts; ++k) {
        const int p = pb.contact_pair[k], inner = n - 1 - p, outer = n - 2 - p;
        const double s = mesh.contact_s()[k];
        friction_[k] = solver_.robot().pairs[outer].friction;
        reference_[k] = inner_arm_[p] * old_angle(p, s - q.l[inner] + before_.q.l[inner]) -
                        outer_arm_[p] * old_angle(p + 1, s - q.l[outer] + before_.q.l[outer]);
        next_psi_[k] = (pending_slip_[p] + axial_slip(p, before_.q, q)) / options_.breakaway;
        double image = s;
        if (corresponds) {
            double part;
            const int b = locate(mesh.breaks(), s, part);
            image = before_.breaks[b] + part * (before_.breaks[b + 1] - before_.breaks[b]);
        }
        const OldContact old = old_contact(p, image);
        last_phi_[k] = old.phi;
        next_psi_[k] += old.psi;
        across_[2 * k] = -old.direction[1];
        across_[2 * k + 1] = old.direction[0];
    }
    publish_law();
}

void History::publish_law() {
    law_ = {friction_.data(), reference_.data(), across_.data(),   inner_arm_.data(),
            outer_arm_.data(), last_phi_.data(), next_psi_.data(), options_.breakaway};
}

}  // namespace ctr
