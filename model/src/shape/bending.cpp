// How the tubes of an element bend, and what moments that takes.
#include <cmath>

#include "ctr/kernel.hpp"
#include "ctr/shape.hpp"

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"
#include "kernel/lanes.hpp"
#include "kernel/bending_law.hpp"

}  // namespace

void element_curvature(const FrictionSolver& solver, const LaneState& state, int lane, int e, double xi,
                       double (*curvature)[2], double (*rotated)[2]) {
    const KernelProblem& pb = solver.mesh().problem();
    const int m = pb.element_tubes[e], n = pb.tubes, offsets = offsets_of(pb, e);
    const double h = pb.length[e];
    const int row = pb.element_regime[e] / 2 * n;
    double b[4];
    hermite_second(xi, h, b);
    const double part = (xi - kGauss[0]) / (kGauss[1] - kGauss[0]);  // precurvature and load moment are linear in between
    double running[2] = {0, 0}, mean[2] = {0, 0}, total = 0, angle[kMaxTubes], v[kMaxTubes][2];
    for (int t = m - 1; t >= 0; --t) {
        for (int plane = 0; plane < 2; ++plane) {
            if (t < offsets)
                running[plane] += b[0] * state.unknown(e, 1 + 5 * t + plane, lane) + b[1] * state.unknown(e, 3 + 5 * t + plane, lane) +
                                  b[2] * state.unknown(e + 1, 1 + 5 * t + plane, lane) + b[3] * state.unknown(e + 1, 3 + 5 * t + plane, lane);
            const double first = pb.precurvature[(e * 2 * n + t) * 2 + plane], second = pb.precurvature[((e * 2 + 1) * n + t) * 2 + plane];
            v[t][plane] = first + part * (second - first);
        }
        angle[t] = (1 - xi) * state.unknown(e, 5 * t, lane) + xi * state.unknown(e + 1, 5 * t, lane);
        const bool curved = v[t][0] != 0 || v[t][1] != 0;
        const double c = curved ? std::cos(angle[t]) : 1.0, s = curved ? std::sin(angle[t]) : 0.0, EI = pb.bending_stiffness[row + t];
        rotated[t][0] = c * v[t][0] - s * v[t][1];
        rotated[t][1] = s * v[t][0] + c * v[t][1];
        total += EI;
        for (int plane = 0; plane < 2; ++plane) {
            curvature[t][plane] = running[plane];
            mean[plane] += EI * (rotated[t][plane] - running[plane]);
        }
    }
    const bool free = solver.mesh().mean_is_free(e);
    for (double& value : mean) value = free ? value / total : 0.0;
    if (pb.law && free) {
        BentSection<double> section[kMaxTubes];
        double load[2], inverse[3];
        for (int t = 0; t < m; ++t) turn_section<double>(pb.law[row + t], v[t], angle[t], section[t]);
        for (int plane = 0; plane < 2; ++plane) {
            double first = 0, second = 0;
            for (int t = 0; t < m; ++t) {
                first += state.load_moment(e, 0, t, plane, lane);
                second += state.load_moment(e, 1, t, plane, lane);
            }
            load[plane] = first + part * (second - first);
        }
        free_mean<double>(m, pb.law + row, curvature, load, section, mean, inverse);
    }
    for (int t = 0; t < m; ++t)
        for (int plane = 0; plane < 2; ++plane) curvature[t][plane] += mean[plane] + state.bend(e, xi, t, plane, lane);
}

void section_moment(const FrictionSolver& solver, const LaneState& state, int lane, int e, int gauss, int t, const double* kappa,
                    const double* rotated, double* moment, double* tangent) {
    const KernelProblem& pb = solver.mesh().problem();
    const int row = pb.element_regime[e] / 2 * pb.tubes;
    if (pb.law) {
        const double xi = kGauss[gauss], angle = (1 - xi) * state.unknown(e, 5 * t, lane) + xi * state.unknown(e + 1, 5 * t, lane);
        BentSection<double> section;
        turn_section<double>(pb.law[row + t], pb.precurvature + ((e * 2 + gauss) * pb.tubes + t) * 2, angle, section);
        bend<double>(pb.law[row + t], kappa, section);
        for (int i = 0; i < 2; ++i) moment[i] = section.moment[i];
        for (int i = 0; i < 3; ++i) tangent[i] = section.tangent[i];
        return;
    }
    const double EI = pb.bending_stiffness[row + t];
    for (int i = 0; i < 2; ++i) moment[i] = EI * (kappa[i] - rotated[i]);
    tangent[0] = tangent[2] = EI;
    tangent[1] = 0;
}

}  // namespace ctr
