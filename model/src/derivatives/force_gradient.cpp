// Part of the gradient of a tip: what torsion, bending and contacts take from every number, along the adjoint.
#include <cmath>

#include "derivatives/tip_gradient.hpp"

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"

}  // namespace

// Torsion and bending: the virtual work sum_tl P_tl k_t . dk_l along the adjoint, k the bending against the outermost tube
// less the turned precurvature, by the numbers it is made of.
void TipGradient::add_elements(const KernelProblem& pb, const LaneState& state, int e) {
    const int M = pb.element_tubes[e], n = pb.tubes, offsets = offsets_of(pb, e);
    const ElementBend& bend = bend_[e];
    const double h = pb.length[e], weight = 0.5 * h;
    TipValues& by_length = gradient_[at_.length + e];
    for (int t = 0; t < M; ++t) {
        const TipValues twist = unknown(e + 1, 5 * t) - unknown(e, 5 * t);
        const double angle = state.unknown(e + 1, 5 * t, 0) - state.unknown(e, 5 * t, 0);
        gradient_[at_.torsional + t] += (angle / h) * twist;
        by_length -= (pb.torsional_stiffness[t] * angle / (h * h)) * twist;
        if (pb.shaft_node[t] != e) continue;
        if (5 * t >= pb.node_unknowns[e]) gradient_[at_.base + t] -= (pb.torsional_stiffness[t] / h) * twist;
        if (pb.shaft_stiffness[t] == 0) continue;
        gradient_[at_.shaft_stiffness + t] += (state.unknown(e, 5 * t, 0) - pb.shaft_angle[t]) * unknown(e, 5 * t);
        gradient_[at_.shaft_angle + t] -= pb.shaft_stiffness[t] * unknown(e, 5 * t);
    }
    if (offsets == 0) return;
    const int regime = pb.element_regime[e] * n * n;
    const double* P = pb.stiffness + regime;
    for (int g = 0; g < 2; ++g) {
        double b[4], against[kMaxTubes][2], moment[kMaxTubes][2], stretched_moment[kMaxTubes][2];
        hermite_second(kGauss[g], h, b);
        for (int t = 0; t < M; ++t)
            for (int plane = 0; plane < 2; ++plane) against[t][plane] = bend.running[g][t][plane] - bend.turned[g][t][plane];
        for (int t = 0; t < M; ++t)
            for (int plane = 0; plane < 2; ++plane) {
                moment[t][plane] = stretched_moment[t][plane] = 0;
                for (int l = 0; l < M; ++l) {
                    moment[t][plane] += P[t * n + l] * against[l][plane];
                    stretched_moment[t][plane] += P[t * n + l] * bend.stretched[g][l][plane];
                }
            }
        TipValues change[kMaxTubes][2], turn[kMaxTubes], running[2], stretched[2], work;  // work: per half length
        for (int t = M - 1; t >= 0; --t) {
            const double* w = bend.turned[g][t];
            turn[t] = linear(0, g) * unknown(e, 5 * t) + linear(1, g) * unknown(e + 1, 5 * t);
            for (int plane = 0; plane < 2; ++plane) {
                if (t < offsets) {
                    const int d = offset_index(t, plane), slope = slope_index(t, plane);
                    const TipValues by_offset = b[0] * unknown(e, d) + b[2] * unknown(e + 1, d);
                    const TipValues by_slope = b[1] * unknown(e, slope) + b[3] * unknown(e + 1, slope);
                    running[plane] += by_offset + by_slope;
                    stretched[plane] -= 2.0 * by_offset + by_slope;
                }
                change[t][plane] = running[plane] - (plane ? w[0] : -w[1]) * turn[t];
                work += moment[t][plane] * (change[t][plane] + stretched[plane]) + stretched_moment[t][plane] * change[t][plane];
            }
        }
        by_length += 0.5 * work;
        for (int t = 0; t < M; ++t) {
            TipValues push[2];  // P change
            for (int l = 0; l < M; ++l) {
                for (int plane = 0; plane < 2; ++plane) push[plane] += P[t * n + l] * change[l][plane];
                gradient_[at_.stiffness + regime + t * n + l] +=
                    weight * (against[l][0] * change[t][0] + against[l][1] * change[t][1]);
            }
            const double *w = bend.turned[g][t], *m = moment[t], c = bend.cosine[g][t], s = bend.sine[g][t];
            const TipValues x = weight * (push[0] + m[1] * turn[t]), y = weight * (push[1] - m[0] * turn[t]);
            TipValues* by_precurvature = &gradient_[at_.precurvature + ((e * 2 + g) * n + t) * 2];
            by_precurvature[0] -= c * x + s * y;
            by_precurvature[1] -= c * y - s * x;
            if (pb.shaft_node[t] == e && 5 * t >= pb.node_unknowns[e])
                gradient_[at_.base + t] += (weight * linear(0, g)) * (w[1] * push[0] - w[0] * push[1] + (m[0] * w[0] + m[1] * w[1]) * turn[t]);
        }
    }
}

