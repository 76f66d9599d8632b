// The shape of a zero-clearance solution.
#include <algorithm>
#include <cmath>
#include <vector>

#include "ctr/kernel.hpp"
#include "ctr/shape.hpp"

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"
#include "shape/stations.hpp"

constexpr double kOutputStep = 2e-3;  // m, zero-clearance shapes

// Curvature of the common centreline between stations, 0 behind the plate, and every tube's rotated precurvature.
struct CommonCurve {
    const Robot& robot;
    const ZeroClearance& solution;
    const Configuration& q;

    bool holds(int tube, double s) const { return s >= q.l[tube] && s <= q.l[tube] + robot.tubes[tube].length(); }

    void curvature(double s, double middle, double* kappa, double (*rotated)[2]) const {
        const int n = robot.count();
        double total = 0;
        kappa[0] = kappa[1] = 0;
        for (int i = 0; i < n; ++i) {
            if (!holds(i, middle)) continue;
            double v[2];
            precurvature_at(robot.tubes[i], s - q.l[i], middle - q.l[i], v);
            const double theta = solution.theta(n - 1 - i, s), c = std::cos(theta), k = std::sin(theta), EI = robot.tubes[i].bending_stiffness;
            rotated[i][0] = c * v[0] - k * v[1];
            rotated[i][1] = k * v[0] + c * v[1];
            total += EI;
            for (int plane = 0; plane < 2; ++plane) kappa[plane] += EI * rotated[i][plane];
        }
        for (int plane = 0; plane < 2; ++plane) kappa[plane] = middle > 0 && total > 0 ? kappa[plane] / total : 0.0;
    }
};

// Follows the centreline between the ends of sections: visit(first of a span, from, length of the step, middle of the span, frames
// at both ends). Returns the last frame.
template <class Visit>
Frame follow(const CommonCurve& curve, const Visit& visit) {
    const int n = curve.robot.count();
    std::vector<double> stations;
    for (int i = 0; i < n; ++i) {
        double s = curve.q.l[i];
        stations.push_back(s);
        for (const Section& section : curve.robot.tubes[i].sections) stations.push_back(s += section.length);
    }
    stations.push_back(0);
    std::sort(stations.begin(), stations.end());
    Frame frame;
    frame.p = {0, 0, curve.q.l[n - 1]};
    double first[2], second[2], rotated[kMaxTubes][2];
    for (std::size_t b = 0; b + 1 < stations.size(); ++b) {
        const double from = stations[b], span = stations[b + 1] - from, middle = from + 0.5 * span;
        if (span < 1e-9) continue;
        const int count = std::max(1, static_cast<int>(std::ceil(span / kOutputStep)));
        const double h = span / count;
        for (int k = 0; k < count; ++k) {
            const double s = from + k * h;
            curve.curvature(s + kGauss[0] * h, middle, first, rotated);
            curve.curvature(s + kGauss[1] * h, middle, second, rotated);
            const Frame start = frame;
            ctr::advance(frame, first, second, h);
            visit(k == 0, s, h, middle, start, frame);
        }
    }
    return frame;
}

}  // namespace

Frame end_of(const Robot& robot, const ZeroClearance& solution, const Configuration& q) {
    return follow({robot, solution, q}, [](bool, double, double, double, const Frame&, const Frame&) {});
}

Shape make_shape(const Robot& robot, const ZeroClearance& solution, const Configuration& q) {
    const int n = robot.count();
    const CommonCurve curve{robot, solution, q};
    Shape shape;
    shape.tubes.resize(n);
    shape.contacts.resize(n - 1);
    double kappa[2], rotated[kMaxTubes][2];
    shape.end_at(follow(curve, [&](bool is_first, double s, double h, double middle, const Frame& start, const Frame& end) {
        for (int side = is_first ? 0 : 1; side < 2; ++side) {  // elsewhere the step before ended there
            curve.curvature(s + side * h, middle, kappa, rotated);
            for (int i = 0; i < n; ++i) {
                if (!curve.holds(i, middle)) continue;
                TubeShape& tube = shape.tubes[i];
                if (side == 0 && !tube.s.empty()) continue;
                append(tube, s + side * h, side ? end : start, solution.theta(n - 1 - i, s + side * h),
                       solution.twist_rate(n - 1 - i, s + side * h), kappa, rotated[i], robot.tubes[i].outer_radius);
            }
        }
    }));
    for (const TubeShape& tube : shape.tubes)
        for (double strain : tube.strain) shape.max_strain = std::max(shape.max_strain, strain);
    for (double at : shape.tubes[n - 1].s) shape.radius.push_back(outermost_radius(robot, q, at));
    shape.residual = solution.residual();
    return shape;
}

}  // namespace ctr
