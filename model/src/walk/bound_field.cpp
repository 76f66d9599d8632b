#include "ctr/bound_field.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"
#include "walk/outer_line.hpp"

constexpr double kTurn = 6.283185307179586477;
constexpr int kMostCubicAxes = 3;  // 4^3 grid points an entry; beyond that 2^axes
constexpr float kLocalError = 0.5f;   // of the difference between linear and cubic interpolation, added to bounds
constexpr float kShapeError = 0.1f;   // and for points of the shape, to the envelope
constexpr double kOffGrid = 1e-9;  // of a step
constexpr double kShortestStep = 1.0 / 256;  // of a leg
constexpr int kEvery = 3;  // stations looked at where there is no anatomy: motions need no more
constexpr double kLongWay = 1.2;  // of a cubic between two stations, over their chord

// Four weights for the grid points around a value, Catmull-Rom, with the line continued beyond the ends of an axis.
void cubic_weights(double x, bool first, bool last, double* w) {
    const double x2 = x * x, x3 = x2 * x;
    w[0] = 0.5 * (-x + 2 * x2 - x3);
    w[1] = 0.5 * (2 - 5 * x2 + 3 * x3);
    w[2] = 0.5 * (x + 4 * x2 - 3 * x3);
    w[3] = 0.5 * (-x2 + x3);
    if (first) {
        w[1] += 2 * w[0];
        w[2] -= w[0];
        w[0] = 0;
    }
    if (last) {
        w[2] += 2 * w[3];
        w[1] -= w[3];
        w[3] = 0;
    }
}

Vec3 turned(const float* v, double c, double s) { return {c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]}; }

// Adds what is wanted of a grid point, see BoundField::sample.
void add(float weight, const float* from, int every, float* sum) {
    if (every == 1) {
        for (int i = 0; i < kFieldFloats; ++i) sum[i] += weight * from[i];
        return;
    }
    constexpr int kHead = offsetof(FieldEntry, point) / sizeof(float), kTangent = offsetof(FieldEntry, tip_tangent) / sizeof(float);
    for (int i = 0; i < kHead; ++i) sum[i] += weight * from[i];
    for (int j = kStations - 1; j >= 0; j -= every)
        for (int i = kHead + 3 * j; i < kHead + 3 * j + 3; ++i) sum[i] += weight * from[i];
    for (int i = kTangent; i < kTangent + 3; ++i) sum[i] += weight * from[i];
}

double apart(const Vec3& a, const Vec3& b) { return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]); }

}  // namespace

FieldEntry field_entry(BoundSolver& solver, const Configuration& q, const Accuracy& accuracy) {
    solver.solve(q, accuracy);
    FieldEntry entry;
    const Status status = solver.all_converged() ? solver.status() : Status::failed;
    entry.valid = status == Status::converged || status == Status::multiple ? 1 : 0;
    entry.position = static_cast<float>(solver.position);
    entry.tangent = static_cast<float>(solver.tangent);
    entry.stability = static_cast<float>(solver.stability());
    entry.strain = static_cast<float>(solver.max_strain);
    const double length = q.l.back() + solver.solver().robot().tubes.back().length();
    for (int j = 0; j < kStations; ++j) {
        const double s = length * (j + 1) / kStations;
        const Vec3 point = outer_point(solver, solver.backbone, s);
        double most = 0;
        for (const Backbone& corner : solver.corner_backbones) most = std::max(most, apart(point, outer_point(solver, corner, s)));
        for (int i = 0; i < 3; ++i) entry.point[j][i] = static_cast<float>(point[i]);
        entry.envelope[j] = static_cast<float>(most);
    }
    const Vec3 tangent = solver.backbone.tip.tangent();
    for (int i = 0; i < 3; ++i) entry.tip_tangent[i] = static_cast<float>(tangent[i]);
    return entry;
}

BoundField::BoundField(const Robot& robot, std::vector<FieldAxis> axes, const float* values, double margin)
    : robot_(robot), axes_(std::move(axes)), values_(values), margin_(margin) {
    stride_.assign(axes_.size(), 1);
    for (int a = static_cast<int>(axes_.size()) - 2; a >= 0; --a) stride_[a] = stride_[a + 1] * axes_[a + 1].count;
}

