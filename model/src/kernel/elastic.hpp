// Bending and torsion of an element.
// Part of the kernels (kernel/body.hpp): included inside an anonymous namespace, no std::, no Eigen.

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

// What belongs to the two offsets and two slopes of a pair at a node, which are neighbours among the unknowns: four values
// of several states, or one register of a single state. Factor: a number for the offsets and one for the slopes.
template <class V>
struct Quad {
    struct Factor {
        double offset, slope;
    };
    V value[4];
    static Factor factor(double offset, double slope) { return {offset, slope}; }
    static Quad of(const V (&plane)[2]) { return {{plane[0], plane[1], plane[0], plane[1]}}; }
    static Quad sum(const Factor (&f)[2], const Quad (&q)[2]) {
        Quad s;
        CTR_UNROLL
        for (int i = 0; i < 4; ++i)
            s.value[i] = (i < 2 ? f[0].offset : f[0].slope) * q[0].value[i] + (i < 2 ? f[1].offset : f[1].slope) * q[1].value[i];
        return s;
    }
    void add_to_row(V* row) const {
        CTR_UNROLL
        for (int i = 0; i < 4; ++i) row[i] += value[i];
    }
    void add_to_column(V* column, int ld) const {
        CTR_UNROLL
        for (int i = 0; i < 4; ++i) column[i * ld] += value[i];
    }
    // The diagonals that one Hermite function has with the offsets and with the slopes of both planes.
    static void add_planes(V* rows, int ld, const Factor& f, double stiffness) {
        CTR_UNROLL
        for (int plane = 0; plane < 2; ++plane) {
            rows[plane * ld + plane] += stiffness * f.offset;
            rows[plane * ld + plane + 2] += stiffness * f.slope;
        }
    }
};

template <>
struct Quad<double> {
    typedef V4 Factor;
    V4 value;
    static Factor factor(double offset, double slope) { return Factor{offset, offset, slope, slope}; }
    static Quad of(const double (&plane)[2]) { return {V4{plane[0], plane[1], plane[0], plane[1]}}; }
    static Quad sum(const Factor (&f)[2], const Quad (&q)[2]) { return {f[0] * q[0].value + f[1] * q[1].value}; }
    static void add(double* row, V4 more) {
        V4 kept;
        __builtin_memcpy(&kept, row, sizeof kept);
        kept += more;
        __builtin_memcpy(row, &kept, sizeof kept);
    }
    void add_to_row(double* row) const { add(row, value); }
    void add_to_column(double* column, int ld) const {
        for (int i = 0; i < 4; ++i) column[i * ld] += value[i];
    }
    static void add_planes(double* rows, int ld, const Factor& f, double stiffness) {
        const V4 all = stiffness * f;
        add(rows, all * V4{1, 0, 1, 0});
        add(rows + ld, all * V4{0, 1, 0, 1});
    }
};

// Sines and cosines of angles; those of a single state four at a time, up to the next multiple of four.
template <class V>
inline void sines_cosines(int count, const V* angle, V* sine, V* cosine) {
    for (int i = 0; i < count; ++i) sine_cosine(angle[i], sine[i], cosine[i]);
}
inline void sines_cosines(int count, const double* angle, double* sine, double* cosine) {
    for (int i = 0; i < count; i += 4) {
        V4 x, s, c;
        __builtin_memcpy(&x, angle + i, sizeof x);
        sine_cosine(x, s, c);
        __builtin_memcpy(sine + i, &s, sizeof s);
        __builtin_memcpy(cosine + i, &c, sizeof c);
    }
}

// A tube's precurvature turned by its angle, at both Gauss points; straight tubes have none.
template <class V>
struct Turned {
    V w[2][kMaxTubes][2];
    bool curved[kMaxTubes];
};

template <class V>
__attribute__((always_inline)) inline void turn_precurvature(const int M, const KernelProblem& pb, int e, const ElementView<V>& el,
                                                             Turned<V>& out) {
    const int n = pb.tubes;
    constexpr int room = 2 * kMaxTubes + 3;
    V angle[room], sine[room], cosine[room];
    int which[kMaxTubes], count = 0;
    const double* v = pb.precurvature + e * 4 * n;
    for (int t = 0; t < M; ++t) {
        out.curved[t] = v[2 * t] != 0 || v[2 * t + 1] != 0 || v[2 * (n + t)] != 0 || v[2 * (n + t) + 1] != 0;
        if (out.curved[t]) {
            which[count] = t;
            const V from = el.x[0][theta_index(t)], by = el.x[1][theta_index(t)] - from;
            for (int g = 0; g < 2; ++g) angle[2 * count + g] = from + kGauss[g] * by;
            ++count;
        } else {
            for (int g = 0; g < 2; ++g) out.w[g][t][0] = out.w[g][t][1] = zero_of(V{});
        }
    }
    for (int i = 2 * count; i % 4; ++i) angle[i] = zero_of(V{});
    sines_cosines(2 * count, angle, sine, cosine);
    for (int i = 0; i < count; ++i)
        for (int g = 0; g < 2; ++g) {
            const int t = which[i], k = 2 * i + g;
            const double vx = v[2 * (g * n + t)], vy = v[2 * (g * n + t) + 1];
            out.w[g][t][0] = cosine[k] * vx - sine[k] * vy;
            out.w[g][t][1] = sine[k] * vx + cosine[k] * vy;
        }
}

