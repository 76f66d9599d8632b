// What a zero-clearance solution says: angles along the tubes, the tip, clearances along the centreline.
#include <algorithm>
#include <cmath>

#include "ctr/kernel.hpp"
#include "ctr/zero_clearance.hpp"

namespace ctr {
namespace {

constexpr double kTipStep = 8e-3;  // m, of the integration of the centreline

#include "zero_clearance/angles.hpp"

}  // namespace

int ZeroClearance::locate(double s) const {
    const auto it = std::upper_bound(s_.begin(), s_.end(), s);
    return std::clamp(static_cast<int>(it - s_.begin()) - 1, 0, nodes_ - 2);
}

double ZeroClearance::theta(int t, double s) const {
    if (s <= 0) {
        if (is_clamped(t)) return base_theta_[t];
        const double torque = transmission_stiffness(t) * (x_[2 * t] - base_theta_[t]);
        return base_theta_[t] + torque * (shaft_[t] + std::clamp(s - base_l_[t], 0.0, -base_l_[t]) / gj_[t]);
    }
    if (nodes_ < 2) return x_[2 * t];
    const double last = std::min(s, std::min(end_s_[t], s_.back()));
    const int e = locate(std::nextafter(last, -1.0));
    const double h = s_[e + 1] - s_[e], x = std::clamp((last - s_[e]) / h, 0.0, 1.0);
    const double *a = &x_[e * ld_ + 2 * t], *b = &x_[(e + 1) * ld_ + 2 * t];
    return (1 - 3 * x * x + 2 * x * x * x) * a[0] + h * (x - 2 * x * x + x * x * x) * a[1] +
           (3 * x * x - 2 * x * x * x) * b[0] + h * (x * x * x - x * x) * b[1];
}

double ZeroClearance::twist_rate(int t, double s) const {
    if (s <= 0) return is_clamped(t) ? 0.0 : transmission_stiffness(t) * (x_[2 * t] - base_theta_[t]) / gj_[t];
    if (nodes_ < 2 || s >= std::min(end_s_[t], s_.back())) return 0.0;
    const int e = locate(s);
    const double h = s_[e + 1] - s_[e], x = (s - s_[e]) / h;
    const double *a = &x_[e * ld_ + 2 * t], *b = &x_[(e + 1) * ld_ + 2 * t];
    return 6 * (x * x - x) / h * a[0] + (1 - 4 * x + 3 * x * x) * a[1] + 6 * (x - x * x) / h * b[0] +
           (3 * x * x - 2 * x) * b[1];
}

Frame ZeroClearance::tip() const {
    return trace(kTipStep, true, [](const Vec3&, int) {});
}

double ZeroClearance::clearance(const Robot& robot, const SignedDistanceField& field, double spacing, Frame& tip) const {
    double least = 1e9;
    tip = trace(spacing, false, [&](const Vec3& p, int tubes) {
        least = std::min(least, field.sample(p) - robot.tubes[n_ - tubes].outer_radius);
    });
    return least;
}

// Integrates the centreline by steps no longer than `longest`, arcs of the innermost tube alone at once if they are `whole`;
// visit(point, tubes present there) is called after every step. Returns the last frame.
template <class Visit>
Frame ZeroClearance::trace(double longest, bool whole, const Visit& visit) const {
    Frame frame;
    double angle[2 * kMaxTubes + 1] = {}, sine[2 * kMaxTubes + 1], cosine[2 * kMaxTubes + 1], kappa[2][2];
    constexpr double kHalf = 0.28867513459481288225;  // half the distance of two Gauss points
    for (int e = 0; e + 1 < nodes_; ++e) {
        const int m = tubes_[e], count = static_cast<int>(std::ceil((s_[e + 1] - s_[e]) / longest));
        const double h = s_[e + 1] - s_[e], *a = &x_[e * ld_], *b = a + ld_;
        const double* EI = &ei_row_[static_cast<std::size_t>(row_[e]) * n_];
        double total = 0;
        for (int t = 0; t < m; ++t) total += EI[t];
        for (int k = 0; k < count; ++k) {
            for (int g = 0; g < 2; ++g) {
                const double x = (k + 0.5 + (g ? kHalf : -kHalf)) / count, x2 = x * x, x3 = x2 * x;
                for (int t = 0; t < m; ++t)
                    angle[g * m + t] = (1 - 3 * x2 + 2 * x3) * a[2 * t] + h * (x - 2 * x2 + x3) * a[2 * t + 1] +
                                       (3 * x2 - 2 * x3) * b[2 * t] + h * (x3 - x2) * b[2 * t + 1];
            }
            sines_cosines(angle, sine, cosine, 2 * m);
            for (int g = 0; g < 2; ++g) {
                kappa[g][0] = kappa[g][1] = 0;
                // linear along the element
                const double *first = &v_[e * kGaussPoints * n_ * 2], *last = first + (kGaussPoints - 1) * n_ * 2;
                const double part = ((k + 0.5 + (g ? kHalf : -kHalf)) / count - kPoint[0]) / (kPoint[kGaussPoints - 1] - kPoint[0]);
                double v[2 * kMaxTubes];
                for (int i = 0; i < 2 * m; ++i) v[i] = first[i] + part * (last[i] - first[i]);
                for (int t = 0; t < m; ++t) {
                    const double s = EI[t] / total * sine[g * m + t], c = EI[t] / total * cosine[g * m + t];
                    kappa[g][0] += c * v[2 * t] - s * v[2 * t + 1];
                    kappa[g][1] += s * v[2 * t] + c * v[2 * t + 1];
                }
            }
            advance(frame, kappa[0], kappa[1], h / count);
            visit(frame.p, m);
        }
    }
    // beyond, the innermost tube alone: arcs
    double s = s_.back();
    const double c = std::cos(x_[(nodes_ - 1) * ld_]), n = std::sin(x_[(nodes_ - 1) * ld_]);
    for (std::size_t k = 0; k < tip_s_.size(); ++k) {
        const double* v = &tip_v_[4 * k];
        const bool arc = v[0] == v[2] && v[1] == v[3];
        const int count = arc && whole ? 1 : static_cast<int>(std::ceil((tip_s_[k] - s) / longest));
        for (int step = 0; step < count; ++step) {
            double kappa[2][2];
            for (int g = 0; g < 2; ++g) {
                const double x = (step + 0.5 + (g ? kHalf : -kHalf)) / count, vx = v[0] + x * (v[2] - v[0]), vy = v[1] + x * (v[3] - v[1]);
                kappa[g][0] = c * vx - n * vy;
                kappa[g][1] = n * vx + c * vy;
            }
            advance(frame, kappa[0], kappa[1], (tip_s_[k] - s) / count);
            visit(frame.p, 1);
        }
        s = tip_s_[k];
    }
    return frame;
}

}  // namespace ctr
