// The innermost centreline of a solution.
#include <algorithm>
#include <cmath>

#include "ctr/kernel.hpp"
#include "ctr/shape.hpp"

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"

// Curvature of the innermost tube at the Gauss points of an element, and the square of the largest strain of any tube.
double innermost_bending(const FrictionSolver& solver, const LaneState& state, int lane, int e, double (*innermost)[2]) {
    const KernelProblem& pb = solver.mesh().problem();
    double kappa[kMaxTubes][2], rotated[kMaxTubes][2], square = 0;
    for (int g = 0; g < 2; ++g) {
        element_curvature(solver, state, lane, e, g, kappa, rotated);  // an end of it, where it is strained most
        for (int t = 0; t < pb.element_tubes[e]; ++t) {
            const double x = kappa[t][0] - rotated[t][0], y = kappa[t][1] - rotated[t][1];
            const double radius = pb.outer_radius[pb.element_regime[e] / 2 * pb.tubes + t];
            square = std::max(square, radius * radius * (x * x + y * y));
        }
        element_curvature(solver, state, lane, e, kGauss[g], kappa, rotated);
        for (int plane = 0; plane < 2; ++plane) innermost[g][plane] = kappa[0][plane];
    }
    return square;
}

// Turned by the smallest rotation that takes its tangent to a unit vector near it.
void tilt(Frame& frame, const Vec3& tangent) {
    const Vec3 before = frame.tangent(), axis = cross(before, tangent);
    const double by = 1 / (1 + dot(before, tangent));
    for (int k = 0; k < 2; ++k) {
        const Vec3 column = frame.column(k), turned = cross(axis, column);
        const double along = dot(axis, column) * by;
        for (int i = 0; i < 3; ++i) frame.R[3 * i + k] = dot(before, tangent) * column[i] + turned[i] + along * axis[i];
    }
    for (int i = 0; i < 3; ++i) frame.R[3 * i + 2] = tangent[i];
}

}  // namespace

Frame tip_frame(const FrictionSolver& solver, const LaneState& state, int lane, const Frame& innermost) {
    const KernelProblem& pb = solver.mesh().problem();
    const int last = pb.nodes - 1;
    int foremost = 0;  // innermost of those that end there
    while (solver.mesh().is_ghost(pb.elements - 1, foremost)) ++foremost;
    Frame end = innermost;
    if (foremost == 0) return end;
    Vec3 tangent = innermost.tangent();
    for (int p = 0; p < foremost; ++p)
        for (int plane = 0; plane < 2; ++plane) {
            const Vec3 across = innermost.column(plane);
            const double slope = state.unknown(last, slope_index(p, plane), lane);
            for (int i = 0; i < 3; ++i) tangent[i] -= slope * across[i];
        }
    const double length = std::sqrt(dot(tangent, tangent));
    for (double& v : tangent) v /= length;
    tilt(end, tangent);
    return end;
}

void BackboneTracer::bend(const FrictionSolver& solver, const LaneState& state, int first_lane, int count) {
    const KernelProblem& pb = solver.mesh().problem();
    lanes_ = state.lanes();
    innermost_.resize(static_cast<std::size_t>(4) * pb.elements * lanes_);
    if (!pb.law && !state.is_exact()) return kernel(lanes_).bending(pb, state.unknowns(), innermost_.data(), strain_square_);
    for (int lane = first_lane; lane < first_lane + count; ++lane) {
        strain_square_[lane] = 0;
        for (int e = 0; e < pb.elements; ++e) {
            double kappa[2][2];
            strain_square_[lane] = std::max(strain_square_[lane], innermost_bending(solver, state, lane, e, kappa));
            for (int i = 0; i < 4; ++i) innermost_[(static_cast<std::size_t>(4) * e + i) * lanes_ + lane] = kappa[i / 2][i % 2];
        }
    }
}

void BackboneTracer::innermost(int element, int gauss, int lane, double* curvature) const {
    for (int plane = 0; plane < 2; ++plane)
        curvature[plane] = innermost_[(static_cast<std::size_t>(4) * element + 2 * gauss + plane) * lanes_ + lane];
}

void BackboneTracer::trace(const FrictionSolver& solver, const LaneState& state, int first_lane, int count, double base_l, Backbone* out) {
    bend(solver, state, first_lane, count);
    for (int i = 0; i < count; ++i) {
        follow(solver, state, first_lane + i, base_l, out[i]);
        out[i].max_strain = std::sqrt(strain_square_[first_lane + i]);
    }
}

void BackboneTracer::follow(const FrictionSolver& solver, const LaneState& state, int lane, double base_l, Backbone& out) const {
    const KernelProblem& pb = solver.mesh().problem();
    out.frame.resize(pb.nodes);
    out.outer_position.resize(pb.nodes);
    out.outer_end.resize(pb.nodes);
    Frame frame;
    frame.p = {0, 0, base_l};
    out.frame[0] = frame;
    for (int e = 0; e < pb.elements; ++e) {
        double kappa[2][2];
        for (int g = 0; g < 2; ++g) innermost(e, g, lane, kappa[g]);
        advance(frame, kappa[0], kappa[1], pb.length[e]);
        out.frame[e + 1] = frame;
    }
    out.tip = tip_frame(solver, state, lane, frame);
    auto outermost = [&](int k, int tubes) {
        double offset[2] = {0, 0};
        for (int p = 0; p < tubes - 1; ++p)
            for (int plane = 0; plane < 2; ++plane) offset[plane] += state.unknown(k, 1 + 5 * p + plane, lane);
        const Frame& f = out.frame[k];
        Vec3 position;
        for (int i = 0; i < 3; ++i) position[i] = f.p[i] - offset[0] * f.R[3 * i] - offset[1] * f.R[3 * i + 1];
        return position;
    };
    for (int k = 0; k < pb.nodes; ++k) {
        const int after = pb.element_tubes[std::min(k, pb.elements - 1)], before = pb.element_tubes[std::max(k - 1, 0)];
        out.outer_position[k] = outermost(k, after);
        out.outer_end[k] = before == after ? out.outer_position[k] : outermost(k, before);
    }
}

}  // namespace ctr
