// Integration of a tube's centreline and twist-free frame from its bending curvature, equation (2) on SE(3).
#pragma once

#include <array>
#include <cmath>

namespace ctr {

using Vec3 = std::array<double, 3>;

inline Vec3 cross(const Vec3& a, const Vec3& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
inline double dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// Twist-free (Bishop) frame on a curve: columns of R are the two normals and the tangent; world frame.
struct Frame {
    std::array<double, 9> R{1, 0, 0, 0, 1, 0, 0, 0, 1};  // row major
    Vec3 p{0, 0, 0};
    Vec3 tangent() const { return {R[2], R[5], R[8]}; }
    Vec3 column(int k) const { return {R[k], R[3 + k], R[6 + k]}; }
    Vec3 rotate(const Vec3& v) const {
        return {R[0] * v[0] + R[1] * v[1] + R[2] * v[2], R[3] * v[0] + R[4] * v[1] + R[5] * v[2],
                R[6] * v[0] + R[7] * v[1] + R[8] * v[2]};
    }
};

// Fourth-order Magnus step of length h. kappa_1, kappa_2: curvature vector (t' = kappa) in the twist-free frame at the two
// Gauss points of the step, 1/m. The body rotation rate is (-kappa_y, kappa_x, 0).
inline void advance(Frame& frame, const double* kappa_1, const double* kappa_2, double h) {
    const Vec3 a{-kappa_1[1], kappa_1[0], 0}, b{-kappa_2[1], kappa_2[0], 0};
    const double mean = 0.5 * h, bracket = 0.14433756729740643 * h * h;  // sqrt(3) / 12
    const Vec3 rotation{mean * (a[0] + b[0]), mean * (a[1] + b[1]), bracket * (a[0] * b[1] - a[1] * b[0])};
    const Vec3 travel{bracket * (a[1] - b[1]), -bracket * (a[0] - b[0]), h};
    const double square = dot(rotation, rotation);
    double s1, s2, s3;  // sin(x)/x, (1 - cos x)/x^2, (x - sin x)/x^3
    if (square < 0.25) {  // the next terms are below 1e-16
        const double x = square;
        s2 = (1 - x / 12 * (1 - x / 30 * (1 - x / 56 * (1 - x / 90 * (1 - x / 132 * (1 - x / 182)))))) / 2;
        s3 = (1 - x / 20 * (1 - x / 42 * (1 - x / 72 * (1 - x / 110 * (1 - x / 156 * (1 - x / 210)))))) / 6;
        s1 = 1 - x * s3;
    } else {
        const double x = std::sqrt(square);
        s1 = std::sin(x) / x;
        s2 = (1 - std::cos(x)) / square;
        s3 = (1 - s1) / square;
    }
    const Vec3 once = cross(rotation, travel), twice = cross(rotation, once);
    const Vec3 shift{travel[0] + s2 * once[0] + s3 * twice[0], travel[1] + s2 * once[1] + s3 * twice[1],
                     travel[2] + s2 * once[2] + s3 * twice[2]};
    const Vec3 moved = frame.rotate(shift);
    for (int k = 0; k < 3; ++k) frame.p[k] += moved[k];
    const double c = 1 - s2 * square;
    const Vec3& w = rotation;
    const std::array<double, 9> Q{c + s2 * w[0] * w[0],        s2 * w[0] * w[1] - s1 * w[2], s2 * w[0] * w[2] + s1 * w[1],
                                  s2 * w[1] * w[0] + s1 * w[2], c + s2 * w[1] * w[1],        s2 * w[1] * w[2] - s1 * w[0],
                                  s2 * w[2] * w[0] - s1 * w[1], s2 * w[2] * w[1] + s1 * w[0], c + s2 * w[2] * w[2]};
    std::array<double, 9> R;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            R[3 * i + j] = frame.R[3 * i] * Q[j] + frame.R[3 * i + 1] * Q[3 + j] + frame.R[3 * i + 2] * Q[6 + j];
    frame.R = R;
}

}  // namespace ctr
