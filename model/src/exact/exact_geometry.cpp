#include "exact/exact_geometry.hpp"

#include <algorithm>
#include <cmath>

#include "ctr/friction_solver.hpp"
#include "ctr/shape.hpp"

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"

Vec3 minus(const Vec3& a, const Vec3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
void add(Vec3& a, double factor, const Vec3& b) {
    for (int i = 0; i < 3; ++i) a[i] += factor * b[i];
}

void scale_to_unit(Vec3& a) {
    const double factor = 1 / std::sqrt(dot(a, a));
    for (double& x : a) x *= factor;
}

// On a centreline between two nodes: the cubic through points and tangents, shape being hermite() at xi.
Vec3 point_between(const Frame& a, const Frame& b, const double* shape) {
    Vec3 made;
    for (int i = 0; i < 3; ++i)
        made[i] = shape[0] * a.p[i] + shape[1] * a.R[3 * i + 2] + shape[2] * b.p[i] + shape[3] * b.R[3 * i + 2];
    return made;
}

Vec3 tangent_between(const Frame& a, const Frame& b, double xi, double h) {
    const double by_p = 6 * xi * (xi - 1) / h, by_a = 1 - 4 * xi + 3 * xi * xi, by_b = 3 * xi * xi - 2 * xi;
    Vec3 made;
    for (int i = 0; i < 3; ++i) made[i] = by_p * (a.p[i] - b.p[i]) + by_a * a.R[3 * i + 2] + by_b * b.R[3 * i + 2];
    scale_to_unit(made);
    return made;
}

// Axes of the normal plane: those of the nodes interpolated, and made orthonormal.
void axes_between(const Frame& a, const Frame& b, double xi, const Vec3& tangent, Vec3& e1, Vec3& e2) {
    for (int i = 0; i < 3; ++i) e1[i] = (1 - xi) * a.R[3 * i] + xi * b.R[3 * i];
    add(e1, -dot(e1, tangent), tangent);
    scale_to_unit(e1);
    e2 = cross(tangent, e1);
}

}  // namespace

void ExactGeometry::build(const FrictionSolver& solver, const Configuration& q) {
    const KernelProblem& pb = solver.mesh().problem();
    base_l_.assign(q.l.rbegin(), q.l.rend());
    mass_.resize(pb.tubes);
    for (int t = 0; t < pb.tubes; ++t) mass_[t] = solver.robot().tubes[pb.tubes - 1 - t].mass_per_length;
    curvature_.resize(pb.elements, pb.tubes);
    rotated_.resize(pb.elements, pb.tubes);
    frame_.resize(static_cast<std::size_t>(pb.nodes) * pb.tubes);
    work_.resize(pb.contacts);
    for (int k = 0; k < pb.contacts; ++k)
        for (int g = 0; g < 2; ++g) {
            const double x = pb.contact_xi[k], width = kGauss[g] - kGauss[1 - g];
            const double a = -kGauss[1 - g] / width, b = 1 / width;  // a + b xi: 1 at the Gauss point, 0 at the other
            work_[k].falling[g] = 2 * x * x * (a / 2 + b * x / 6);
            work_[k].constant[g] = 2 * x * (a + b * x / 2);
        }
    alignment_.build(solver);
}

void ExactGeometry::integrate(const KernelProblem& pb) {
    const int n = pb.tubes;
    for (int e = 0; e < pb.elements; ++e)
        for (int t = 0; t < pb.element_tubes[e]; ++t) {
            Frame &from = frame_[e * n + t], &to = frame_[(e + 1) * n + t];
            if (e == 0 || pb.element_tubes[e - 1] <= t) {
                from = Frame();
                from.p = {0, 0, base_l_[t]};
            }
            to = from;
            advance(to, curvature_.at(e, 0)[t], curvature_.at(e, 1)[t], pb.length[e]);
        }
}

void ExactGeometry::twist(Element& tube, const Work& work, double torque, const Vec3& tangent) {
    for (int g = 0; g < 2; ++g) {
        tube.moment[g][0] += work.constant[g] * torque * dot(tube.e2[g], tangent);
        tube.moment[g][1] -= work.constant[g] * torque * dot(tube.e1[g], tangent);
    }
    add(tube.torque, torque, tangent);
}

