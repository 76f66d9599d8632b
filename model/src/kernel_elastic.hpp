// Bending and torsion of an element.
// Part of the kernels (kernel_body.hpp): included inside an anonymous namespace, no std::, no Eigen.

// Positions of the unknowns in a node (kernel.hpp).
constexpr int theta_index(int t) { return 5 * t; }
constexpr int offset_index(int p, int plane) { return 1 + 5 * p + plane; }
constexpr int slope_index(int p, int plane) { return 3 + 5 * p + plane; }

// Second derivatives of the Hermite functions at xi, for an element of length h.
inline void hermite_second(double xi, double h, double* b) {
    b[0] = (12 * xi - 6) / (h * h);
    b[1] = (6 * xi - 4) / h;
    b[2] = (6 - 12 * xi) / (h * h);
    b[3] = (6 * xi - 2) / h;
}

constexpr double kGauss[2] = {0.21132486540518711775, 0.78867513459481288225};

// The two nodes of an element: which = 0 proximal, 1 distal.
template <class V>
struct ElementView {
    const V* x[2];
    V* r[2];
    V* block[2][2];  // proximal diagonal, upper, lower, distal diagonal; all with leading dimension ld
    int ld;
};

// Torsion of tube t, and the spring between its actuator and its collar where it begins here.
template <class V, bool MATRIX>
__attribute__((always_inline)) inline void add_torsion(const KernelProblem& pb, int e, int t, const ElementView<V>& el) {
    const double k = pb.torsional_stiffness[t] / pb.length[e];
    const int i = theta_index(t), ld = el.ld;
    const V moment = k * (el.x[1][i] - el.x[0][i]);
    el.r[0][i] -= moment;
    el.r[1][i] += moment;
    if (MATRIX) {
        el.block[0][0][i * ld + i] += k;
        el.block[1][1][i * ld + i] += k;
        el.block[0][1][i * ld + i] -= k;
        el.block[1][0][i * ld + i] -= k;
    }
    if (pb.shaft_node[t] != e || pb.shaft_stiffness[t] == 0) return;
    el.r[0][i] += pb.shaft_stiffness[t] * (el.x[0][i] - pb.shaft_angle[t]);
    if (MATRIX) el.block[0][0][i * ld + i] += pb.shaft_stiffness[t];
}

