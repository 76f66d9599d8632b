// Part of the gradient of a tip: what torsion, bending and contacts take from every number, along the adjoint.
#include <cmath>

#include "derivatives/tip_gradient.hpp"

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"

}  // namespace

// Torsion and bending: the virtual work along the adjoint, of moments with curvatures and of torques with angles, by the
// numbers it is made of. A moment m of tube t at constant curvature counts chi_t + turn_t J kappa_t less what the mean takes.
void TipGradient::add_elements(const KernelProblem& pb, const BendingLaw* laws, const LaneState& state, int e) {
    const int M = pb.element_tubes[e], offsets = offsets_of(pb, e);
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
    for (int g = 0; g < 2; ++g) {
        double b[4];
        hermite_second(kGauss[g], h, b);
        TipValues along[kMaxTubes][2], by_bend[kMaxTubes][2], running[2], stretched[2], sum[2], work;  // work: per half length
        for (int t = M - 1; t >= 0; --t) {
            const BentTube& tube = bend.tube[g][t];
            const double *m = tube.moment, *K = tube.tangent;
            const TipValues turn = linear(0, g) * unknown(e, 5 * t) + linear(1, g) * unknown(e + 1, 5 * t);
            for (int plane = 0; plane < 2; ++plane) {
                if (t < offsets) {
                    const int d = offset_index(t, plane), slope = slope_index(t, plane);
                    const TipValues by_offset = b[0] * unknown(e, d) + b[2] * unknown(e + 1, d);
                    const TipValues by_slope = b[1] * unknown(e, slope) + b[3] * unknown(e + 1, slope);
                    running[plane] += by_offset + by_slope;
                    stretched[plane] -= 2.0 * by_offset + by_slope;
                }
                work += m[plane] * (running[plane] + stretched[plane]);
                load(e, g, t, plane) -= weight * running[plane];
            }
            work += (m[0] * tube.kappa[1] - m[1] * tube.kappa[0]) * turn;
            along[t][0] = running[0] + tube.kappa[1] * turn;
            along[t][1] = running[1] - tube.kappa[0] * turn;
            by_bend[t][0] = K[0] * along[t][0] + K[1] * along[t][1] - m[1] * turn;
            by_bend[t][1] = K[1] * along[t][0] + K[2] * along[t][1] + m[0] * turn;
            for (int plane = 0; plane < 2; ++plane) sum[plane] += by_bend[t][plane];
        }
        by_length += 0.5 * work;
        const double* S = bend.inverse[g];
        const TipValues mean[2] = {S[0] * sum[0] + S[1] * sum[1], S[1] * sum[0] + S[2] * sum[1]};
        for (int t = 0; t < M; ++t) {
            const BentTube& tube = bend.tube[g][t];
            const double* K = tube.tangent;
            by_length += (0.5 * tube.stretched[0]) * (by_bend[t][0] - (K[0] * mean[0] + K[1] * mean[1])) +
                         (0.5 * tube.stretched[1]) * (by_bend[t][1] - (K[1] * mean[0] + K[2] * mean[1]));
            const TipValues by_moment[2] = {weight * (along[t][0] - mean[0]), weight * (along[t][1] - mean[1])};
            add_moment(e, g, t, laws[t], tube, by_moment);
            for (int plane = 0; plane < 2; ++plane) load(e, g, t, plane) += weight * mean[plane];
            if (pb.shaft_node[t] == e && 5 * t >= pb.node_unknowns[e])
                gradient_[at_.base + t] += linear(0, g) * (tube.by_angle[0] * by_moment[0] + tube.by_angle[1] * by_moment[1]);
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
