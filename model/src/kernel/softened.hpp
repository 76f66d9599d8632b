// Bending of an element whose tubes soften, are oval, or carry loads: what elastic.hpp does for linear round tubes.
// Part of the kernels (kernel/body.hpp): included inside an anonymous namespace, no std::, no Eigen.

// Local second derivatives at a point, by the curvatures against the outermost tube (a_t) and by the angles.
template <class V>
struct PointTangent {
    V aa[kMaxTubes][kMaxTubes][2][2];
    V at[kMaxTubes][kMaxTubes][2];  // by a of the first, theta of the second
    V tt[kMaxTubes][kMaxTubes];
};

// What eliminating the mean leaves: H_tl = delta_tl H_t - B_t S^-1 B_l^T, with B the derivatives of the sum of moments.
template <class V>
inline void point_tangent(int M, bool free, const BentSection<V>* section, const V (*kappa)[2], const V* inverse, PointTangent<V>& H) {
    const V zero = zero_of(V{});
    for (int t = 0; t < M; ++t) {
        const V* K = section[t].tangent;
        const V* c = section[t].by_angle;
        const V Kt[2][2] = {{K[0], K[1]}, {K[1], K[2]}};
        // S^-1 times the rows of B_t
        V SK[2][2], Sc[2];
        for (int i = 0; i < 2; ++i) {
            const V a = free ? (i ? inverse[1] : inverse[0]) : zero, b = free ? (i ? inverse[2] : inverse[1]) : zero;
            for (int j = 0; j < 2; ++j) SK[i][j] = a * Kt[0][j] + b * Kt[1][j];
            Sc[i] = a * c[0] + b * c[1];
        }
        for (int l = 0; l < M; ++l) {
            const V* L = section[l].tangent;
            const V Kl[2][2] = {{L[0], L[1]}, {L[1], L[2]}};
            const V* d = section[l].by_angle;
            for (int i = 0; i < 2; ++i) {
                for (int j = 0; j < 2; ++j) H.aa[l][t][i][j] = -(Kl[i][0] * SK[0][j] + Kl[i][1] * SK[1][j]);
                H.at[l][t][i] = -(Kl[i][0] * Sc[0] + Kl[i][1] * Sc[1]);
            }
            H.tt[l][t] = -(d[0] * Sc[0] + d[1] * Sc[1]);
        }
        for (int i = 0; i < 2; ++i) {
            for (int j = 0; j < 2; ++j) H.aa[t][t][i][j] += Kt[i][j];
            H.at[t][t][i] += c[i];
        }
        H.tt[t][t] += c[0] * kappa[t][1] - c[1] * kappa[t][0];  // -by_angle . J kappa
    }
}

