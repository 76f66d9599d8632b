#include "derivatives/tip_gradient.hpp"

#include <cmath>

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"

constexpr double kTurn = 3e-5;  // rad by which an element is bent for differences, which are then right to 1e-9

// Tip position and tangent in the frame at the start of an element.
std::array<Vec3, 2> beyond(const double (&kappa)[2][2], double h, const Vec3& position, const Vec3& tangent) {
    Frame frame;
    advance(frame, kappa[0], kappa[1], h);
    Vec3 tip = frame.rotate(position);
    for (int i = 0; i < 3; ++i) tip[i] += frame.p[i];
    return {tip, frame.rotate(tangent)};
}

// Difference quotient of a tip seen from an element's start, in the world.
TipValues slope(const Frame& from, const std::array<Vec3, 2>& above, const std::array<Vec3, 2>& below, double step) {
    TipValues out;
    for (int k = 0; k < 2; ++k) {
        Vec3 change;
        for (int i = 0; i < 3; ++i) change[i] = (above[k][i] - below[k][i]) / (2 * step);
        change = from.rotate(change);
        for (int i = 0; i < 3; ++i) out.value[3 * k + i] = change[i];
    }
    return out;
}

// Components of a vector in a frame.
Vec3 seen_from(const Frame& frame, const Vec3& v) { return {dot(frame.column(0), v), dot(frame.column(1), v), dot(frame.column(2), v)}; }

}  // namespace

bool TipGradient::applies(const FrictionSolver& solver, const LaneState& state) {
    return !solver.mesh().problem().law && !state.is_exact() && !solver.mesh().has_ghosts();
}

void TipGradient::compute(const FrictionSolver& solver, LaneState& state, const std::vector<double>& phi) {
    const KernelProblem& pb = solver.mesh().problem();
    at_ = NumberLayout(pb.tubes, pb.elements);
    stride_ = pb.stride;
    gradient_.assign(at_.count, {});
    adjoint_.assign(static_cast<std::size_t>(pb.nodes) * pb.stride, {});
    bend_.resize(pb.elements);
    for (int e = 0; e < pb.elements; ++e) measure_bend(pb, state, e, bend_[e]);
    differentiate_tip(solver, state);
    for (int t = 0; t < pb.tubes; ++t)  // where a tube begins its angle is given, unless its shaft twists
        if (5 * t >= pb.node_unknowns[pb.shaft_node[t]]) gradient_[at_.base + t] = unknown(pb.shaft_node[t], 5 * t);
    solve_transposed(pb, state.view());
    for (int e = 0; e < pb.elements; ++e) add_elements(pb, state, e);
    add_contacts(pb, state, solver.last_level(), phi);
}

TipValues TipGradient::along(const NumberChange& change) const {
    TipValues sum;
    for (const auto& [place, amount] : change) sum += amount * gradient_[place];
    return sum;
}

void TipGradient::measure_bend(const KernelProblem& pb, const LaneState& state, int e, ElementBend& out) const {
    const int M = pb.element_tubes[e], n = pb.tubes, offsets = offsets_of(pb, e);
    for (int g = 0; g < 2; ++g) {
        double b[4], running[2] = {0, 0}, stretched[2] = {0, 0};
        hermite_second(kGauss[g], pb.length[e], b);
        for (int t = M - 1; t >= 0; --t) {
            const double* v = pb.precurvature + ((e * 2 + g) * n + t) * 2;
            const double angle = linear(0, g) * state.unknown(e, 5 * t, 0) + linear(1, g) * state.unknown(e + 1, 5 * t, 0);
            const double c = out.cosine[g][t] = std::cos(angle), s = out.sine[g][t] = std::sin(angle);
            out.turned[g][t][0] = c * v[0] - s * v[1];
            out.turned[g][t][1] = s * v[0] + c * v[1];
            for (int plane = 0; plane < 2; ++plane) {
                if (t < offsets) {
                    const int d = offset_index(t, plane), slope = slope_index(t, plane);
                    const double by_offset = b[0] * state.unknown(e, d, 0) + b[2] * state.unknown(e + 1, d, 0);
                    const double by_slope = b[1] * state.unknown(e, slope, 0) + b[3] * state.unknown(e + 1, slope, 0);
                    running[plane] += by_offset + by_slope;
                    stretched[plane] -= 2 * by_offset + by_slope;
                }
                out.running[g][t][plane] = running[plane];
                out.stretched[g][t][plane] = stretched[plane];
            }
        }
    }
}

// The tip by every unknown into adjoint_, and by every number at fixed unknowns into gradient_.
void TipGradient::differentiate_tip(const FrictionSolver& solver, const LaneState& state) {
    const KernelProblem& pb = solver.mesh().problem();
    tracer_.trace(solver, state, 0, 1, solver.base_l(), &backbone_);
    const Frame& tip = backbone_.frame.back();
    gradient_[at_.start].value[2] = 1;
    for (int e = 0; e < pb.elements; ++e) {
        const Frame &from = backbone_.frame[e], &to = backbone_.frame[e + 1];
        const Vec3 rest{tip.p[0] - to.p[0], tip.p[1] - to.p[1], tip.p[2] - to.p[2]};
        const Vec3 position = seen_from(to, rest), tangent = seen_from(to, tip.tangent());
        const double h = pb.length[e], bend_step = kTurn / h, length_step = kTurn * h;
        double kappa[2][2];
        for (int g = 0; g < 2; ++g) tracer_.innermost(e, g, 0, kappa[g]);
        TipValues by_curvature[2][2];
        for (int g = 0; g < 2; ++g)
            for (int plane = 0; plane < 2; ++plane) {
                const double middle = kappa[g][plane];
                kappa[g][plane] = middle + bend_step;
                const auto above = beyond(kappa, h, position, tangent);
                kappa[g][plane] = middle - bend_step;
                by_curvature[g][plane] = slope(from, above, beyond(kappa, h, position, tangent), bend_step);
                kappa[g][plane] = middle;
            }
        gradient_[at_.length + e] += slope(from, beyond(kappa, h + length_step, position, tangent),
                                           beyond(kappa, h - length_step, position, tangent), length_step);
        add_curvature(pb, e, by_curvature);
    }
}

