#include "ctr/walk.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace ctr {
namespace {

constexpr double kShortestStep = 1.0 / 1024;  // of a leg
constexpr double kMarkerSpacing = 4e-3;       // m
constexpr double kSurprise = 1.5;              // times the motion expected from the step before
constexpr double kSnap = 1e-3;                // m; more motion than expected that counts as a jump
constexpr double kLeap = 0.75;                // of the motion of a rejected step; a shorter one that keeps so much of it jumps
constexpr int kMostBetween = 729;             // friction states between corners, a budget: halves of up to four pairs, signs of up to six

#include "mesh/element_functions.hpp"
#include "walk/outer_line.hpp"

double backbone_clearance(const BoundSolver& bound, const Backbone& shape, const SignedDistanceField& field, double spacing) {
    double least = 1e9;
    for_outer_points(bound.solver(), shape, spacing, [&](const Vec3& p, double radius) { least = std::min(least, field.sample(p) - radius); });
    return least;
}

// Friction states between the corners: phi [state][pair], and weights [state][shape] of the frictionless shape and of every corner's,
// multilinear between the corners plus a parabola that takes their mean to the frictionless shape.
struct StatesBetween {
    std::vector<double> phi, weights;
};

// None of more pairs than the budget allows.
StatesBetween states_between(const BoundSolver& bound, int pairs) {
    const int corners = bound.corners();
    StatesBetween made;
    if (pairs == 0 || corners != 1 << pairs || std::pow(3, pairs) > kMostBetween) return made;
    const int values = std::pow(5, pairs) <= kMostBetween ? 5 : 3, states = static_cast<int>(std::lround(std::pow(values, pairs)));
    std::vector<double> phi(pairs);
    for (int state = 0; state < states; ++state) {
        int digits = state, full = 0, empty = 0;
        double square = 0;
        for (double& x : phi) {
            x = 2.0 * (digits % values) / (values - 1) - 1;
            digits /= values;
            square += x * x / pairs;
            full += std::fabs(x) == 1;
            empty += x == 0;
        }
        if (full == pairs || empty == pairs) continue;  // those are solved
        made.phi.insert(made.phi.end(), phi.begin(), phi.end());
        made.weights.push_back(1 - square);
        for (int corner = 0; corner < corners; ++corner) {
            double weight = 1;
            for (int pair = 0; pair < pairs; ++pair) weight *= 1 + bound.sign(corner, pair) * phi[pair];
            made.weights.push_back((weight + square - 1) / corners);
        }
    }
    return made;
}

// Puts the least clearance of shapes between the corners into the sample, where it is below that of the others, and their friction
// state. They lie no farther from the frictionless one than twice the farthest corner does, so that most points are not looked up again.
void look_between(const BoundSolver& bound, const SignedDistanceField& field, double spacing, const StatesBetween& between, PathSample& sample) {
    std::vector<double> body;
    collect_points(bound, bound.backbone, spacing, body);
    const std::size_t size = body.size(), shapes = 1 + bound.corner_backbones.size(), pairs = between.phi.size() * shapes / between.weights.size();
    for (const Backbone& shape : bound.corner_backbones) collect_points(bound, shape, spacing, body);
    for (std::size_t k = 0; k < size; k += 4) {
        const double* own = body.data() + k;
        double square = 0;
        for (std::size_t j = 1; j < shapes; ++j) {
            const double* other = own + j * size;
            const Vec3 away{other[0] - own[0], other[1] - own[1], other[2] - own[2]};
            square = std::max(square, dot(away, away));
        }
        if (field.sample({own[0], own[1], own[2]}) - own[3] - 2 * std::sqrt(square) >= sample.clearance) continue;
        for (std::size_t row = 0; row < between.weights.size() / shapes; ++row) {
            Vec3 p{0, 0, 0};
            for (std::size_t j = 0; j < shapes; ++j)
                for (int i = 0; i < 3; ++i) p[i] += between.weights[row * shapes + j] * own[j * size + i];
            const double room = field.sample(p) - own[3];
            if (room >= sample.clearance) continue;
            sample.clearance = room;
            std::copy_n(between.phi.begin() + row * pairs, pairs, sample.nearest_phi.begin());
        }
    }
}

// Points that move with the material, per tube where it is the outermost: at fixed distances from the tube's own tip.
using Markers = std::vector<std::vector<Vec3>>;

Markers material_markers(const BoundSolver& bound, const Backbone& shape) {
    const Mesh& mesh = bound.solver().mesh();
    const KernelProblem& pb = mesh.problem();
    Markers markers(pb.tubes);
    std::vector<double> tip(pb.tubes);
    for (int i = 0; i < pb.tubes; ++i) tip[i] = bound.configuration().l[i] + bound.solver().robot().tubes[i].length();
    for_outer_elements(bound.solver(), shape, [&](int e, const Vec3& start, const Vec3& end) {
        const int i = pb.tubes - pb.element_tubes[e];
        const double from = tip[i] - mesh.s()[e], h = pb.length[e];  // distances to the tip fall along the element
        for (int k = static_cast<int>(std::ceil((from - h) / kMarkerSpacing - 1e-9)); k * kMarkerSpacing < from + 1e-12; ++k) {
            if (k < 0) continue;
            const double x = std::clamp((from - k * kMarkerSpacing) / h, 0.0, 1.0);
            std::vector<Vec3>& row = markers[i];
            if (static_cast<int>(row.size()) <= k) row.resize(k + 1, Vec3{1e9, 0, 0});
            row[k] = between(start, shape.frame[e].tangent(), end, shape.frame[e + 1].tangent(), h, x);
        }
    });
    return markers;
}

// Of the frictionless shape, then of the corners'.
std::vector<Markers> markers_of_shapes(const BoundSolver& bound) {
    std::vector<Markers> all{material_markers(bound, bound.backbone)};
    for (const Backbone& shape : bound.corner_backbones) all.push_back(material_markers(bound, shape));
    return all;
}

double largest_motion(const Markers& before, const Markers& after) {
    double square = 0;
    for (std::size_t i = 0; i < before.size(); ++i)
        for (std::size_t k = 0; k < std::min(before[i].size(), after[i].size()); ++k) {
            const Vec3 &a = before[i][k], &b = after[i][k], d{a[0] - b[0], a[1] - b[1], a[2] - b[2]};
            if (a[0] < 1e8 && b[0] < 1e8) square = std::max(square, dot(d, d));
        }
    return std::sqrt(square);
}

// Joint steps of the density between two configurations.
double steps(const Configuration& a, const Configuration& b, const PathDensity& density) {
    double most = 0;
    for (std::size_t i = 0; i < a.theta.size(); ++i)
        most = std::max({most, std::fabs(b.theta[i] - a.theta[i]) / density.rotation, std::fabs(b.l[i] - a.l[i]) / density.translation});
    return most;
}

Configuration between(const Configuration& a, const Configuration& b, double share) {
    Configuration q = a;
    for (std::size_t i = 0; i < a.theta.size(); ++i) {
        q.theta[i] += share * (b.theta[i] - a.theta[i]);
        q.l[i] += share * (b.l[i] - a.l[i]);
    }
    return share >= 1 ? b : q;
}

}  // namespace

