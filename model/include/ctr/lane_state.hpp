// What a solve is about: one or four friction states on a mesh.
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "ctr/aligned.hpp"
#include "ctr/kernel.hpp"
#include "ctr/robot.hpp"

namespace ctr {

// What a Newton step of an iterate needs on its way: most of the memory by far.
struct StepMemory {
    AlignedArray step, multiplier_step, slack_step, corrected_step, corrected_multiplier_step, corrected_slack_step;
    AlignedArray diagonal, upper, lower, rhs;
};

// The iterate of one or four friction states on a mesh. Values are interleaved, lane fastest (kernel.hpp).
class LaneState {
  public:
    LaneState() : memory_(std::make_shared<StepMemory>()) {}
    // Iterates of as many lanes that are solved one after the other need the memory of their steps once.
    void share_steps(const LaneState& with) { memory_ = with.memory_; }
    void resize(const KernelProblem& problem, int lanes);
    void set_phi(const Robot& robot, const KernelProblem& problem, int lane, const double* phi);  // phi per pair, outermost first
    int lanes() const { return lanes_; }
    int stride() const { return stride_; }
    double phi_mu(int contact, int lane) const { return phi_mu_[static_cast<std::size_t>(contact) * lanes_ + lane]; }
    void set_phi_mu(int contact, int lane, double value) { phi_mu_[static_cast<std::size_t>(contact) * lanes_ + lane] = value; }
    void follow_slip(const SlipLaw* law) { slip_ = law; }  // null: friction states stay as they are set
    double* unknowns() { return unknowns_.data(); }
    const double* unknowns() const { return unknowns_.data(); }
    // What the loads ask of the tubes, one lane fastest: load_moment() of every tube at every Gauss point, then tip_torque().
    double* load_moments() { return load_moment_.data(); }
    std::size_t load_moment_count() const { return load_moment_.size(); }
    double& unknown(int node, int index, int lane) { return unknowns_[(static_cast<std::size_t>(node) * stride_ + index) * lanes_ + lane]; }
    double unknown(int node, int index, int lane) const { return unknowns_[(static_cast<std::size_t>(node) * stride_ + index) * lanes_ + lane]; }
    double& multiplier(int contact, int lane) { return multiplier_[static_cast<std::size_t>(contact) * lanes_ + lane]; }
    double multiplier(int contact, int lane) const { return multiplier_[static_cast<std::size_t>(contact) * lanes_ + lane]; }
    double& slack(int contact, int lane) { return slack_[static_cast<std::size_t>(contact) * lanes_ + lane]; }
    double slack(int contact, int lane) const { return slack_[static_cast<std::size_t>(contact) * lanes_ + lane]; }
    double& load_moment(int element, int gauss, int tube, int plane, int lane) { return load_moment_[bend_index(element, gauss, tube, plane, lane)]; }
    double load_moment(int element, int gauss, int tube, int plane, int lane) const { return load_moment_[bend_index(element, gauss, tube, plane, lane)]; }
    double& tip_torque(int lane) { return load_moment_[load_moment_.size() - lanes_ + lane]; }
    double& rhs(int node, int index, int lane) { return memory_->rhs[(static_cast<std::size_t>(node) * stride_ + index) * lanes_ + lane]; }
    double step(int node, int index, int lane) const { return memory_->step[(static_cast<std::size_t>(node) * stride_ + index) * lanes_ + lane]; }
    double inverse_pivot(int node, int index, int lane) const {
        return memory_->diagonal[((static_cast<std::size_t>(node) * stride_ + index) * block_stride_ + index) * lanes_ + lane];
    }
    KernelState view(const LaneState* anchor = nullptr);
    KernelState corrected_view();         // with steps of its own
    void take_corrected(const bool* take); // per lane: the step becomes the corrected one

    // Exact geometry (exact_geometry.hpp): what it adds to the first-order model at this iterate. Solves without it forget it.
    void begin_exact(const KernelProblem& problem);
    void forget_exact() { is_exact_ = false; }
    bool is_exact() const { return is_exact_; }
    void copy_exact(const LaneState& from, const KernelProblem& problem, int lane);  // of a one-lane iterate, or that it has none
    double& shift(int contact, int plane, int lane) { return shift_[(static_cast<std::size_t>(contact) * 2 + plane) * lanes_ + lane]; }
    double shift(int contact, int plane, int lane) const { return is_exact_ ? shift_[(static_cast<std::size_t>(contact) * 2 + plane) * lanes_ + lane] : 0.0; }
    double& load(int node, int index, int lane) { return load_[(static_cast<std::size_t>(node) * stride_ + index) * lanes_ + lane]; }
    double& bend_at_gauss(int element, int gauss, int tube, int plane, int lane) { return bend_[bend_index(element, gauss, tube, plane, lane)]; }
    double bend(int element, double xi, int tube, int plane, int lane) const;  // linear through the Gauss points
    double& need(int node, int pair, int plane, int lane) { return need_[need_index(node, pair, plane, lane)]; }  // see alignment.hpp
    double need(int node, int pair, int plane, int lane) const { return need_[need_index(node, pair, plane, lane)]; }

    // What a solve starts from of one lane of another iterate on the same mesh, exact geometry left out.
    void copy_lane(const LaneState& from, int from_lane, int lane, const KernelProblem& problem);

    // One lane by itself, without what a solve needs on its way only.
    struct Kept {
        std::vector<double> unknowns, multiplier, slack, phi_mu;
        std::vector<double> shift, load, bend, need;  // empty without exact geometry
    };
    Kept keep(int lane) const;
    void put(const Kept& kept, const KernelProblem& problem);  // into the lane of a state of one

  private:
    std::size_t bend_index(int element, int gauss, int tube, int plane, int lane) const {
        return ((static_cast<std::size_t>(element * 2 + gauss) * tubes_ + tube) * 2 + plane) * lanes_ + lane;
    }

    std::size_t need_index(int node, int pair, int plane, int lane) const {
        return (static_cast<std::size_t>(node * tubes_ + pair) * 2 + plane) * lanes_ + lane;
    }

    int lanes_ = 1, stride_ = 1, block_stride_ = 1, tubes_ = 1;
    bool is_exact_ = false;
    AlignedArray shift_, load_, bend_, need_;  // [contact][2] m, [node][stride], [element][gauss][tube][2] 1/m, [node][pair][2] m
    const SlipLaw* slip_ = nullptr;
    AlignedArray unknowns_, multiplier_, slack_, phi_mu_, load_moment_;
    std::shared_ptr<StepMemory> memory_;
};

}  // namespace ctr