// Contact points: the multiplier follows barrier and gap, lambda + dlambda with w dlambda = deps - lambda dgap.
void TipGradient::add_contacts(const KernelProblem& pb, const LaneState& state, double level, const std::vector<double>& phi) {
    const int n = pb.tubes;
    for (int e = 0; e < pb.elements; ++e)
        for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k) {
            const int p = pb.contact_pair[k], outer = 5 * (p + 1), inner = 5 * p;
            const double *N = pb.contact_shape + 4 * k, xi = pb.contact_xi[k], arm_out = pb.outer_torque_arm[p], arm_in = pb.inner_torque_arm[p];
            const double lambda = state.multiplier(k, 0), inverse = 1 / state.slack(k, 0), f = state.phi_mu(k, 0);
            double d[2], by_slope[2];      // offset, and what of it the slopes make
            TipValues move[2], turning[2];
            for (int plane = 0; plane < 2; ++plane) {
                const int i = offset_index(p, plane), j = slope_index(p, plane);
                by_slope[plane] = N[1] * state.unknown(e, j, 0) + N[3] * state.unknown(e + 1, j, 0);
                d[plane] = N[0] * state.unknown(e, i, 0) + N[2] * state.unknown(e + 1, i, 0) + by_slope[plane];
                turning[plane] = N[1] * unknown(e, j) + N[3] * unknown(e + 1, j);
                move[plane] = N[0] * unknown(e, i) + N[2] * unknown(e + 1, i) + turning[plane];
            }
            const double square = d[0] * d[0] + d[1] * d[1], gx = d[0] - f * d[1], gy = d[1] + f * d[0];
            TipValues by_lambda = gx * move[0] + gy * move[1], by_friction = lambda * (d[0] * move[1] - d[1] * move[0]);
            TipValues by_offset[2] = {lambda * (move[0] + f * move[1]), lambda * (move[1] - f * move[0])};
            if (phi[n - 2 - p] != 0) {
                const TipValues out = (1 - xi) * unknown(e, outer) + xi * unknown(e + 1, outer);
                const TipValues in = (1 - xi) * unknown(e, inner) + xi * unknown(e + 1, inner);
                const TipValues twist = arm_in * in - arm_out * out;
                by_lambda += (f * square) * twist;
                by_friction += (lambda * square) * twist;
                for (int plane = 0; plane < 2; ++plane) by_offset[plane] += (2 * f * lambda * d[plane]) * twist;
                gradient_[at_.inner_arm + p] += (f * lambda * square) * in;
                gradient_[at_.outer_arm + p] -= (f * lambda * square) * out;
                gradient_[at_.friction + p] += phi[n - 2 - p] * by_friction;
            }
            gradient_[at_.half_square + p] -= (lambda * inverse) * by_lambda;
            gradient_[at_.scale + p] += (level * pb.contact_weight[k] * inverse) * by_lambda;
            TipValues by_length = lambda * (gx * turning[0] + gy * turning[1]) +
                                  (level * pb.barrier_scale[p] * pb.contact_weight[k] * inverse) * by_lambda;
            for (int plane = 0; plane < 2; ++plane)
                by_length += by_slope[plane] * by_offset[plane] + (by_slope[plane] * lambda * inverse * d[plane]) * by_lambda;
            gradient_[at_.length + e] += (1 / pb.length[e]) * by_length;
        }
}

}  // namespace ctr
