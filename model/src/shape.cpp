#include "ctr/shape.hpp"

#include <algorithm>
#include <cmath>

#include "ctr/kernel.hpp"

namespace ctr {
namespace {

#include "element_functions.hpp"
#include "kernel_lanes.hpp"
#include "bending_law.hpp"

constexpr double kOutputStep = 2e-3;  // m, zero-clearance shapes

// Material frame and curvature of a tube from its twist-free frame, its angle and its bending in the twist-free frame.
void append(TubeShape& tube, double s, const Frame& frame, double theta, double rate, const double* kappa,
            const double* rotated, double radius) {
    const double c = std::cos(theta), n = std::sin(theta);
    std::array<double, 9> R;
    for (int i = 0; i < 3; ++i) {
        R[3 * i] = c * frame.R[3 * i] + n * frame.R[3 * i + 1];
        R[3 * i + 1] = -n * frame.R[3 * i] + c * frame.R[3 * i + 1];
        R[3 * i + 2] = frame.R[3 * i + 2];
    }
    tube.s.push_back(s);
    tube.position.push_back(frame.p);
    tube.frame.push_back(R);
    tube.theta.push_back(theta);
    const double wx = -kappa[1], wy = kappa[0];  // rotation rate
    tube.curvature.push_back({c * wx + n * wy, -n * wx + c * wy, rate});
    tube.strain.push_back(radius * std::hypot(kappa[0] - rotated[0], kappa[1] - rotated[1]));
}

double outermost_radius(const Robot& robot, const Configuration& q, double s) {
    for (const Tube& tube : robot.tubes) {
        const double begin = q.l[&tube - robot.tubes.data()];
        if (begin <= s && s <= begin + tube.length() + 1e-12) return tube.outer_radius;
    }
    return robot.tubes.back().outer_radius;
}

}  // namespace

void element_curvature(const FrictionSolver& solver, const LaneState& state, int lane, int e, double xi,
                       double (*curvature)[2], double (*rotated)[2]) {
    const KernelProblem& pb = solver.mesh().problem();
    const int m = pb.element_tubes[e], n = pb.tubes, offsets = offsets_of(pb, e);
    const double h = pb.length[e];
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
        const double c = curved ? std::cos(angle[t]) : 1.0, s = curved ? std::sin(angle[t]) : 0.0, EI = solver.robot().tubes[n - 1 - t].bending_stiffness;
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
        for (int t = 0; t < m; ++t) turn_section<double>(pb.law[t], v[t], angle[t], section[t]);
        for (int plane = 0; plane < 2; ++plane) {
            double first = 0, second = 0;
            for (int t = 0; t < m; ++t) {
                first += state.load_moment(e, 0, t, plane, lane);
                second += state.load_moment(e, 1, t, plane, lane);
            }
            load[plane] = first + part * (second - first);
        }
        free_mean<double>(m, pb.law, curvature, load, section, mean, inverse);
    }
    for (int t = 0; t < m; ++t)
        for (int plane = 0; plane < 2; ++plane) curvature[t][plane] += mean[plane] + state.bend(e, xi, t, plane, lane);
}

void section_moment(const FrictionSolver& solver, const LaneState& state, int lane, int e, int gauss, int t, const double* kappa,
                    const double* rotated, double* moment, double* tangent) {
    const KernelProblem& pb = solver.mesh().problem();
    if (pb.law) {
        const double xi = kGauss[gauss], angle = (1 - xi) * state.unknown(e, 5 * t, lane) + xi * state.unknown(e + 1, 5 * t, lane);
        BentSection<double> section;
        turn_section<double>(pb.law[t], pb.precurvature + ((e * 2 + gauss) * pb.tubes + t) * 2, angle, section);
        bend<double>(pb.law[t], kappa, section);
        for (int i = 0; i < 2; ++i) moment[i] = section.moment[i];
        for (int i = 0; i < 3; ++i) tangent[i] = section.tangent[i];
        return;
    }
    const double EI = solver.robot().tubes[pb.tubes - 1 - t].bending_stiffness;
    for (int i = 0; i < 2; ++i) moment[i] = EI * (kappa[i] - rotated[i]);
    tangent[0] = tangent[2] = EI;
    tangent[1] = 0;
}