// What the curvature of the innermost tube, running_0 + sum_t a_t (turned_t - running_t) with a_t = EI_t / sum EI where the
// mean bending is free, takes from unknowns and numbers.
void TipGradient::add_curvature(const KernelProblem& pb, int e, const TipValues (&by_curvature)[2][2]) {
    const int M = pb.element_tubes[e], n = pb.tubes, offsets = offsets_of(pb, e);
    const ElementBend& bend = bend_[e];
    const double h = pb.length[e];
    double share[kMaxTubes] = {}, total = 0;
    for (int t = 0; t < M; ++t) total += pb.bending_stiffness[t];
    const bool free = pb.element_regime[e] % 2 == 0;
    for (int t = 0; free && t < M; ++t) share[t] = pb.bending_stiffness[t] / total;
    for (int g = 0; g < 2; ++g) {
        double b[4];
        hermite_second(kGauss[g], h, b);
        const TipValues* by = by_curvature[g];
        double rest = 1;
        for (int p = 0; p < offsets; ++p) {
            rest -= share[p];
            for (int plane = 0; plane < 2; ++plane)
                for (int node = 0; node < 2; ++node) {
                    unknown(e + node, offset_index(p, plane)) += (rest * b[2 * node]) * by[plane];
                    unknown(e + node, slope_index(p, plane)) += (rest * b[2 * node + 1]) * by[plane];
                }
        }
        double stretched[2], mean[2] = {0, 0};
        for (int plane = 0; plane < 2; ++plane) {
            stretched[plane] = bend.stretched[g][0][plane];
            for (int t = 0; t < M; ++t) {
                stretched[plane] -= share[t] * bend.stretched[g][t][plane];
                mean[plane] += share[t] * (bend.turned[g][t][plane] - bend.running[g][t][plane]);
            }
            gradient_[at_.length + e] += (stretched[plane] / h) * by[plane];
        }
        for (int t = 0; free && t < M; ++t) {
            const double *w = bend.turned[g][t], c = bend.cosine[g][t], s = bend.sine[g][t];
            const TipValues by_angle = share[t] * (w[0] * by[1] - w[1] * by[0]);
            for (int node = 0; node < 2; ++node) unknown(e + node, 5 * t) += linear(node, g) * by_angle;
            TipValues* by_precurvature = &gradient_[at_.precurvature + ((e * 2 + g) * n + t) * 2];
            by_precurvature[0] += share[t] * (c * by[0] + s * by[1]);
            by_precurvature[1] += share[t] * (c * by[1] - s * by[0]);
            for (int plane = 0; plane < 2; ++plane)
                gradient_[at_.bending + t] += ((w[plane] - bend.running[g][t][plane] - mean[plane]) / total) * by[plane];
        }
    }
}

// adjoint_ := -H^-T adjoint_ with the block factors of newton(); zero at unknowns that are given.
void TipGradient::solve_transposed(const KernelProblem& pb, const KernelState& st) {
    const int stride = pb.stride, ld = st.block_stride, square = stride * ld;
    for (int k = 0; k < pb.nodes; ++k) {
        TipValues* z = &unknown(k, 0);
        const int P = pb.node_unknowns[k];
        for (int i = 0; i < stride; ++i) z[i] *= i < P ? -1.0 : 0.0;
        if (k == 0) continue;
        const double* U = st.upper + (k - 1) * square;
        const TipValues* before = z - stride;
        for (int j = 0; j < pb.node_unknowns[k - 1]; ++j)
            for (int i = 0; i < pb.element_unknowns[k - 1]; ++i) z[i] -= U[j * ld + i] * before[j];
    }
    for (int k = pb.nodes - 1; k >= 0; --k) {
        TipValues* z = &unknown(k, 0);
        const int P = pb.node_unknowns[k];
        if (k + 1 < pb.nodes) {
            const double* L = st.lower + k * square;
            const TipValues* after = z + stride;
            for (int i = 0; i < pb.element_unknowns[k]; ++i)
                for (int j = 0; j < P; ++j) z[j] -= L[i * ld + j] * after[i];
        }
        const double* A = st.diagonal + k * square;  // unit lower factor, upper factor with its pivots inverted
        for (int i = 0; i < P; ++i) {
            z[i] *= A[i * ld + i];
            for (int j = i + 1; j < P; ++j) z[j] -= A[i * ld + j] * z[i];
        }
        for (int i = P - 1; i >= 0; --i)
            for (int j = 0; j < i; ++j) z[j] -= A[i * ld + j] * z[i];
    }
}

}  // namespace ctr
