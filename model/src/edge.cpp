#include "ctr/edge.hpp"

#include <algorithm>
#include <cmath>

namespace ctr {
namespace {

// Cubic Hermite between two nodes; tangents are unit, so that the element length scales them.
Vec3 between(const Vec3& a, const Vec3& ta, const Vec3& b, const Vec3& tb, double h, double x) {
    const double x2 = x * x, x3 = x2 * x, A = 1 - 3 * x2 + 2 * x3, B = h * (x - 2 * x2 + x3), C = 3 * x2 - 2 * x3, D = h * (x3 - x2);
    Vec3 p;
    for (int i = 0; i < 3; ++i) p[i] = A * a[i] + B * ta[i] + C * b[i] + D * tb[i];
    return p;
}

double backbone_clearance(const BoundSolver& bound, const Backbone& shape, const SignedDistanceField& field, double spacing) {
    const Mesh& mesh = bound.solver().mesh();
    const KernelProblem& pb = mesh.problem();
    const Robot& robot = bound.solver().robot();
    double least = 1e9;
    for (int e = 0; e < pb.elements; ++e) {
        if (mesh.s()[e + 1] <= 0) continue;
        const double radius = robot.tubes[pb.tubes - pb.element_tubes[e]].outer_radius, h = pb.length[e];
        const int count = std::max(1, static_cast<int>(std::ceil(h / spacing)));
        const Frame &fa = shape.frame[e], &fb = shape.frame[e + 1];
        // offset of the outermost tube present, taken from this side of the distal node
        Vec3 end = fb.p;
        const Vec3& start = shape.outer_position[e];
        if (e + 1 < pb.elements && pb.element_tubes[e + 1] == pb.element_tubes[e]) end = shape.outer_position[e + 1];
        for (int k = e == 0 ? 0 : 1; k <= count; ++k) {
            const Vec3 p = between(start, fa.tangent(), end, fb.tangent(), h, static_cast<double>(k) / count);
            least = std::min(least, field.sample(p) - radius);
        }
    }
    return least;
}

double largest_motion(const std::vector<Frame>& before, const std::vector<Frame>& after) {
    double most = 0;
    const std::size_t last = std::min(before.size(), after.size());
    for (std::size_t k = 1; k <= last; ++k) {  // counted from the tip: bases may have more or fewer nodes
        const Vec3 &a = before[before.size() - k].p, &b = after[after.size() - k].p;
        most = std::max(most, std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]));
    }
    return most;
}

}  // namespace

double clearance(const BoundSolver& bound, const SignedDistanceField& field, double spacing) {
    if (!field.values) return 1e9;
    double least = backbone_clearance(bound, bound.backbone, field, spacing);
    for (const Backbone& shape : bound.corner_backbones) least = std::min(least, backbone_clearance(bound, shape, field, spacing));
    return least;
}

std::vector<LegSample> check_leg(BoundSolver& solver, const std::vector<Configuration>& configurations,
                                 const MeshDensity& density, const SignedDistanceField& field, double spacing,
                                 const LegLimits& limits) {
    std::vector<LegSample> samples;
    std::vector<Frame> before;
    for (const Configuration& q : configurations) {
        samples.empty() ? solver.solve(q, density) : solver.follow(q, density);
        LegSample sample;
        sample.status = solver.status();
        if (!solver.all_converged()) sample.status = Status::failed;
        sample.position_bound = solver.position;
        sample.tangent_bound = solver.tangent;
        sample.stability = solver.stability();
        sample.max_strain = solver.max_strain;
        sample.clearance = clearance(solver, field, spacing);
        sample.motion = samples.empty() ? 0 : largest_motion(before, solver.backbone.frame);
        sample.tip = solver.backbone.frame.back().p;
        sample.tangent = solver.backbone.frame.back().tangent();
        samples.push_back(sample);
        const bool broken = sample.status == Status::failed || sample.status == Status::unstable ||
                            sample.stability < limits.stability || sample.max_strain > limits.max_strain ||
                            sample.clearance < limits.clearance;
        if (broken) break;
        before = solver.backbone.frame;
    }
    return samples;
}

}  // namespace ctr
