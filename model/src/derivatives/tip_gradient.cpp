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
    return !solver.robot().loaded() && !state.is_exact() && !solver.mesh().has_ghosts();
}

void TipGradient::compute(const FrictionSolver& solver, LaneState& state, const std::vector<double>& phi) {
    const KernelProblem& pb = solver.mesh().problem();
    const BendingLaw* laws = solver.mesh().laws();
    at_ = NumberLayout(pb.tubes, pb.elements);
    stride_ = pb.stride;
    gradient_.assign(at_.count, {});
    adjoint_.assign(static_cast<std::size_t>(pb.nodes) * pb.stride, {});
    bend_.resize(pb.elements);
    for (int e = 0; e < pb.elements; ++e) measure_bend(pb, laws, state, e, bend_[e]);
    differentiate_tip(solver, state);
    for (int t = 0; t < pb.tubes; ++t)  // where a tube begins its angle is given, unless its shaft twists
        if (5 * t >= pb.node_unknowns[pb.shaft_node[t]]) gradient_[at_.base + t] = unknown(pb.shaft_node[t], 5 * t);
    solve_transposed(pb, state.view());
    for (int e = 0; e < pb.elements; ++e) add_elements(pb, laws, state, e);
    gradient_[at_.count - 1] -= unknown(pb.nodes - 1, 0);  // the torque of a tip moment
    add_contacts(pb, state, solver.last_level(), phi);
}

TipValues TipGradient::along(const NumberChange& change) const {
    TipValues sum;
    for (const auto& [place, amount] : change) sum += amount * gradient_[place];
    return sum;
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
        add_curvature(pb, solver.mesh().laws(), e, by_curvature);
    }
}

// What the curvature of the innermost tube takes from unknowns and numbers: against the outermost one, and where the mean
// bending is free through the mean, whose change is -S^-1 times that of the sum of moments.
void TipGradient::add_curvature(const KernelProblem& pb, const BendingLaw* laws, int e, const TipValues (&by_curvature)[2][2]) {
    const int M = pb.element_tubes[e], offsets = offsets_of(pb, e);
    const double h = pb.length[e];
    for (int g = 0; g < 2; ++g) {
        double b[4];
        hermite_second(kGauss[g], h, b);
        const TipValues* by = by_curvature[g];
        const double* S = bend_[e].inverse[g];
        const TipValues mean[2] = {-S[0] * by[0] + -S[1] * by[1], -S[1] * by[0] + -S[2] * by[1]};
        TipValues rest[2] = {by[0], by[1]};
        for (int t = 0; t < M; ++t) {
            const BentTube& tube = bend_[e].tube[g][t];
            const TipValues pulled[2] = {tube.tangent[0] * mean[0] + tube.tangent[1] * mean[1],
                                         tube.tangent[1] * mean[0] + tube.tangent[2] * mean[1]};
            const TipValues by_angle = tube.by_angle[0] * mean[0] + tube.by_angle[1] * mean[1];
            for (int node = 0; node < 2; ++node) unknown(e + node, 5 * t) += linear(node, g) * by_angle;
            for (int plane = 0; plane < 2; ++plane) {
                const TipValues stretch = t == 0 ? by[plane] + pulled[plane] : pulled[plane];
                gradient_[at_.length + e] += (tube.stretched[plane] / h) * stretch;
                load(e, g, t, plane) -= mean[plane];
                rest[plane] += pulled[plane];
                for (int node = 0; node < 2 && t < offsets; ++node) {
                    unknown(e + node, offset_index(t, plane)) += b[2 * node] * rest[plane];
                    unknown(e + node, slope_index(t, plane)) += b[2 * node + 1] * rest[plane];
                }
            }
            add_moment(e, g, t, laws[t], tube, mean);
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
