// Iterates of one or four friction states, as the kernels take them.
#include <algorithm>

#include "ctr/friction_solver.hpp"

namespace ctr {
namespace {
#include "mesh/element_functions.hpp"
}  // namespace

void LaneState::resize(const KernelProblem& problem, int lanes) {
    lanes_ = lanes;
    stride_ = problem.stride;
    block_stride_ = lanes == 1 ? stride_ / 4 * 4 + 4 : stride_ + 1;
    const std::size_t vector = static_cast<std::size_t>(problem.nodes) * stride_ * lanes, block = vector * block_stride_;
    const std::size_t contacts = static_cast<std::size_t>(problem.contacts) * lanes + kLanes;
    unknowns_.resize(vector);
    StepMemory& memory = *memory_;
    for (AlignedArray* step : {&memory.step, &memory.corrected_step}) {  // with finite values behind the end
        step->resize(vector + kLanes);
        std::fill(step->data() + vector, step->data() + vector + kLanes, 0.0);
    }
    memory.rhs.resize(vector);
    for (AlignedArray* blocks : {&memory.diagonal, &memory.upper, &memory.lower}) blocks->resize(block);
    for (AlignedArray* values : {&memory.multiplier_step, &memory.slack_step, &memory.corrected_multiplier_step, &memory.corrected_slack_step})
        values->resize(contacts);
    for (AlignedArray* values : {&multiplier_, &slack_, &phi_mu_}) values->resize(contacts);
    tubes_ = problem.tubes;
    load_moment_.resize((static_cast<std::size_t>(problem.elements) * 4 * tubes_ + 1) * lanes);
    load_moment_.fill(0.0);
    is_exact_ = false;
}

void LaneState::begin_exact(const KernelProblem& problem) {
    shift_.resize((static_cast<std::size_t>(problem.contacts) * lanes_ + kLanes) * 2);
    load_.resize(static_cast<std::size_t>(problem.nodes) * stride_ * lanes_);
    tubes_ = problem.tubes;
    bend_.resize(static_cast<std::size_t>(problem.elements) * 4 * tubes_ * lanes_);
    need_.resize(static_cast<std::size_t>(problem.nodes) * tubes_ * 2 * lanes_);
    for (AlignedArray* values : {&shift_, &load_, &bend_, &need_}) values->fill(0.0);
    is_exact_ = true;
}

void LaneState::copy_exact(const LaneState& from, const KernelProblem& problem, int lane) {
    if (!from.is_exact_ && lanes_ == 1) is_exact_ = false;
    if (!from.is_exact_ && !is_exact_) return;
    if (!is_exact_) begin_exact(problem);
    auto copy = [&](const AlignedArray& values, AlignedArray& to, std::size_t count) {
        for (std::size_t i = 0; i < count; ++i) to[i * lanes_ + lane] = from.is_exact_ ? values[i] : 0.0;
    };
    copy(from.shift_, shift_, static_cast<std::size_t>(problem.contacts) * 2);
    copy(from.load_, load_, static_cast<std::size_t>(problem.nodes) * stride_);
    copy(from.bend_, bend_, static_cast<std::size_t>(problem.elements) * 4 * tubes_);
    copy(from.need_, need_, static_cast<std::size_t>(problem.nodes) * tubes_ * 2);
}

double LaneState::bend(int element, double xi, int tube, int plane, int lane) const {
    if (!is_exact_) return 0;
    const double a = bend_[bend_index(element, 0, tube, plane, lane)], b = bend_[bend_index(element, 1, tube, plane, lane)];
    return a + (xi - kGauss[0]) / (kGauss[1] - kGauss[0]) * (b - a);
}

void LaneState::copy_lane(const LaneState& from, int from_lane, int lane, const KernelProblem& problem) {
    forget_exact();
    for (int k = 0; k < problem.nodes; ++k)
        for (int i = 0; i < problem.stride; ++i) unknown(k, i, lane) = from.unknown(k, i, from_lane);
    for (int k = 0; k < problem.contacts; ++k) {
        multiplier(k, lane) = from.multiplier(k, from_lane);
        slack(k, lane) = from.slack(k, from_lane);
    }
}

void LaneState::set_phi(const Robot& robot, const KernelProblem& problem, int lane, const double* phi) {
    const int n = robot.count();
    for (int k = 0; k < problem.contacts; ++k) {
        const int pair = n - 2 - problem.contact_pair[k];
        phi_mu_[static_cast<std::size_t>(k) * lanes_ + lane] = phi[pair] * robot.pairs[pair].friction;
    }
}

LaneState::Kept LaneState::keep(int lane) const {
    auto alone = [&](const AlignedArray& values) {
        std::vector<double> kept;
        kept.reserve(values.size() / lanes_ + 1);
        for (std::size_t i = lane; i < values.size(); i += lanes_) kept.push_back(values[i]);
        return kept;
    };
    Kept kept{alone(unknowns_), alone(multiplier_), alone(slack_), alone(phi_mu_), {}, {}, {}, {}};
    if (!is_exact_) return kept;
    kept.shift = alone(shift_);
    kept.load = alone(load_);
    kept.bend = alone(bend_);
    kept.need = alone(need_);
    return kept;
}

void LaneState::put(const Kept& kept, const KernelProblem& problem) {
    auto copy = [](const std::vector<double>& from, AlignedArray& to) { std::copy_n(from.begin(), std::min(from.size(), to.size()), to.data()); };
    follow_slip(nullptr);
    copy(kept.unknowns, unknowns_);
    copy(kept.multiplier, multiplier_);
    copy(kept.slack, slack_);
    copy(kept.phi_mu, phi_mu_);
    forget_exact();
    if (kept.need.empty()) return;
    begin_exact(problem);
    copy(kept.shift, shift_);
    copy(kept.load, load_);
    copy(kept.bend, bend_);
    copy(kept.need, need_);
}

KernelState LaneState::view(const LaneState* anchor) {
    StepMemory& memory = *memory_;
    return {unknowns_.data(), multiplier_.data(), slack_.data(), phi_mu_.data(), memory.step.data(), memory.multiplier_step.data(),
            memory.slack_step.data(), memory.diagonal.data(), memory.upper.data(), memory.lower.data(), memory.rhs.data(),
            load_moment_.data(), slip_, anchor ? anchor->unknowns_.data() : nullptr, block_stride_,
            is_exact_ ? shift_.data() : nullptr, is_exact_ ? load_.data() : nullptr};
}

KernelState LaneState::corrected_view() {
    KernelState state = view();
    state.step = memory_->corrected_step.data();
    state.multiplier_step = memory_->corrected_multiplier_step.data();
    state.slack_step = memory_->corrected_slack_step.data();
    return state;
}

void LaneState::take_corrected(const bool* take) {
    StepMemory& memory = *memory_;
    if (std::all_of(take, take + lanes_, [](bool t) { return t; })) {
        std::swap(memory.step, memory.corrected_step);
        std::swap(memory.multiplier_step, memory.corrected_multiplier_step);
        std::swap(memory.slack_step, memory.corrected_slack_step);
        return;
    }
    auto copy = [&](const AlignedArray& from, AlignedArray& to) {
        for (int lane = 0; lane < lanes_; ++lane)
            for (std::size_t i = lane; take[lane] && i < from.size(); i += lanes_) to[i] = from[i];
    };
    copy(memory.corrected_step, memory.step);
    copy(memory.corrected_multiplier_step, memory.multiplier_step);
    copy(memory.corrected_slack_step, memory.slack_step);
}

}  // namespace ctr
