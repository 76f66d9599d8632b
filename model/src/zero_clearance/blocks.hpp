// One element and one node of the zero-clearance system, for sizes known when compiled: included by newton_system.cpp
// inside an anonymous namespace. Unknowns of a node are [theta_t, theta_t'], innermost tube first.

#include "zero_clearance/angles.hpp"

constexpr double kWeight[kGaussPoints] = {5.0 / 18, 8.0 / 18, 5.0 / 18};

// Cubic Hermite functions at the Gauss points, of [theta_0, h theta_0', theta_1, h theta_1'], and their weighted products.
struct HermiteTable {
    double value[kGaussPoints][4], product[4][4][kGaussPoints];
    constexpr HermiteTable() : value(), product() {
        for (int g = 0; g < kGaussPoints; ++g) {
            const double x = kPoint[g], x2 = x * x, x3 = x2 * x;
            value[g][0] = 1 - 3 * x2 + 2 * x3;
            value[g][1] = x - 2 * x2 + x3;
            value[g][2] = 3 * x2 - 2 * x3;
            value[g][3] = x3 - x2;
            for (int a = 0; a < 4; ++a)
                for (int b = 0; b < 4; ++b) product[a][b][g] = kWeight[g] * value[g][a] * value[g][b];
        }
    }
};
constexpr HermiteTable kHermite;

// Integrals of products of their first derivatives, times h.
constexpr double kTwist[4][4] = {{1.2, 0.1, -1.2, 0.1}, {0.1, 2.0 / 15, -0.1, -1.0 / 30}, {-1.2, -0.1, 1.2, -0.1}, {0.1, -1.0 / 30, -0.1, 2.0 / 15}};

struct ElementData {
    double h;
    const double *P, *gj;     // [tube][tube] N m^2, [tube] N m^2
    const double* v;          // [Gauss point][tube][2] rotated precurvature at angle 0, 1/m
    const double *xa, *xb;    // unknowns of its nodes
    double *ra, *rb;          // gradient
    double *A, *U, *B;        // blocks: proximal diagonal, coupling, distal diagonal; of the diagonals the lower triangle
    int n, ld;
};

// Adds sum_g c[t][l][g] N_a N_b h to the blocks, and the twist of every tube.
__attribute__((always_inline)) inline void add_stiffness(const int m, const ElementData& e, const double (*c)[kMaxTubes][kGaussPoints]) {
    const double h = e.h, unit[4] = {1, h, 1, h};
    for (int t = 0; t < m; ++t)
        for (int l = 0; l <= t; ++l) {
            double K[4][4];
            for (int a = 0; a < 4; ++a)
                for (int b = 0; b <= a; ++b) {
                    double sum = 0;
                    for (int g = 0; g < kGaussPoints; ++g) sum += c[t][l][g] * kHermite.product[a][b][g];
                    sum *= h;
                    if (t == l) sum += e.gj[t] / h * kTwist[a][b];
                    K[a][b] = K[b][a] = sum * unit[a] * unit[b];
                }
            for (int a = 0; a < 2; ++a)
                for (int b = 0; b < 2; ++b) {
                    const int row = (2 * t + a) * e.ld + 2 * l + b;
                    e.A[row] += K[a][b];
                    e.B[row] += K[2 + a][2 + b];
                    e.U[row] += K[a][2 + b];
                    if (t != l) e.U[(2 * l + a) * e.ld + 2 * t + b] += K[a][2 + b];
                }
        }
}

