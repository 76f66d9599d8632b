#include "bound/predictor.hpp"

#include <algorithm>
#include <cmath>

namespace ctr {
namespace {

constexpr double kStraight = 1e-3;    // of a step, that configurations may lie off the line
constexpr double kLongest = 2.5;      // times the step before, that is extrapolated over
constexpr double kMostLogChange = 1;  // of a slack

// Scalar product of the joint motions from one configuration to two others, in degrees and half millimetres.
double product(const Configuration& from, const Configuration& a, const Configuration& b) {
    double sum = 0;
    for (std::size_t i = 0; i < from.theta.size(); ++i)
        sum += (a.theta[i] - from.theta[i]) * (b.theta[i] - from.theta[i]) * (57.3 * 57.3) +
               (a.l[i] - from.l[i]) * (b.l[i] - from.l[i]) / (0.5e-3 * 0.5e-3);
    return sum;
}

}  // namespace

void Predictor::take(const Configuration& q, const Mesh& mesh, const std::vector<LaneState*>& states) {
    std::rotate(past_.begin(), past_.end() - 1, past_.end());
    count_ = std::min(count_ + 1, static_cast<int>(past_.size()));
    Past& last = past_.front();
    const KernelProblem& pb = mesh.problem();
    last.q = q;
    last.mesh = mesh;
    last.unknowns.resize(states.size());
    last.log_slack.resize(states.size());
    for (std::size_t j = 0; j < states.size(); ++j) {
        const LaneState& state = *states[j];
        const std::size_t lanes = state.lanes(), count = static_cast<std::size_t>(pb.nodes) * pb.stride * lanes;
        last.unknowns[j].assign(state.unknowns(), state.unknowns() + count);
        last.log_slack[j].resize(pb.contacts * lanes);
        for (int k = 0; k < pb.contacts; ++k)
            for (std::size_t lane = 0; lane < lanes; ++lane) last.log_slack[j][k * lanes + lane] = std::log(state.slack(k, static_cast<int>(lane)));
    }
}

// Where a past configuration stands on the line from the latest (0) to q (1).
bool Predictor::place(const Configuration& q, const Past& past, double& t) const {
    const Configuration& from = past_[0].q;
    const double length = product(from, q, q), back = product(from, past.q, past.q);
    if (!(length > 0)) return false;
    t = product(from, q, past.q) / length;
    return back - t * t * length <= kStraight * kStraight * back;
}

bool Predictor::reaches(const Configuration& q, const Mesh& mesh) {
    double at[3] = {0, 0, 0};
    used_ = 0;
    while (used_ < count_ && past_[used_].mesh.laid_out_like(mesh)) {
        if (used_ > 0 && !(place(q, past_[used_], at[used_]) && at[used_] < at[used_ - 1] - 1 / kLongest)) break;
        ++used_;
    }
    for (int i = 0; i < used_; ++i) {
        weight_[i] = 1;
        for (int j = 0; j < used_; ++j)
            if (j != i) weight_[i] *= (1 - at[j]) / (at[i] - at[j]);
    }
    return used_ > 1;
}

void Predictor::restore(std::size_t index, double level, LaneState& state) const {
    const Past& last = past_[0];
    const KernelProblem& pb = last.mesh.problem();
    const int lanes = state.lanes();
    state.resize(pb, lanes);
    std::copy(last.unknowns[index].begin(), last.unknowns[index].end(), state.unknowns());
    for (int k = 0; k < pb.contacts; ++k) {
        const double eps = level * pb.barrier_scale[pb.contact_pair[k]] * pb.contact_weight[k];
        for (int lane = 0; lane < lanes; ++lane) {
            state.slack(k, lane) = std::exp(last.log_slack[index][static_cast<std::size_t>(k) * lanes + lane]);
            state.multiplier(k, lane) = eps / state.slack(k, lane);
        }
    }
}

void Predictor::give(const Mesh& mesh, std::size_t index, double level, LaneState& state) const {
    const KernelProblem& pb = mesh.problem();
    const std::size_t lanes = state.lanes(), count = static_cast<std::size_t>(pb.nodes) * pb.stride * lanes;
    double* unknowns = state.unknowns();
    std::fill(unknowns, unknowns + count, 0.0);
    for (int i = 0; i < used_; ++i) {
        const double* from = past_[i].unknowns[index].data();
        for (std::size_t k = 0; k < count; ++k) unknowns[k] += weight_[i] * from[k];
    }
    const std::vector<double>& last = past_[0].log_slack[index];
    for (int k = 0; k < pb.contacts; ++k) {
        const double eps = level * pb.barrier_scale[pb.contact_pair[k]] * pb.contact_weight[k];
        for (std::size_t lane = 0; lane < lanes; ++lane) {
            const std::size_t at = k * lanes + lane;
            double value = 0;
            for (int i = 0; i < used_; ++i) value += weight_[i] * past_[i].log_slack[index][at];
            const double slack = std::exp(std::clamp(value, last[at] - kMostLogChange, last[at] + kMostLogChange));
            state.slack(k, static_cast<int>(lane)) = slack;
            state.multiplier(k, static_cast<int>(lane)) = eps / slack;
        }
    }
}

}  // namespace ctr
