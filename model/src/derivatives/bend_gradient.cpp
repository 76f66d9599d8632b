// How the tubes of an element bend at its Gauss points, and what the numbers of their laws change in their moments.
#include "derivatives/tip_gradient.hpp"

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"
#include "kernel/lanes.hpp"
#include "kernel/bending_law.hpp"

}  // namespace

void TipGradient::measure_bend(const KernelProblem& pb, const BendingLaw* laws, const LaneState& state, int e, ElementBend& out) {
    const int M = pb.element_tubes[e], n = pb.tubes, offsets = offsets_of(pb, e);
    for (int g = 0; g < 2; ++g) {
        double b[4], against[kMaxTubes][2], running[2] = {0, 0}, stretched[2] = {0, 0}, mean[2] = {0, 0};
        const double none[2] = {0, 0};
        BentSection<double> section[kMaxTubes];
        hermite_second(kGauss[g], pb.length[e], b);
        const double* v = pb.precurvature + (e * 2 + g) * n * 2;
        for (int t = M - 1; t >= 0; --t) {
            for (int plane = 0; plane < 2; ++plane) {
                if (t < offsets) {
                    const int d = offset_index(t, plane), slope = slope_index(t, plane);
                    const double by_offset = b[0] * state.unknown(e, d, 0) + b[2] * state.unknown(e + 1, d, 0);
                    const double by_slope = b[1] * state.unknown(e, slope, 0) + b[3] * state.unknown(e + 1, slope, 0);
                    running[plane] += by_offset + by_slope;
                    stretched[plane] -= 2 * by_offset + by_slope;
                }
                against[t][plane] = running[plane];
                out.tube[g][t].stretched[plane] = stretched[plane];
            }
            turn_section<double>(laws[t], v + 2 * t, linear(0, g) * state.unknown(e, 5 * t, 0) + linear(1, g) * state.unknown(e + 1, 5 * t, 0), section[t]);
        }
        for (double& value : out.inverse[g]) value = 0;
        if (pb.element_regime[e] % 2 == 0) free_mean<double>(M, laws, against, none, section, mean, out.inverse[g]);
        for (int t = 0; t < M; ++t) {
            BentTube& tube = out.tube[g][t];
            for (int plane = 0; plane < 2; ++plane) tube.kappa[plane] = mean[plane] + against[t][plane];
            bend<double>(laws[t], tube.kappa, section[t]);
            for (int i = 0; i < 2; ++i) tube.moment[i] = section[t].moment[i];
            for (int i = 0; i < 3; ++i) tube.tangent[i] = section[t].tangent[i];
            for (int i = 0; i < 2; ++i) tube.by_angle[i] = section[t].by_angle[i];
            tube.sine = section[t].sine;
            tube.cosine = section[t].cosine;
            for (int i = 0; i < 2; ++i) tube.curved[i] = section[t].curved[i];
        }
    }
}

// A tube's moment by precurvature and law at constant curvature and angle, along the oval axes (k, bend() in bending_law.hpp):
// m = EI f D k, with the tangent T = dm/dk.
void TipGradient::add_moment(int e, int g, int t, const BendingLaw& law, const BentTube& tube, const TipValues (&by)[2]) {
    const double c = tube.cosine, s = tube.sine, EI = law.stiffness;
    const double k[2] = {c * tube.kappa[0] + s * tube.kappa[1] - tube.curved[0], c * tube.kappa[1] - s * tube.kappa[0] - tube.curved[1]};
    const TipValues own[2] = {c * by[0] + s * by[1], c * by[1] - s * by[0]};
    const double m[2] = {c * tube.moment[0] + s * tube.moment[1], c * tube.moment[1] - s * tube.moment[0]};
    const double *K = tube.tangent, cc = c * c, ss = s * s, cs = c * s;
    const double T[3] = {cc * K[0] + 2 * cs * K[1] + ss * K[2], cs * (K[2] - K[0]) + (cc - ss) * K[1], ss * K[0] - 2 * cs * K[1] + cc * K[2]};
    const TipValues by_k[2] = {T[0] * own[0] + T[1] * own[1], T[1] * own[0] + T[2] * own[1]};
    double sine, cosine;  // of the oval axis in the tube
    sine_cosine<double>(law.axis, sine, cosine);
    TipValues* by_precurvature = &gradient_[at_.precurvature + ((e * 2 + g) * at_.tubes + t) * 2];
    by_precurvature[0] -= cosine * by_k[0] - sine * by_k[1];
    by_precurvature[1] -= sine * by_k[0] + cosine * by_k[1];
    gradient_[at_.bending + t] += (m[0] / EI) * own[0] + (m[1] / EI) * own[1];
    gradient_[at_.axis + t] += m[0] * own[1] - m[1] * own[0] + k[1] * by_k[0] - k[0] * by_k[1];
    const double n[2] = {(1 + law.ovality) * k[0], (1 - law.ovality) * k[1]}, square = k[0] * n[0] + k[1] * n[1];
    const bool beyond = square > law.knee * law.knee;
    const double bent = beyond ? root(square) : law.knee, rest = 1 - law.fraction;
    const double f = law.fraction + rest * (law.knee / bent), falls = beyond ? rest * law.knee / (square * bent) : 0.0;
    const double drop = -0.5 * falls * (k[0] * k[0] - k[1] * k[1]);  // f by the ovality
    gradient_[at_.ovality + t] += (EI * (f * k[0] + drop * n[0])) * own[0] + (EI * (drop * n[1] - f * k[1])) * own[1];
    if (!beyond) return;
    const TipValues softer = (EI * n[0]) * own[0] + (EI * n[1]) * own[1];
    gradient_[at_.knee + t] += (rest / bent) * softer;
    gradient_[at_.fraction + t] += (1 - law.knee / bent) * softer;
}

}  // namespace ctr
