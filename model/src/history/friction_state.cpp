// How far the friction of contacts follows their slip in a step, and what that costs in energy.
#include <algorithm>
#include <cmath>

#include "ctr/history.hpp"

namespace ctr {

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

}  // namespace ctr