FieldEntry BoundField::sample(const Configuration& q, int every) const {
    const int axes = static_cast<int>(axes_.size());
    int cell[kMostAxes];
    double part[kMostAxes];
    FieldEntry entry;
    for (int a = 0; a < axes; ++a) {
        const FieldAxis& axis = axes_[a];
        double x = axis.rotation ? q.theta[axis.tube] - q.theta[axis.tube - 1] : q.l[axis.tube];
        if (axis.rotation) x -= kTurn * std::floor((x - axis.lower) / kTurn);
        x = (x - axis.lower) / axis.step;
        const int cells = axis.rotation ? axis.count : axis.count - 1;
        if (!(x >= -kOffGrid && x <= cells + kOffGrid)) return entry;  // NaN neither
        cell[a] = std::clamp(static_cast<int>(x), 0, cells - 1);
        part[a] = x - cell[a];
    }
    long place[kMostAxes][4];  // of the grid points around, along each axis
    for (int a = 0; a < axes; ++a)
        for (int side = 0; side < 4; ++side) {
            const FieldAxis& axis = axes_[a];
            int i = cell[a] + side - 1;
            if (axis.rotation) i = (i % axis.count + axis.count) % axis.count;
            place[a][side] = std::clamp(i, 0, axis.count - 1) * stride_[a];
        }
    float* out = reinterpret_cast<float*>(&entry);
    const int linear = 1 << axes;
    bool valid = true;
    for (int corner = 0; corner < linear; ++corner) {
        double weight = 1;
        long index = 0;
        for (int a = 0; a < axes; ++a) {
            const int side = corner >> a & 1;
            weight *= side ? part[a] : 1 - part[a];
            index += place[a][side + 1];
        }
        const float* from = values_ + index * kFieldFloats;
        valid = valid && reinterpret_cast<const FieldEntry*>(from)->valid > 0;
        add(static_cast<float>(weight), from, every, out);
    }
    entry.valid = valid ? 1 : 0;
    if (!valid || axes > kMostCubicAxes) return entry;
    double weights[kMostAxes][4];
    for (int a = 0; a < axes; ++a) {
        const bool open = !axes_[a].rotation;
        cubic_weights(part[a], open && cell[a] == 0, open && cell[a] >= axes_[a].count - 2, weights[a]);
    }
    FieldEntry smooth;
    float* sum = reinterpret_cast<float*>(&smooth);
    const int cubic = 1 << (2 * axes);
    for (int corner = 0; corner < cubic; ++corner) {
        double weight = 1;
        long index = 0;
        for (int a = 0; a < axes; ++a) {
            const int side = corner >> (2 * a) & 3;
            weight *= weights[a][side];
            index += place[a][side];
        }
        if (weight == 0) continue;
        const float* from = values_ + index * kFieldFloats;
        if (!(reinterpret_cast<const FieldEntry*>(from)->valid > 0)) return entry;  // next to a snap: the linear values stand
        add(static_cast<float>(weight), from, every == 1 ? 1 : kStations, sum);  // else of the stations the tip alone
    }
    if (every != 1)
        for (int j = 0; j + 1 < kStations; ++j) std::copy_n(entry.point[j], 3, smooth.point[j]);
    // how much both differ says how far either may be off here
    auto above = [](float a, float b) { return std::max(a, b) + kLocalError * std::fabs(a - b); };
    smooth.position = above(smooth.position, entry.position);
    smooth.tangent = above(smooth.tangent, entry.tangent);
    smooth.strain = above(smooth.strain, entry.strain);
    smooth.stability = std::min(smooth.stability, entry.stability);
    for (int j = 0; j < kStations && every == 1; ++j) {
        float aside = 0;
        for (int i = 0; i < 3; ++i) aside += (smooth.point[j][i] - entry.point[j][i]) * (smooth.point[j][i] - entry.point[j][i]);
        smooth.envelope[j] = above(smooth.envelope[j], entry.envelope[j]) + kShapeError * std::sqrt(aside);
    }
    smooth.valid = 1;
    return smooth;
}

PathSample BoundField::measure(const Configuration& q, const SignedDistanceField& field, double spacing, FieldEntry& entry) const {
    entry = sample(q, field.values ? 1 : kEvery);
    PathSample result;
    if (!(entry.valid > 0)) return result;
    const double c = std::cos(q.theta[0]), s = std::sin(q.theta[0]);
    result.status = Status::converged;
    result.position_bound = entry.position + margin_;
    result.tangent_bound = entry.tangent;
    result.stability = entry.stability;
    result.max_strain = entry.strain;
    result.tip = turned(entry.point[kStations - 1], c, s);
    result.tangent = turned(entry.tip_tangent, c, s);
    const double size = std::sqrt(dot(result.tangent, result.tangent));
    for (double& value : result.tangent) value /= size;
    result.clearance = field.values ? clearance(q, entry, field, spacing) : 1e9;
    return result;
}