void collect_points(const BoundSolver& bound, const Backbone& shape, double spacing, std::vector<double>& out) {
    for_outer_points(bound.solver(), shape, spacing, [&](const Vec3& p, double radius) { out.insert(out.end(), {p[0], p[1], p[2], radius}); });
}

double clearance(const BoundSolver& bound, const SignedDistanceField& field, double spacing) {
    if (!field.values) return 1e9;
    double least = backbone_clearance(bound, bound.backbone, field, spacing);
    for (const Backbone& shape : bound.corner_backbones) least = std::min(least, backbone_clearance(bound, shape, field, spacing));
    return least;
}

std::vector<PathSample> check_path(BoundSolver& solver, const std::vector<Configuration>& corners, const Accuracy& mesh,
                                   const SignedDistanceField& field, const PathDensity& density, const PathLimits& limits,
                                   bool keep_shapes, bool goes_on) {
    std::vector<PathSample> samples;
    std::vector<Markers> before, now;
    const int pairs = solver.solver().robot().count() - 1;
    const StatesBetween between_corners = density.between_corners && field.values ? states_between(solver, pairs) : StatesBetween();
    int solves = 0;
    // Solves at q and appends the sample; false if it breaks a limit.
    auto record = [&](int segment, double fraction, double motion) {
        PathSample sample;
        sample.segment = segment;
        sample.fraction = fraction;
        sample.status = solver.all_converged() ? solver.status() : Status::failed;
        sample.position_bound = solver.position;
        sample.tangent_bound = solver.tangent;
        sample.stability = solver.stability();
        sample.max_strain = solver.max_strain;
        sample.clearance = clearance(solver, field, density.point_spacing);
        sample.nearest_phi.assign(pairs, std::numeric_limits<double>::quiet_NaN());
        if (!between_corners.phi.empty()) look_between(solver, field, density.point_spacing, between_corners, sample);
        sample.motion = motion;
        sample.solves = solves;
        solves = 0;
        sample.tip = solver.backbone.tip.p;
        sample.tangent = solver.backbone.tip.tangent();
        for (const Backbone& corner : solver.corner_backbones) sample.corner_tips.push_back(corner.tip.p);
        if (keep_shapes) {
            collect_points(solver, solver.backbone, density.point_spacing, sample.body);
            for (const Backbone& corner : solver.corner_backbones) collect_points(solver, corner, density.point_spacing, sample.body);
            sample.shape_stability = solver.shape_stabilities();
            sample.shape_max_strain.push_back(solver.backbone.max_strain);
            for (const Backbone& corner : solver.corner_backbones) sample.shape_max_strain.push_back(corner.max_strain);
        }
        samples.push_back(std::move(sample));
        return sample.status != Status::failed && sample.status != Status::unstable && sample.stability >= limits.stability &&
               sample.max_strain <= limits.max_strain && sample.clearance >= limits.clearance;
    };
    if (corners.empty()) return samples;
    if (goes_on) solver.begin_at(corners.front(), mesh);
    else solver.solve(corners.front(), mesh);
    ++solves;
    before = markers_of_shapes(solver);
    if (!record(0, 0, 0)) return samples;
    for (std::size_t leg = 0; leg + 1 < corners.size(); ++leg) {
        const Configuration &a = corners[leg], &b = corners[leg + 1];
        const double longest = steps(a, b, density);  // joint steps this leg needs at least
        double at = 0, step = 1 / std::max(1.0, std::ceil(longest - 1e-9));
        double rate = 0, pace = 0;  // motion over the last step, of the frictionless shape and of the fastest
        const double largest = step;
        bool retrying = false;
        double rejected = 0, rejected_most = 0;  // motion of the last step that was not accepted
        while (at < 1) {
            const double allowed = density.allowed(samples.back().clearance);
            if (pace > 0) step = std::min(step, 0.85 * allowed / pace);
            double next = at + step > 1 - 1e-9 ? 1 : at + step;
            if (next < 1 && at + 2 * step > 1) next = 0.5 * (at + 1);  // two even steps rather than a long and a sliver
            solver.follow(between(a, b, next), mesh, retrying);
            ++solves;
            now = markers_of_shapes(solver);
            const double motion = largest_motion(before[0], now[0]);
            double most = motion;
            for (std::size_t k = 1; k < now.size(); ++k) most = std::max(most, largest_motion(before[k], now[k]));
            // A body that moves much faster than before may have snapped: look closer, until its motion shrinks with the step.
            const bool surprising = rate > 0 && motion > kSurprise * rate * (next - at) + kSnap && motion > kLeap * rejected;
            // A corner leaps where its friction state loses its equilibrium. No step shows what lies between.
            const bool leaps = motion <= allowed && rejected_most > 0 && most > kLeap * rejected_most;
            if (((most > allowed && !leaps) || surprising) && next - at > kShortestStep) {
                step = std::max(0.5 * (next - at), 0.5 * kShortestStep);
                rejected = motion;
                rejected_most = most;
                retrying = true;
                continue;
            }
            retrying = false;
            const bool jumped = next - at <= kShortestStep && motion > std::max(allowed, kSnap);
            const bool snapped = jumped || (surprising && next - at <= kShortestStep);
            rejected = rejected_most = 0;
            rate = motion / (next - at);
            pace = leaps ? rate : most / (next - at);
            if (!record(static_cast<int>(leg), next, most)) return samples;
            if (snapped) {
                samples.back().status = Status::unstable;
                return samples;
            }
            before.swap(now);
            step = std::min(largest, 2 * (next - at));  // after a closer look the steps grow again bit by bit
            at = next;
        }
    }
    return samples;
}

}  // namespace ctr