// Gradient of the energy at the element's angles and, if matrix, its second derivative; scale multiplies the bending.
__attribute__((always_inline)) inline void add_element(const int m, const ElementData& e, double scale, bool matrix) {
    const double h = e.h;
    double angle[kGaussPoints * kMaxTubes + 1], sine[kGaussPoints * kMaxTubes + 1], cosine[kGaussPoints * kMaxTubes + 1];
    double x[kMaxTubes][4], r[kMaxTubes][4], c[kMaxTubes][kMaxTubes][kGaussPoints];
    for (int t = 0; t < m; ++t) {
        x[t][0] = e.xa[2 * t];
        x[t][1] = h * e.xa[2 * t + 1];
        x[t][2] = e.xb[2 * t];
        x[t][3] = h * e.xb[2 * t + 1];
        for (int a = 0; a < 4; ++a) {
            double sum = 0;
            for (int b = 0; b < 4; ++b) sum += kTwist[a][b] * x[t][b];
            r[t][a] = e.gj[t] / h * sum;
        }
        for (int g = 0; g < kGaussPoints; ++g) {
            double sum = 0;
            for (int a = 0; a < 4; ++a) sum += kHermite.value[g][a] * x[t][a];
            angle[g * m + t] = sum;
        }
    }
    angle[kGaussPoints * m] = 0;
    sines_cosines(angle, sine, cosine, kGaussPoints * m);
    for (int g = 0; g < kGaussPoints; ++g) {
        double w[kMaxTubes][2], force[kMaxTubes][2];
        const double* v = e.v + g * e.n * 2;
        for (int t = 0; t < m; ++t) {
            const double s = sine[g * m + t], k = cosine[g * m + t];
            w[t][0] = k * v[2 * t] - s * v[2 * t + 1];
            w[t][1] = s * v[2 * t] + k * v[2 * t + 1];
        }
        for (int t = 0; t < m; ++t) {
            force[t][0] = force[t][1] = 0;
            for (int l = 0; l < m; ++l)
                if (l != t)  // its own part does not turn it
                    for (int plane = 0; plane < 2; ++plane) force[t][plane] += e.P[t * e.n + l] * w[l][plane];
            // dE/dtheta_t = force . J w
            const double torque = kWeight[g] * h * scale * (force[t][1] * w[t][0] - force[t][0] * w[t][1]);
            for (int a = 0; a < 4; ++a) r[t][a] += kHermite.value[g][a] * torque;
            if (!matrix) continue;
            for (int l = 0; l < t; ++l) c[t][l][g] = scale * e.P[t * e.n + l] * (w[t][0] * w[l][0] + w[t][1] * w[l][1]);
            c[t][t][g] = -scale * (force[t][0] * w[t][0] + force[t][1] * w[t][1]);
        }
    }
    for (int t = 0; t < m; ++t) {
        e.ra[2 * t] += r[t][0];
        e.ra[2 * t + 1] += h * r[t][1];
        e.rb[2 * t] += r[t][2];
        e.rb[2 * t + 1] += h * r[t][3];
    }
    if (matrix) add_stiffness(m, e, c);
}

// A lower bound of the second derivative over all angles: every pair as strongly opposed as its precurvatures can be.
__attribute__((always_inline)) inline void add_least(const int m, const ElementData& e, double factor) {
    double c[kMaxTubes][kMaxTubes][kGaussPoints];
    for (int g = 0; g < kGaussPoints; ++g) {
        const double* v = e.v + g * e.n * 2;
        double size[kMaxTubes];
        for (int t = 0; t < m; ++t) size[t] = __builtin_sqrt(v[2 * t] * v[2 * t] + v[2 * t + 1] * v[2 * t + 1]);
        for (int t = 0; t < m; ++t) {
            c[t][t][g] = 0;
            for (int l = 0; l < t; ++l) {
                c[t][l][g] = -factor * e.P[t * e.n + l] * size[t] * size[l];  // P is negative off its diagonal
                c[t][t][g] -= c[t][l][g];
                c[l][l][g] -= c[t][l][g];
            }
        }
    }
    add_stiffness(m, e, c);
}

// Eliminates a node of p unknowns from a symmetric system, A = L D L^T without pivoting: A keeps L and 1 / D, U becomes
// L^-1 U (p x q), r becomes L^-1 r; the next node's block and gradient are brought up to date. Returns the negative pivots.
__attribute__((always_inline)) inline int eliminate(const int p, const int q, double* A, double* U, double* r, double* next, double* next_r, const int ld) {
    int negative = 0;
    for (int j = 0; j < p; ++j) {
        negative += A[j * ld + j] < 0;
        const double pivot = 1 / A[j * ld + j];
        double column[2 * kMaxTubes];
        for (int i = j + 1; i < p; ++i) column[i] = A[i * ld + j];
        A[j * ld + j] = pivot;
        for (int i = j + 1; i < p; ++i) {
            const double f = column[i] * pivot;
            for (int c = j + 1; c <= i; ++c) A[i * ld + c] -= f * column[c];
            A[i * ld + j] = f;
            for (int c = 0; c < q; ++c) U[i * ld + c] -= f * U[j * ld + c];
            r[i] -= f * r[j];
        }
    }
    for (int j = 0; j < p; ++j)
        for (int i = 0; i < q; ++i) {
            const double f = U[j * ld + i] * A[j * ld + j];
            for (int c = 0; c <= i; ++c) next[i * ld + c] -= f * U[j * ld + c];
            next_r[i] -= f * r[j];
        }
    return negative;
}

// step = -(solution of A step = r - U next_step), A and r as eliminate() left them.
__attribute__((always_inline)) inline void substitute(const int p, const int q, const double* A, const double* U, const double* r, const double* next_step,
                       double* step, const int ld) {
    for (int i = 0; i < p; ++i) {
        double sum = -r[i];
        for (int c = 0; c < q; ++c) sum -= U[i * ld + c] * next_step[c];
        step[i] = sum * A[i * ld + i];
    }
    for (int i = p - 1; i > 0; --i)
        for (int j = 0; j < i; ++j) step[j] -= A[i * ld + j] * step[i];
}