namespace {

// Curvature of the innermost tube at the Gauss points of an element, and the square of the largest strain of any tube.
double innermost_bending(const FrictionSolver& solver, const LaneState& state, int lane, int e, double (*innermost)[2]) {
    const KernelProblem& pb = solver.mesh().problem();
    double kappa[kMaxTubes][2], rotated[kMaxTubes][2], square = 0;
    for (int g = 0; g < 2; ++g) {
        element_curvature(solver, state, lane, e, kGauss[g], kappa, rotated);
        for (int t = 0; t < pb.element_tubes[e]; ++t) {
            const double x = kappa[t][0] - rotated[t][0], y = kappa[t][1] - rotated[t][1];
            square = std::max(square, pb.outer_radius[t] * pb.outer_radius[t] * (x * x + y * y));
        }
        for (int plane = 0; plane < 2; ++plane) innermost[g][plane] = kappa[0][plane];
    }
    return square;
}

}  // namespace

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

Shape make_shape(const FrictionSolver& solver, const LaneState& state, int lane, const Configuration& q) {
    const KernelProblem& pb = solver.mesh().problem();
    const Robot& robot = solver.robot();
    const std::vector<double>& s = solver.mesh().s();
    const int n = robot.count();
    Shape shape;
    shape.tubes.resize(n);
    double kappa[4][kMaxTubes][2], rotated[kMaxTubes][2], rotated_end[kMaxTubes][2];
    std::vector<Frame> frame(n);
    BackboneTracer tracer;
    tracer.bend(solver, state, lane, 1);
    for (int e = 0; e < pb.elements; ++e) {
        const int m = pb.element_tubes[e];
        for (int g = 0; g < 2; ++g) {
            element_curvature(solver, state, lane, e, kGauss[g], kappa[g], rotated);
            tracer.innermost(e, g, lane, kappa[g][0]);  // the same digits as in a backbone
        }
        element_curvature(solver, state, lane, e, 1.0, kappa[3], rotated_end);
        element_curvature(solver, state, lane, e, 0.0, kappa[2], rotated);
        for (int t = 0; t < m; ++t) {
            const int i = n - 1 - t;
            TubeShape& tube = shape.tubes[i];
            const double radius = robot.tubes[i].outer_radius;
            const double rate = (state.unknown(e + 1, 5 * t, lane) - state.unknown(e, 5 * t, lane)) / pb.length[e];
            if (tube.s.empty()) {
                frame[i].p = {0, 0, q.l[i]};
                append(tube, s[e], frame[i], state.unknown(e, 5 * t, lane), rate, kappa[2][t], rotated[t], radius);
            }
            advance(frame[i], kappa[0][t], kappa[1][t], pb.length[e]);
            append(tube, s[e + 1], frame[i], state.unknown(e + 1, 5 * t, lane), rate, kappa[3][t], rotated_end[t], radius);
            // a section joint may jump the strain: report the larger side
            const double proximal = radius * std::hypot(kappa[2][t][0] - rotated[t][0], kappa[2][t][1] - rotated[t][1]);
            double& before = tube.strain[tube.strain.size() - 2];
            before = std::max(before, proximal);
        }
    }
    for (const TubeShape& tube : shape.tubes)
        for (double strain : tube.strain) shape.max_strain = std::max(shape.max_strain, strain);
    for (double at : shape.tubes[n - 1].s) shape.radius.push_back(outermost_radius(robot, q, at));
    shape.contacts.resize(n - 1);
    for (int e = 0; e < pb.elements; ++e)
        for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k) {
            const int p = pb.contact_pair[k];
            double d[2];
            for (int plane = 0; plane < 2; ++plane)
                d[plane] = pb.contact_shape[4 * k] * state.unknown(e, 1 + 5 * p + plane, lane) +
                           pb.contact_shape[4 * k + 1] * state.unknown(e, 3 + 5 * p + plane, lane) +
                           pb.contact_shape[4 * k + 2] * state.unknown(e + 1, 1 + 5 * p + plane, lane) +
                           pb.contact_shape[4 * k + 3] * state.unknown(e + 1, 3 + 5 * p + plane, lane) +
                           state.shift(k, plane, lane);
            ContactForces& contact = shape.contacts[n - 2 - p];
            contact.s.push_back(solver.mesh().contact_s()[k]);
            contact.force.push_back(state.multiplier(k, lane) * std::hypot(d[0], d[1]));
            contact.angle.push_back(std::atan2(d[1], d[0]));
        }
    return shape;
}