// Stations first; between two of them only where distances, being 1-Lipschitz, leave it open.
double BoundField::clearance(const Configuration& q, const FieldEntry& entry, const SignedDistanceField& field, double spacing) const {
    const double c = std::cos(q.theta[0]), s = std::sin(q.theta[0]);
    const int n = robot_.count();
    const double length = q.l.back() + robot_.tubes.back().length();
    Vec3 points[kStations + 1];
    points[0] = {0, 0, 0};
    for (int j = 0; j < kStations; ++j) points[j + 1] = turned(entry.point[j], c, s);
    double distance[kStations + 1], least = 1e9;
    int tube = 0, tubes[kStations + 1];  // outermost present
    for (int j = 0; j <= kStations; ++j) {
        while (tube + 1 < n && length * j / kStations > q.l[tube] + robot_.tubes[tube].length()) ++tube;
        tubes[j] = tube;
        distance[j] = field.sample(points[j]);
        least = std::min(least, distance[j] - robot_.tubes[tube].outer_radius - (j == 0 ? 0 : entry.envelope[j - 1]) - margin_);
    }
    const int parts = std::max(1, static_cast<int>(std::ceil(length / kStations / spacing)));
    for (int j = 0; j < kStations; ++j) {
        double w[4];
        const double near = j == 0 ? 0 : entry.envelope[j - 1], far = entry.envelope[j];
        tube = tubes[j];
        const double within = 0.5 * (distance[j] + distance[j + 1] - kLongWay * apart(points[j], points[j + 1]));
        if (within - robot_.tubes[tube].outer_radius - std::max(near, far) - margin_ > least) continue;
        for (int k = 1; k < parts; ++k) {
            const double x = static_cast<double>(k) / parts, at = length * (j + x) / kStations;
            while (tube + 1 < n && at > q.l[tube] + robot_.tubes[tube].length()) ++tube;
            cubic_weights(x, j == 0, j == kStations - 1, w);
            Vec3 p{0, 0, 0};
            for (int i = 0; i < 3; ++i)
                for (int m = 0; m < 4; ++m) p[i] += w[m] == 0 ? 0 : w[m] * points[std::clamp(j - 1 + m, 0, kStations)][i];
            const double around = near + x * (far - near);
            least = std::min(least, field.sample(p) - robot_.tubes[tube].outer_radius - around - margin_);
        }
    }
    return least;
}

std::vector<PathSample> BoundField::check_path(const std::vector<Configuration>& corners, const SignedDistanceField& field,
                                               const PathDensity& density, const PathLimits& limits) const {
    std::vector<PathSample> samples;
    FieldEntry before, now;
    auto fits = [&](const PathSample& s) {
        return s.status == Status::converged && s.stability >= limits.stability && s.max_strain <= limits.max_strain &&
               s.clearance >= limits.clearance;
    };
    auto moved = [&](const Configuration& a, const Configuration& b) {
        double most = 0;
        const double ca = std::cos(a.theta[0]), sa = std::sin(a.theta[0]), cb = std::cos(b.theta[0]), sb = std::sin(b.theta[0]);
        for (int j = kStations - 1; j >= 0; j -= field.values ? 1 : kEvery) most = std::max(most, apart(turned(before.point[j], ca, sa), turned(now.point[j], cb, sb)));
        return most;
    };
    if (corners.empty()) return samples;
    samples.push_back(measure(corners.front(), field, density.point_spacing, before));
    if (!fits(samples.back())) return samples;
    Configuration last = corners.front();
    for (std::size_t leg = 0; leg + 1 < corners.size(); ++leg) {
        const Configuration &a = corners[leg], &b = corners[leg + 1];
        double longest = 0;
        for (std::size_t i = 0; i < a.theta.size(); ++i)
            longest = std::max({longest, std::fabs(b.theta[i] - a.theta[i]) / density.rotation, std::fabs(b.l[i] - a.l[i]) / density.translation});
        double at = 0, step = 1 / std::max(1.0, std::ceil(longest - 1e-9));
        const double largest = step;
        while (at < 1) {
            const double allowed = density.allowed(samples.back().clearance);
            const double next = at + step > 1 - 1e-9 ? 1 : at + step;
            Configuration q = a;
            for (std::size_t i = 0; i < a.theta.size(); ++i) {
                q.theta[i] += next * (b.theta[i] - a.theta[i]);
                q.l[i] += next * (b.l[i] - a.l[i]);
            }
            if (next >= 1) q = b;
            PathSample sample = measure(q, field, density.point_spacing, now);
            const double motion = sample.status == Status::converged ? moved(last, q) : 0;
            if (motion > allowed && next - at > kShortestStep) {
                step = 0.9 * (next - at) * allowed / motion;
                continue;
            }
            sample.segment = static_cast<int>(leg);
            sample.fraction = next;
            sample.motion = motion;
            samples.push_back(sample);
            if (!fits(sample)) return samples;
            std::swap(before, now);
            last = q;
            if (motion > 0) step = std::min(largest, std::max(step, 0.8 * (next - at) * density.allowed(sample.clearance) / motion));
            at = next;
        }
    }
    return samples;
}

}  // namespace ctr
