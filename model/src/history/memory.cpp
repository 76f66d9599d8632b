// What a history remembers of where it stands, to be kept, restored and stepped on from.
#include <algorithm>

#include "ctr/history.hpp"

namespace ctr {

// What tells this robot and the accuracy of its mesh from others.
void History::identify() {
    Robot robot = solver_.robot();
    identity_ = {accuracy_.finest, accuracy_.coarsest, accuracy_.growth, accuracy_.contact_finest, accuracy_.contact_coarsest,
                 accuracy_.barrier, accuracy_.refinement, accuracy_.exact ? 1.0 : 0.0};
    for (const Tube& tube : robot.tubes) identity_.push_back(static_cast<double>(tube.sections.size()));
    std::vector<double*> all;
    const std::size_t n = robot.tubes.size();
    Configuration none{std::vector<double>(n, 0.0), std::vector<double>(n, 0.0)};
    numbers(robot, none, all);
    for (const double* value : all) identity_.push_back(*value);
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

}  // namespace ctr