// A contact point: its offset in the outer tube's normal plane, the forces and torques that it carries, what they do to the
// element's tubes and, beyond its base, to what lies proximal.
void ExactGeometry::press(const KernelProblem& pb, LaneState& state, int lane, int e, int k) {
    const int n = pb.tubes, p = pb.contact_pair[k];
    const double xi = pb.contact_xi[k], h = pb.length[e], *shape = pb.contact_shape + 4 * k;
    const Frame *a = &frame_[e * n + p], *b = &frame_[(e + 1) * n + p];  // inner tube, then the outer one
    Element *inner = &element_[p], *outer = inner + 1;
    Vec3 at[2], e1, e2, tangent;
    if (xi == 0 || xi == 1) {
        const Frame* end = xi == 0 ? a : b;
        at[0] = end[0].p;
        at[1] = end[1].p;
        tangent = end[1].tangent();
        e1 = end[1].column(0);
        e2 = end[1].column(1);
    } else {
        for (int side = 0; side < 2; ++side) at[side] = point_between(a[side], b[side], shape);
        tangent = tangent_between(a[1], b[1], xi, h);
        axes_between(a[1], b[1], xi, tangent, e1, e2);
    }
    const Vec3 arm = minus(at[0], at[1]);
    const double d[2] = {dot(e1, arm), dot(e2, arm)};
    const double lambda = state.multiplier(k, lane), friction = state.phi_mu(k, lane);
    const double force[2] = {lambda * (d[0] - friction * d[1]), lambda * (d[1] + friction * d[0])};
    for (int plane = 0; plane < 2; ++plane) {
        double unknown = 0;
        for (int i = 0; i < 4; ++i) {
            unknown += shape[i] * inner->offset[i][plane];
            inner->load[i][plane] -= shape[i] * force[plane];
        }
        state.shift(k, plane, lane) = d[plane] - unknown;
    }
    Vec3 on_outer;
    for (int i = 0; i < 3; ++i) on_outer[i] = force[0] * e1[i] + force[1] * e2[i];
    for (int side = 0; side < 2; ++side) {
        Element& tube = side == 0 ? *inner : *outer;
        const double sign = side == 0 ? -1 : 1;
        for (int g = 0; g < 2; ++g) {
            const double falling = sign * h * work_[k].falling[g];
            tube.moment[g][0] += falling * dot(tube.e1[g], on_outer);
            tube.moment[g][1] += falling * dot(tube.e2[g], on_outer);
        }
        add(tube.force, sign, on_outer);
        add(tube.torque, sign, cross(minus(at[side], a[side].p), on_outer));
    }
    if (friction == 0) return;
    const double torque = friction * lambda * (d[0] * d[0] + d[1] * d[1]);
    twist(*outer, work_[k], pb.outer_torque_arm[p] * torque, tangent);
    twist(*inner, work_[k], -pb.inner_torque_arm[p] * torque, xi == 0 ? a->tangent() : xi == 1 ? b->tangent() : tangent_between(*a, *b, xi, h));
}

// Prepares the tubes of an element for the loads beyond it. The moments are means weighted at the Gauss points, which do on
// linear curvatures the work of the true ones.
void ExactGeometry::begin_element(const FrictionSolver& solver, const LaneState& state, int lane, int e) {
    const KernelProblem& pb = solver.mesh().problem();
    const Loads& loads = solver.robot().loads;
    const int n = pb.tubes;
    const double h = pb.length[e];
    for (int t = 0; t < pb.element_tubes[e]; ++t) {
        Element& tube = element_[t];
        const Frame &a = frame_[e * n + t], &b = frame_[(e + 1) * n + t];
        if (e + 1 == pb.elements || pb.element_tubes[e + 1] <= t) {  // its tip
            tube.force = tube.torque = {0, 0, 0};
            for (int i = 0; i < 3 && t == 0; ++i) {
                tube.force[i] = loads.tip_force[i];
                tube.torque[i] = loads.tip_moment[i];
            }
        }
        Vec3 weight;
        for (int i = 0; i < 3; ++i) weight[i] = mass_[t] * h * loads.gravity[i];
        for (int g = 0; g < 2; ++g) {
            double shape[4];
            hermite(kGauss[g], h, shape);
            axes_between(a, b, kGauss[g], tangent_between(a, b, kGauss[g], h), tube.e1[g], tube.e2[g]);
            Vec3 moment = tube.torque;
            const Vec3 arm = minus(b.p, point_between(a, b, shape));
            add(moment, 1, cross(arm, tube.force));
            add(moment, 0.5 * (1 - kGauss[g]), cross(arm, weight));
            tube.moment[g][0] = dot(tube.e2[g], moment);
            tube.moment[g][1] = -dot(tube.e1[g], moment);
        }
        add(tube.torque, 1, cross(minus(b.p, a.p), tube.force));
        add(tube.torque, 0.5, cross(minus(b.p, a.p), weight));
        add(tube.force, 1, weight);
        for (int i = 0; i < 4; ++i)
            for (int plane = 0; plane < 2; ++plane) {
                if (t + 1 < n) tube.offset[i][plane] = state.unknown(e + i / 2, 1 + 5 * t + 2 * (i % 2) + plane, lane);
                tube.load[i][plane] = 0;
            }
    }
}