// Bending and torsion of one element with M tubes: adds the gradient to r and, if MATRIX, the Hessian. Inlined with
// constants for up to four tubes, so that the loops unroll. offsets: M - 1, or M where the outermost present is free.
template <class V, bool MATRIX>
__attribute__((always_inline)) inline void add_elastic(const int M, const int offsets, const KernelProblem& pb, int e,
                                                       const ElementView<V>& el) {
    const int n = pb.tubes;
    const double h = pb.length[e];
    const double* P = pb.stiffness + pb.element_regime[e] * n * n;
    const double* C = pb.pair_stiffness + pb.element_regime[e] * n * n;
    const double* D = pb.mixed_stiffness + pb.element_regime[e] * n * n;
    const int ld = el.ld;
    const V zero = zero_of(V{});

    for (int t = 0; t < M; ++t) add_torsion<V, MATRIX>(pb, e, t, el);
    if (offsets == 0) return;

    if (MATRIX) {
        const double k[4][4] = {{12 / (h * h * h), 6 / (h * h), -12 / (h * h * h), 6 / (h * h)},
                                {6 / (h * h), 4 / h, -6 / (h * h), 2 / h},
                                {-12 / (h * h * h), -6 / (h * h), 12 / (h * h * h), -6 / (h * h)},
                                {6 / (h * h), 2 / h, -6 / (h * h), 4 / h}};
        for (int p = 0; p < offsets; ++p)
            for (int q = 0; q < offsets; ++q)
                for (int a = 0; a < 4; ++a)
                    for (int b = 0; b < 4; ++b) {
                        const double value = C[p * n + q] * k[a][b];
                        for (int plane = 0; plane < 2; ++plane) {
                            const int i = (a & 1) ? slope_index(p, plane) : offset_index(p, plane);
                            const int j = (b & 1) ? slope_index(q, plane) : offset_index(q, plane);
                            el.block[a >> 1][b >> 1][i * ld + j] += value;
                        }
                    }
    }
    for (int gauss = 0; gauss < 2; ++gauss) {
        const double xi = kGauss[gauss], weight = 0.5 * h;
        const double* v = pb.precurvature + (e * 2 + gauss) * n * 2;
        double b[4];
        hermite_second(xi, h, b);
        const double linear[2] = {1 - xi, xi};
        // a_t: bending of tube t against the outermost present; w_t: its rotated precurvature; w_t' = J w_t
        V w[kMaxTubes][2], z[kMaxTubes][2], g[kMaxTubes][2];
        V running[2] = {zero, zero};
        for (int t = M - 1; t >= 0; --t) {
            if (t < offsets)
                for (int plane = 0; plane < 2; ++plane)
                    running[plane] += b[0] * el.x[0][offset_index(t, plane)] + b[1] * el.x[0][slope_index(t, plane)] +
                                      b[2] * el.x[1][offset_index(t, plane)] + b[3] * el.x[1][slope_index(t, plane)];
            const V theta = linear[0] * el.x[0][theta_index(t)] + linear[1] * el.x[1][theta_index(t)];
            V sine = zero, cosine = zero;
            const double vx = v[2 * t], vy = v[2 * t + 1];
            if (vx != 0 || vy != 0) sine_cosine(theta, sine, cosine);
            w[t][0] = cosine * vx - sine * vy;
            w[t][1] = sine * vx + cosine * vy;
            z[t][0] = running[0] - w[t][0];
            z[t][1] = running[1] - w[t][1];
        }
        for (int t = 0; t < M; ++t)
            for (int plane = 0; plane < 2; ++plane) {
                V sum = zero;
                for (int l = 0; l < M; ++l) sum += P[t * n + l] * z[l][plane];
                g[t][plane] = sum;
            }
        V pair_moment[2] = {zero, zero};
        for (int p = 0; p < offsets; ++p)
            for (int plane = 0; plane < 2; ++plane) {
                pair_moment[plane] += g[p][plane];
                const V value = weight * pair_moment[plane];
                el.r[0][offset_index(p, plane)] += b[0] * value;
                el.r[0][slope_index(p, plane)] += b[1] * value;
                el.r[1][offset_index(p, plane)] += b[2] * value;
                el.r[1][slope_index(p, plane)] += b[3] * value;
            }
        for (int t = 0; t < M; ++t) {
            if (v[2 * t] == 0 && v[2 * t + 1] == 0) continue;
            const int i = theta_index(t);
            const V torque = weight * (g[t][0] * w[t][1] - g[t][1] * w[t][0]);  // -g . w'
            el.r[0][i] += linear[0] * torque;
            el.r[1][i] += linear[1] * torque;
            if (!MATRIX) continue;
            for (int l = 0; l < M; ++l) {
                if (v[2 * l] == 0 && v[2 * l + 1] == 0) continue;
                V value = (P[t * n + l] * weight) * (w[t][0] * w[l][0] + w[t][1] * w[l][1]);
                if (l == t) value += weight * (g[t][0] * w[t][0] + g[t][1] * w[t][1]);
                for (int a = 0; a < 2; ++a)
                    for (int c = 0; c < 2; ++c)
                        el.block[a][c][i * ld + theta_index(l)] += (linear[a] * linear[c]) * value;
            }
            for (int p = 0; p < offsets; ++p) {
                const double stiffness = -weight * D[p * n + t];
                const V coupling[2] = {-stiffness * w[t][1], stiffness * w[t][0]};  // w' = (-w_y, w_x)
                for (int plane = 0; plane < 2; ++plane)
                    for (int a = 0; a < 4; ++a)
                        for (int c = 0; c < 2; ++c) {
                            const int j = (a & 1) ? slope_index(p, plane) : offset_index(p, plane);
                            const V value = (b[a] * linear[c]) * coupling[plane];
                            el.block[a >> 1][c][j * ld + i] += value;
                            el.block[c][a >> 1][i * ld + j] += value;
                        }
            }
        }
    }
}
