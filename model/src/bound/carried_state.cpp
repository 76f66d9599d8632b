#include "bound/carried_state.hpp"

#include <algorithm>

namespace ctr {
namespace {

// Index of the interval [values[i], values[i + 1]] that holds x.
int interval(const std::vector<double>& values, double x) {
    const auto it = std::upper_bound(values.begin(), values.end(), x);
    return std::clamp(static_cast<int>(it - values.begin()) - 1, 0, static_cast<int>(values.size()) - 2);
}

}  // namespace

void CarriedState::take(const Mesh& mesh, const LaneState& state) {
    const KernelProblem& pb = mesh.problem();
    stride_ = pb.stride;
    lanes_ = state.lanes();
    breaks_ = mesh.breaks();
    s_ = mesh.s();
    unknowns_.resize(static_cast<std::size_t>(pb.nodes) * stride_ * lanes_);
    for (int k = 0; k < pb.nodes; ++k)
        for (int i = 0; i < stride_; ++i)
            for (int lane = 0; lane < lanes_; ++lane)
                unknowns_[(static_cast<std::size_t>(k) * stride_ + i) * lanes_ + lane] = state.unknown(k, i, lane);
    pairs_.resize(std::max(pb.tubes - 1, 0));
    for (PairContacts& pair : pairs_) {
        pair.s.clear();
        pair.density.clear();
        pair.slack.clear();
    }
    for (int k = 0; k < pb.contacts; ++k) {
        PairContacts& pair = pairs_[pb.contact_pair[k]];
        pair.s.push_back(mesh.contact_s()[k]);
        for (int lane = 0; lane < lanes_; ++lane) {
            pair.density.push_back(state.multiplier(k, lane) / pb.contact_weight[k]);
            pair.slack.push_back(state.slack(k, lane));
        }
    }
}

// Arc length on this mesh that corresponds to s on one with the given breaks, s itself if they don't fit; stretch is its
// derivative.
double CarriedState::image(const std::vector<double>& breaks, double s, double& stretch) const {
    stretch = 1;
    if (breaks.size() != breaks_.size()) return s;
    const int i = interval(breaks, s);
    const double span = breaks[i + 1] - breaks[i];
    stretch = (breaks_[i + 1] - breaks_[i]) / span;
    return breaks_[i] + stretch * (s - breaks[i]);
}

void CarriedState::give(const Mesh& mesh, LaneState& state) const {
    const KernelProblem& pb = mesh.problem();
    double stretch = 1;
    auto value = [&](int k, int i, int lane) { return unknowns_[(static_cast<std::size_t>(k) * stride_ + i) * lanes_ + lane]; };
    for (int k = 0; k < pb.nodes; ++k) {
        const double s = image(mesh.breaks(), mesh.s()[k], stretch);
        const int e = interval(s_, s);
        const double h = s_[e + 1] - s_[e], x = std::clamp((s - s_[e]) / h, 0.0, 1.0), x2 = x * x, x3 = x2 * x;
        const double N[4] = {1 - 3 * x2 + 2 * x3, h * (x - 2 * x2 + x3), 3 * x2 - 2 * x3, h * (x3 - x2)};
        const double B[4] = {6 * (x2 - x) / h, 1 - 4 * x + 3 * x2, 6 * (x - x2) / h, 3 * x2 - 2 * x};
        for (int lane = 0; lane < lanes_; ++lane)
            for (int i = 0; i < stride_; ++i) {
                if (i % 5 == 0) {
                    state.unknown(k, i, lane) = (1 - x) * value(e, i, lane) + x * value(e + 1, i, lane);
                } else if (i % 5 <= 2) {  // an offset and, two places on, its slope
                    const double q[4] = {value(e, i, lane), value(e, i + 2, lane), value(e + 1, i, lane), value(e + 1, i + 2, lane)};
                    state.unknown(k, i, lane) = N[0] * q[0] + N[1] * q[1] + N[2] * q[2] + N[3] * q[3];
                    state.unknown(k, i + 2, lane) = stretch * (B[0] * q[0] + B[1] * q[1] + B[2] * q[2] + B[3] * q[3]);
                }
            }
    }
    for (int k = 0; k < pb.contacts; ++k) {
        const PairContacts& pair = pairs_[pb.contact_pair[k]];
        const double s = image(mesh.breaks(), mesh.contact_s()[k], stretch);
        if (pair.s.size() < 2) continue;
        const int i = interval(pair.s, s);
        const double x = std::clamp((s - pair.s[i]) / (pair.s[i + 1] - pair.s[i]), 0.0, 1.0);
        for (int lane = 0; lane < lanes_; ++lane) {
            const std::size_t a = static_cast<std::size_t>(i) * lanes_ + lane, b = a + lanes_;
            state.multiplier(k, lane) = ((1 - x) * pair.density[a] + x * pair.density[b]) * pb.contact_weight[k];
            state.slack(k, lane) = (1 - x) * pair.slack[a] + x * pair.slack[b];
        }
    }
}

}  // namespace ctr