// The balance of moments in an element, tested with the first-order model's own displacements. What is left of the sum over
// the tubes bends all of them; returns the largest of it.
double ExactGeometry::balance(const FrictionSolver& solver, LaneState& state, int lane, int e) {
    const KernelProblem& pb = solver.mesh().problem();
    const int m = pb.element_tubes[e], offsets = offsets_of(pb, e);
    double worst = 0;
    for (int g = 0; g < 2; ++g) {
        const double(*rotated)[2] = rotated_.at(e, g), (*curvature)[2] = curvature_.at(e, g);
        Bent flat[kMaxTubes], bent[kMaxTubes];  // as the kernel has it, and as it is
        double left[2] = {0, 0}, stiff[3] = {0, 0, 0}, more[2] = {0, 0};
        for (int t = 0; t < m; ++t) {
            for (int i = 0; i < 2; ++i) {
                bent[t].kappa[i] = curvature[t][i];
                flat[t].kappa[i] = curvature[t][i] - state.bend_at_gauss(e, g, t, i, lane);
            }
            for (Bent* at : {&flat[t], &bent[t]}) section_moment(solver, state, lane, e, g, t, at->kappa, rotated[t], at->moment, at->tangent);
            for (int i = 0; i < 2; ++i) left[i] += element_[t].moment[g][i] - bent[t].moment[i];
            for (int i = 0; i < 3; ++i) stiff[i] += bent[t].tangent[i];
        }
        if (solver.mesh().mean_is_free(e)) {
            const double over = 1 / (stiff[0] * stiff[2] - stiff[1] * stiff[1]);
            more[0] = over * (stiff[2] * left[0] - stiff[1] * left[1]);
            more[1] = over * (stiff[0] * left[1] - stiff[1] * left[0]);
            worst = std::max({worst, std::fabs(left[0]), std::fabs(left[1])});
        }
        double b[4], sum[2] = {0, 0};
        hermite_second(kGauss[g], pb.length[e], b);
        const double weight = 0.5 * pb.length[e];
        for (int t = 0; t < m; ++t) {
            const double* K = bent[t].tangent;
            for (int i = 0; i < 2; ++i) {
                bent[t].moment[i] += K[i] * more[0] + K[i + 1] * more[1];
                bent[t].kappa[i] += more[i];
                state.bend_at_gauss(e, g, t, i, lane) += more[i];
                const double known = state.load_moment(e, g, t, i, lane);  // to the kernel
                sum[i] += weight * (bent[t].moment[i] - flat[t].moment[i] + known - element_[t].moment[g][i]);
                for (int a = 0; a < 4 && t < offsets; ++a) element_[t].load[a][i] += b[a] * sum[i];
            }
            const double torque = weight * (bent[t].torque() - flat[t].torque());
            state.load(e, 5 * t, lane) += (1 - kGauss[g]) * torque;
            state.load(e + 1, 5 * t, lane) += kGauss[g] * torque;
        }
    }
    for (int p = 0; p < offsets; ++p)
        for (int i = 0; i < 4; ++i)
            for (int plane = 0; plane < 2; ++plane) state.load(e + i / 2, 1 + 5 * p + 2 * (i % 2) + plane, lane) += element_[p].load[i][plane];
    return worst;
}

double ExactGeometry::update(const FrictionSolver& solver, LaneState& state, int lane) {
    const KernelProblem& pb = solver.mesh().problem();
    for (int k = 0; k < pb.nodes; ++k)
        for (int i = 0; i < pb.stride; ++i) state.load(k, i, lane) = 0;
    for (int e = 0; e < pb.elements; ++e)
        for (int g = 0; g < 2; ++g) element_curvature(solver, state, lane, e, kGauss[g], curvature_.at(e, g), rotated_.at(e, g));
    alignment_.correct(solver, state, lane, curvature_);
    integrate(pb);
    alignment_.record(solver, state, lane, curvature_, frame_);
    const double* tip_moment = solver.robot().loads.tip_moment;
    const Vec3 tip = frame_[static_cast<std::size_t>(pb.nodes - 1) * pb.tubes].tangent();
    // twists the innermost tube; the kernel has it at the first-order tip
    state.load(pb.nodes - 1, 0, lane) -= dot({tip_moment[0], tip_moment[1], tip_moment[2]}, tip) - state.tip_torque(lane);
    double worst = 0;
    for (int e = pb.elements - 1; e >= 0; --e) {
        begin_element(solver, state, lane, e);
        for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k) press(pb, state, lane, e, k);
        worst = std::max(worst, balance(solver, state, lane, e));
    }
    return worst;
}

}  // namespace ctr