template <class V, bool MATRIX>
inline void add_bending_point(const KernelProblem& pb, const KernelState& st, int e, int gauss, const ElementView<V>& el) {
    const int n = pb.tubes, M = pb.element_tubes[e], ld = el.ld;
    const bool free_base = pb.element_unknowns[e] == 5 * M;
    const int offsets = free_base ? M : M - 1;
    const bool free = pb.element_regime[e] % 2 == 0;
    const double h = pb.length[e], xi = kGauss[gauss], weight = 0.5 * h, linear[2] = {1 - xi, xi};
    const double* v = pb.precurvature + (e * 2 + gauss) * n * 2;
    const BendingLaw* law = pb.law + pb.element_regime[e] / 2 * n;
    const V zero = zero_of(V{});
    double b[4];
    hermite_second(xi, h, b);
    V against[kMaxTubes][2], kappa[kMaxTubes][2], running[2] = {zero, zero}, inverse[3] = {zero, zero, zero};
    BentSection<V> section[kMaxTubes];
    for (int t = M - 1; t >= 0; --t) {
        for (int plane = 0; plane < 2; ++plane) {
            if (t < offsets)
                running[plane] += b[0] * el.x[0][offset_index(t, plane)] + b[1] * el.x[0][slope_index(t, plane)] +
                                  b[2] * el.x[1][offset_index(t, plane)] + b[3] * el.x[1][slope_index(t, plane)];
            against[t][plane] = running[plane];
        }
        turn_section<V>(law[t], v + 2 * t, linear[0] * el.x[0][theta_index(t)] + linear[1] * el.x[1][theta_index(t)], section[t]);
    }
    V mean[2] = {zero, zero};
    const V* share = reinterpret_cast<const V*>(st.load_moment) + (e * 2 + gauss) * 2 * n;  // of the loads, per tube
    if (free) {
        V load[2] = {zero, zero};
        for (int t = 0; t < M; ++t)
            for (int plane = 0; plane < 2; ++plane) load[plane] += share[2 * t + plane];
        free_mean<V>(M, law, against, load, section, mean, inverse);
    } else {
        for (int t = 0; t < M; ++t) bend(law[t], against[t], section[t]);
    }
    for (int t = 0; t < M; ++t)
        for (int plane = 0; plane < 2; ++plane) kappa[t][plane] = mean[plane] + against[t][plane];

    V pair_moment[2] = {zero, zero};
    for (int t = 0; t < M; ++t) {
        const V torque = weight * (section[t].moment[0] * kappa[t][1] - section[t].moment[1] * kappa[t][0]);  // -moment . J kappa
        for (int a = 0; a < 2; ++a) el.r[a][theta_index(t)] += linear[a] * torque;
        for (int plane = 0; plane < 2; ++plane) {
            pair_moment[plane] += section[t].moment[plane] - share[2 * t + plane];
            if (t >= offsets) continue;
            for (int a = 0; a < 4; ++a)
                el.r[a >> 1][(a & 1) ? slope_index(t, plane) : offset_index(t, plane)] += (weight * b[a]) * pair_moment[plane];
        }
    }
    if (!MATRIX) return;

    PointTangent<V> H;
    point_tangent<V>(M, free, section, kappa, inverse, H);
    for (int t = 0; t < M; ++t)
        for (int l = 0; l < M; ++l)
            for (int a = 0; a < 2; ++a)
                for (int c = 0; c < 2; ++c)
                    el.block[a][c][theta_index(t) * ld + theta_index(l)] += (weight * linear[a] * linear[c]) * H.tt[t][l];
    for (int p = 0; p < offsets; ++p) {
        for (int t = 0; t < M; ++t)
            for (int i = 0; i < 2; ++i) {
                V sum = zero;
                for (int l = 0; l <= p; ++l) sum += H.at[l][t][i];
                for (int a = 0; a < 4; ++a)
                    for (int c = 0; c < 2; ++c) {
                        const int row = (a & 1) ? slope_index(p, i) : offset_index(p, i), column = theta_index(t);
                        const V value = (weight * b[a] * linear[c]) * sum;
                        el.block[a >> 1][c][row * ld + column] += value;
                        el.block[c][a >> 1][column * ld + row] += value;
                    }
            }
        for (int q = 0; q < offsets; ++q)
            for (int i = 0; i < 2; ++i)
                for (int j = 0; j < 2; ++j) {
                    V sum = zero;
                    for (int t = 0; t <= p; ++t)
                        for (int l = 0; l <= q; ++l) sum += H.aa[t][l][i][j];
                    for (int a = 0; a < 4; ++a)
                        for (int c = 0; c < 4; ++c) {
                            const int row = (a & 1) ? slope_index(p, i) : offset_index(p, i);
                            const int column = (c & 1) ? slope_index(q, j) : offset_index(q, j);
                            el.block[a >> 1][c >> 1][row * ld + column] += (weight * b[a] * b[c]) * sum;
                        }
                }
    }
}

// Gradient and, if MATRIX, Hessian of bending and torsion of an element.
template <class V, bool MATRIX>
void add_softened(const KernelProblem& pb, const KernelState& st, int e, const ElementView<V>& el) {
    for (int t = 0; t < pb.element_tubes[e]; ++t) add_torsion<V, MATRIX>(pb, e, t, el);
    for (int gauss = 0; gauss < 2; ++gauss) add_bending_point<V, MATRIX>(pb, st, e, gauss, el);
}