Shape make_shape(const Robot& robot, const ZeroClearance& solution, const Configuration& q) {
    const int n = robot.count();
    Shape shape;
    shape.tubes.resize(n);
    shape.contacts.resize(n - 1);
    std::vector<double> stations;
    for (int i = 0; i < n; ++i) {
        double s = q.l[i];
        stations.push_back(s);
        for (const Section& section : robot.tubes[i].sections) stations.push_back(s += section.length);
    }
    stations.push_back(0);
    std::sort(stations.begin(), stations.end());
    // curvature of the common centreline between stations, 0 behind the plate
    auto common = [&](double s, double middle, double* kappa, double (*rotated)[2]) {
        double total = 0;
        kappa[0] = kappa[1] = 0;
        for (int i = 0; i < n; ++i) {
            if (middle < q.l[i] || middle > q.l[i] + robot.tubes[i].length()) continue;
            double v[2];
            precurvature_at(robot.tubes[i], s - q.l[i], middle - q.l[i], v);
            const double theta = solution.theta(n - 1 - i, s), c = std::cos(theta), k = std::sin(theta), EI = robot.tubes[i].bending_stiffness;
            rotated[i][0] = c * v[0] - k * v[1];
            rotated[i][1] = k * v[0] + c * v[1];
            total += EI;
            for (int plane = 0; plane < 2; ++plane) kappa[plane] += EI * rotated[i][plane];
        }
        for (int plane = 0; plane < 2; ++plane) kappa[plane] = middle > 0 && total > 0 ? kappa[plane] / total : 0.0;
    };
    Frame frame;
    frame.p = {0, 0, q.l[n - 1]};
    double kappa[2], first[2], second[2], rotated[kMaxTubes][2];
    for (std::size_t b = 0; b + 1 < stations.size(); ++b) {
        const double from = stations[b], span = stations[b + 1] - from, middle = from + 0.5 * span;
        if (span < 1e-9) continue;
        const int count = std::max(1, static_cast<int>(std::ceil(span / kOutputStep)));
        const double h = span / count;
        for (int k = 0; k < count; ++k) {
            const double s = from + k * h;
            common(s + kGauss[0] * h, middle, first, rotated);
            common(s + kGauss[1] * h, middle, second, rotated);
            Frame start = frame;
            ctr::advance(frame, first, second, h);
            for (int side = 0; side < 2; ++side) {
                common(s + side * h, middle, kappa, rotated);
                for (int i = 0; i < n; ++i) {
                    if (middle < q.l[i] || middle > q.l[i] + robot.tubes[i].length()) continue;
                    TubeShape& tube = shape.tubes[i];
                    if (side == 0 && !tube.s.empty()) continue;
                    append(tube, s + side * h, side ? frame : start, solution.theta(n - 1 - i, s + side * h),
                           solution.twist_rate(n - 1 - i, s + side * h), kappa, rotated[i], robot.tubes[i].outer_radius);
                }
            }
        }
    }
    for (const TubeShape& tube : shape.tubes)
        for (double strain : tube.strain) shape.max_strain = std::max(shape.max_strain, strain);
    for (double at : shape.tubes[n - 1].s) shape.radius.push_back(outermost_radius(robot, q, at));
    shape.residual = solution.residual();
    return shape;
}

}  // namespace ctr