// Bending and torsion of one element with M tubes: adds the gradient to r and, if MATRIX, the Hessian. Inlined with
// constants for up to four tubes, so that the loops unroll. offsets: M - 1, or M where the outermost present is free.
template <class V, bool MATRIX>
__attribute__((always_inline)) inline void add_elastic(const int M, const int offsets, const KernelProblem& pb, int e,
                                                       const ElementView<V>& el) {
    typedef Quad<V> Q;
    const int n = pb.tubes;
    const double h = pb.length[e], weight = 0.5 * h;
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
        CTR_UNROLL
        for (int a = 0; a < 4; ++a)
            CTR_UNROLL
            for (int node = 0; node < 2; ++node) {
                const typename Q::Factor row = Q::factor(k[a][2 * node], k[a][2 * node + 1]);
                for (int p = 0; p < offsets; ++p)
                    for (int q = 0; q < offsets; ++q)
                        Q::add_planes(el.block[a >> 1][node] + ((a & 1) ? slope_index(p, 0) : offset_index(p, 0)) * ld + offset_index(q, 0),
                                      ld, row, C[p * n + q]);
            }
    }

    Turned<V> turned;
    turn_precurvature<V>(M, pb, e, el, turned);
    double b[2][4];
    typename Q::Factor bend[2][2];     // [node][Gauss point], of the gradient
    typename Q::Factor both[2][2][2];  // [node][linear function][Gauss point], of the coupling
    for (int g = 0; g < 2; ++g) {
        hermite_second(kGauss[g], h, b[g]);
        CTR_UNROLL
        for (int node = 0; node < 2; ++node) {
            bend[node][g] = Q::factor(weight * b[g][2 * node], weight * b[g][2 * node + 1]);
            for (int c = 0; c < 2; ++c)
                both[node][c][g] = Q::factor(weight * linear(c, g) * b[g][2 * node], weight * linear(c, g) * b[g][2 * node + 1]);
        }
    }
    V moment[2][kMaxTubes][2];  // of each tube with the mean eliminated
    V torque[2][kMaxTubes];     // -moment . w', w' = J w
    for (int g = 0; g < 2; ++g) {
        V against[kMaxTubes][2];  // bending against the outermost present less the turned precurvature
        V running[2] = {zero, zero};
        for (int t = M - 1; t >= 0; --t)
            CTR_UNROLL
            for (int plane = 0; plane < 2; ++plane) {
                if (t < offsets)
                    running[plane] += b[g][0] * el.x[0][offset_index(t, plane)] + b[g][1] * el.x[0][slope_index(t, plane)] +
                                      b[g][2] * el.x[1][offset_index(t, plane)] + b[g][3] * el.x[1][slope_index(t, plane)];
                against[t][plane] = running[plane] - turned.w[g][t][plane];
            }
        for (int t = 0; t < M; ++t) {
            CTR_UNROLL
            for (int plane = 0; plane < 2; ++plane) {
                V sum = zero;
                for (int l = 0; l < M; ++l) sum += P[t * n + l] * against[l][plane];
                moment[g][t][plane] = sum;
            }
            torque[g][t] = weight * (moment[g][t][0] * turned.w[g][t][1] - moment[g][t][1] * turned.w[g][t][0]);
        }
    }
    V pair_moment[2][2] = {{zero, zero}, {zero, zero}};
    for (int p = 0; p < offsets; ++p) {
        for (int g = 0; g < 2; ++g)
            CTR_UNROLL
            for (int plane = 0; plane < 2; ++plane) pair_moment[g][plane] += moment[g][p][plane];
        const Q pair[2] = {Q::of(pair_moment[0]), Q::of(pair_moment[1])};
        CTR_UNROLL
        for (int node = 0; node < 2; ++node) Q::sum(bend[node], pair).add_to_row(el.r[node] + offset_index(p, 0));
    }
    for (int t = 0; t < M; ++t) {
        if (!turned.curved[t]) continue;
        const int i = theta_index(t);
        CTR_UNROLL
        for (int a = 0; a < 2; ++a) el.r[a][i] += linear(a, 0) * torque[0][t] + linear(a, 1) * torque[1][t];
        if (!MATRIX) continue;
        for (int l = 0; l < M; ++l) {
            if (!turned.curved[l]) continue;
            V value[2];
            for (int g = 0; g < 2; ++g) {
                const V* wt = turned.w[g][t];
                const V* wl = turned.w[g][l];
                value[g] = (P[t * n + l] * weight) * (wt[0] * wl[0] + wt[1] * wl[1]);
                if (l == t) value[g] += weight * (moment[g][t][0] * wt[0] + moment[g][t][1] * wt[1]);
            }
            CTR_UNROLL
            for (int a = 0; a < 2; ++a)
                for (int c = 0; c < 2; ++c) {
                    el.block[a][c][i * ld + theta_index(l)] += (linear(a, 0) * linear(c, 0)) * value[0] + (linear(a, 1) * linear(c, 1)) * value[1];
                }
        }
        for (int p = 0; p < offsets; ++p) {
            const double stiffness = -D[p * n + t];
            V coupling[2][2];
            for (int g = 0; g < 2; ++g) {
                coupling[g][0] = -stiffness * turned.w[g][t][1];  // w' = (-w_y, w_x)
                coupling[g][1] = stiffness * turned.w[g][t][0];
            }
            const Q pair[2] = {Q::of(coupling[0]), Q::of(coupling[1])};
            CTR_UNROLL
            for (int node = 0; node < 2; ++node)
                for (int c = 0; c < 2; ++c) {
                    const Q value = Q::sum(both[node][c], pair);
                    value.add_to_row(el.block[c][node] + i * ld + offset_index(p, 0));
                    value.add_to_column(el.block[node][c] + offset_index(p, 0) * ld + i, ld);
                }
        }
    }
}
