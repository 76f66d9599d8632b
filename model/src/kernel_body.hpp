// Body of the kernels, included by one translation unit per instruction set inside an anonymous namespace.
// No std::, no Eigen, no functions shared with other translation units (see kernel.hpp).

typedef double V4 __attribute__((vector_size(32)));

// The lanes of a value: a double has one, a V4 four.
template <class V>
struct Lane {
    static constexpr int count = sizeof(V) / sizeof(double);
    static double& at(V& v, int lane) { return reinterpret_cast<double*>(&v)[lane]; }
    static double at(const V& v, int lane) { return reinterpret_cast<const double*>(&v)[lane]; }
};

inline double zero_of(double) { return 0.0; }
inline V4 zero_of(V4) { return V4{0, 0, 0, 0}; }
template <class V>
inline V broadcast(double value) {
    return zero_of(V{}) + value;
}
inline double root(double v) { return __builtin_sqrt(v); }
inline V4 root(V4 v) {
    return V4{__builtin_sqrt(v[0]), __builtin_sqrt(v[1]), __builtin_sqrt(v[2]), __builtin_sqrt(v[3])};
}
inline double larger(double a, double b) { return a > b ? a : b; }
inline V4 larger(V4 a, V4 b) { return a > b ? a : b; }
inline double smaller(double a, double b) { return a < b ? a : b; }
inline V4 smaller(V4 a, V4 b) { return a < b ? a : b; }
template <class V>
inline V magnitude(V v) {
    return larger(v, -v);
}
inline double nearest(double v) { return __builtin_rint(v); }
inline V4 nearest(V4 v) {
    const double shift = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds to an integer
    return (v + shift) - shift;
}

// Sine and cosine by quadrant reduction (two-part pi/2) and the classical minimax kernels; |x| < 1e6, error < 2 ulp.
template <class V>
inline void sine_cosine(V x, V& sine, V& cosine) {
    const V quadrant = nearest(x * 0.63661977236758134308);
    V r = x - quadrant * 1.57079632673412561417;
    r = r - quadrant * 6.07710050650619224932e-11;
    const V z = r * r;
    const V s = r + r * z *
        (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 +
        z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
    const V c = 1.0 - 0.5 * z + z * z *
        (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 +
        z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 - z * 1.13596475577881948265e-11)))));
    // quadrant mod 4 decides which of s, c and which signs
    const V half = nearest(quadrant * 0.25 - 0.125);          // floor(q / 4 + 1/8 - ...) for q mod 4
    const V q = quadrant - 4.0 * half;                        // in {-1, 0, 1, 2, 3} up to rounding of ties
    for (int lane = 0; lane < Lane<V>::count; ++lane) {
        const int k = static_cast<int>(Lane<V>::at(q, lane)) & 3;
        const double sl = Lane<V>::at(s, lane), cl = Lane<V>::at(c, lane);
        const double a = (k & 1) ? cl : sl, b = (k & 1) ? sl : cl;
        Lane<V>::at(sine, lane) = (k & 2) ? -a : a;
        Lane<V>::at(cosine, lane) = (k == 1 || k == 2) ? -b : b;
    }
}

template <class V>
inline V* lanes(double* pointer) {
    return reinterpret_cast<V*>(pointer);
}

template <class V>
inline void clear(V* values, int count) {
    const V zero = zero_of(V{});
    for (int i = 0; i < count; ++i) values[i] = zero;
}

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
    const double* v = pb.precurvature + e * n * 2;
    const int ld = el.ld;
    const V zero = zero_of(V{});

    for (int t = 0; t < M; ++t) {
        const double k = pb.torsional_stiffness[t] / h;
        const int i = theta_index(t);
        const V moment = k * (el.x[1][i] - el.x[0][i]);
        el.r[0][i] -= moment;
        el.r[1][i] += moment;
        if (MATRIX) {
            el.block[0][0][i * ld + i] += k;
            el.block[1][1][i * ld + i] += k;
            el.block[0][1][i * ld + i] -= k;
            el.block[1][0][i * ld + i] -= k;
        }
    }
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

template <class V>
struct ContactPoint {
    V d[2], gap;  // offset, w = (c^2 - |d|^2) / 2
};

template <class V>
inline ContactPoint<V> contact_point(const KernelProblem& pb, int k, const V* proximal, const V* distal) {
    const int p = pb.contact_pair[k];
    const double* shape = pb.contact_shape + 4 * k;
    ContactPoint<V> point;
    for (int plane = 0; plane < 2; ++plane)
        point.d[plane] = shape[0] * proximal[offset_index(p, plane)] + shape[1] * proximal[slope_index(p, plane)] +
                         shape[2] * distal[offset_index(p, plane)] + shape[3] * distal[slope_index(p, plane)];
    point.gap = pb.half_square_clearance[p] - 0.5 * (point.d[0] * point.d[0] + point.d[1] * point.d[1]);
    return point;
}

// What the contact points of one pair add up to in an element, before it is spread over the blocks.
template <class V>
struct PairSums {
    V force[4][2];          // per Hermite function and plane
    V torque[2];            // per node, over the torque arm
    V tangent[10][2][2];    // per pair of Hermite functions a <= b: sum N_a N_b T
    V slope[2][4][2];       // per node and Hermite function: derivative of the torque by the offset
};

// Contact forces of one element. The gap w = (c^2 - |d|^2) / 2 has a slack variable of its own, so that contact points may
// slide around the bore in one step; `value` is the iterate's multiplier for the true residual, and in a Newton step what
// eliminating multiplier and slack leaves of it. The primal-dual derivative follows if MATRIX.
template <class V, bool MATRIX>
inline void sum_contact(const KernelProblem& pb, const KernelState& st, int k, const ElementView<V>& el, V level, PairSums<V>& sums) {
    const int p = pb.contact_pair[k];
    const double* shape = pb.contact_shape + 4 * k;
    const double linear[2] = {1 - pb.contact_xi[k], pb.contact_xi[k]};
    const V lambda = lanes<V>(st.multiplier)[k], friction = lanes<V>(st.phi_mu)[k];
    const ContactPoint<V> at = contact_point<V>(pb, k, el.x[0], el.x[1]);
    V value = lambda, ratio = zero_of(V{});
    if (MATRIX) {
        const V slack = lanes<V>(st.slack)[k];
        const V eps = level * (pb.barrier_scale[p] * pb.contact_weight[k]);
        const V inverse_slack = 1.0 / slack;
        ratio = lambda * inverse_slack;
        value = eps * inverse_slack + ratio * (slack - at.gap);
    }
    const V g[2] = {at.d[0] - friction * at.d[1], at.d[1] + friction * at.d[0]};  // (I + phi mu J) d
    const V square = at.d[0] * at.d[0] + at.d[1] * at.d[1];
    const V torque = friction * value * square;
    for (int plane = 0; plane < 2; ++plane) {
        const V force = value * g[plane];
        for (int a = 0; a < 4; ++a) sums.force[a][plane] += shape[a] * force;
    }
    for (int a = 0; a < 2; ++a) sums.torque[a] += linear[a] * torque;
    if (!MATRIX) return;
    const V T[2][2] = {{lambda + ratio * g[0] * at.d[0], ratio * g[0] * at.d[1] - lambda * friction},
                       {ratio * g[1] * at.d[0] + lambda * friction, lambda + ratio * g[1] * at.d[1]}};
    int ab = 0;
    for (int a = 0; a < 4; ++a)
        for (int b = a; b < 4; ++b, ++ab) {
            const double product = shape[a] * shape[b];
            for (int row = 0; row < 2; ++row)
                for (int plane = 0; plane < 2; ++plane) sums.tangent[ab][row][plane] += product * T[row][plane];
        }
    const V torque_slope = friction * (ratio * square + 2.0 * lambda);
    for (int plane = 0; plane < 2; ++plane) {
        const V slope = torque_slope * at.d[plane];
        for (int b = 0; b < 4; ++b) {
            const V s = shape[b] * slope;
            for (int a = 0; a < 2; ++a) sums.slope[a][b][plane] += linear[a] * s;
        }
    }
}

template <class V, bool MATRIX>
inline void spread_contacts(const KernelProblem& pb, int p, const ElementView<V>& el, const PairSums<V>& sums) {
    const int ld = el.ld, outer = theta_index(p + 1), inner = theta_index(p);
    const double arm_out = pb.outer_torque_arm[p], arm_in = pb.inner_torque_arm[p];
    for (int a = 0; a < 4; ++a)
        for (int plane = 0; plane < 2; ++plane)
            el.r[a >> 1][(a & 1) ? slope_index(p, plane) : offset_index(p, plane)] += sums.force[a][plane];
    for (int a = 0; a < 2; ++a) {
        el.r[a][outer] -= arm_out * sums.torque[a];
        el.r[a][inner] += arm_in * sums.torque[a];
    }
    if (!MATRIX) return;
    int ab = 0;
    for (int a = 0; a < 4; ++a)
        for (int b = a; b < 4; ++b, ++ab)
            for (int row = 0; row < 2; ++row)
                for (int plane = 0; plane < 2; ++plane) {
                    const V value = sums.tangent[ab][row][plane];
                    const int ia = (a & 1) ? slope_index(p, row) : offset_index(p, row);
                    const int jb = (b & 1) ? slope_index(p, plane) : offset_index(p, plane);
                    el.block[a >> 1][b >> 1][ia * ld + jb] += value;
                    if (a == b) continue;
                    const int ib = (b & 1) ? slope_index(p, row) : offset_index(p, row);
                    const int ja = (a & 1) ? slope_index(p, plane) : offset_index(p, plane);
                    el.block[b >> 1][a >> 1][ib * ld + ja] += value;
                }
    for (int a = 0; a < 2; ++a)
        for (int b = 0; b < 4; ++b)
            for (int plane = 0; plane < 2; ++plane) {
                const int j = (b & 1) ? slope_index(p, plane) : offset_index(p, plane);
                el.block[a][b >> 1][outer * ld + j] -= arm_out * sums.slope[a][b][plane];
                el.block[a][b >> 1][inner * ld + j] += arm_in * sums.slope[a][b][plane];
            }
}

template <class V, bool MATRIX>
inline void add_contacts(const KernelProblem& pb, const KernelState& st, int e, const ElementView<V>& el, const V* level) {
    const int begin = pb.contact_begin[e], end = pb.contact_begin[e + 1], pairs = pb.element_tubes[e] - 1;
    if (begin == end) return;
    for (int p = 0; p < pairs; ++p) {
        PairSums<V> sums;
        clear(reinterpret_cast<V*>(&sums), sizeof(sums) / sizeof(V));
        for (int k = begin; k < end; ++k)
            if (pb.contact_pair[k] == p) sum_contact<V, MATRIX>(pb, st, k, el, level[0], sums);
        spread_contacts<V, MATRIX>(pb, p, el, sums);
    }
}

template <class V, bool MATRIX>
inline void add_element(const KernelProblem& pb, const KernelState& st, int e, const ElementView<V>& el, const V* level,
                        const V* damping) {
    const int m = pb.element_tubes[e];
    const bool free = pb.element_unknowns[e] == 5 * m;
    switch (free ? -m : m) {
        case 1: add_elastic<V, MATRIX>(1, 0, pb, e, el); break;
        case 2: add_elastic<V, MATRIX>(2, 1, pb, e, el); break;
        case 3: add_elastic<V, MATRIX>(3, 2, pb, e, el); break;
        case 4: add_elastic<V, MATRIX>(4, 3, pb, e, el); break;
        case -1: add_elastic<V, MATRIX>(1, 1, pb, e, el); break;
        case -2: add_elastic<V, MATRIX>(2, 2, pb, e, el); break;
        case -3: add_elastic<V, MATRIX>(3, 3, pb, e, el); break;
        default: add_elastic<V, MATRIX>(m, free ? m : m - 1, pb, e, el);
    }
    add_contacts<V, MATRIX>(pb, st, e, el, level);
    if (!MATRIX) return;
    for (int t = 0; t < m; ++t) {  // lumped, so that it never couples nodes
        const V mass = damping[0] * (0.5 * pb.length[e] * pb.torsional_stiffness[t]);
        const int i = theta_index(t) * (el.ld + 1);
        el.block[0][0][i] += mass;
        el.block[1][1][i] += mass;
    }
}

// Rows of the blocks are handled in chunks that fill a register: one entry of all lanes, or four entries of a single lane.
template <class V>
struct Chunk;
template <>
struct Chunk<V4> {
    static constexpr int width = 1;
    static V4 load(const V4* p) { return *p; }
    static void store(V4* p, V4 v) { *p = v; }
};
template <>
struct Chunk<double> {
    static constexpr int width = 4;
    static V4 load(const double* p) {
        V4 v;
        __builtin_memcpy(&v, p, sizeof v);
        return v;
    }
    static void store(double* p, V4 v) { __builtin_memcpy(p, &v, sizeof v); }
};

// row -= sum over k in [from, to) of factors[k] * rows[k], all of Q entries; the row stays in registers meanwhile.
template <class V, int Q>
__attribute__((always_inline)) inline void subtract(V* row, const V* factors, const V* rows, int ld, int from, int to) {
    constexpr int count = (Q + Chunk<V>::width - 1) / Chunk<V>::width, width = Chunk<V>::width;
    V4 kept[count];
    for (int c = 0; c < count; ++c) kept[c] = Chunk<V>::load(row + c * width);
    for (int k = from; k < to; ++k) {
        const V factor = factors[k];
        for (int c = 0; c < count; ++c) kept[c] -= factor * Chunk<V>::load(rows + k * ld + c * width);
    }
    for (int c = 0; c < count; ++c) Chunk<V>::store(row + c * width, kept[c]);
}

template <class V, int Q>
__attribute__((always_inline)) inline void scale(V* row, V factor) {
    constexpr int count = (Q + Chunk<V>::width - 1) / Chunk<V>::width, width = Chunk<V>::width;
    for (int c = 0; c < count; ++c) Chunk<V>::store(row + c * width, factor * Chunk<V>::load(row + c * width));
}

// LU of the leading P x P part of A in place, pivots inverted. No pivoting: the blocks are elastic stiffnesses plus contact
// terms; a bad pivot shows in the residual, which is checked afterwards.
template <class V>
__attribute__((always_inline)) inline void factorise(V* A, int ld, int P) {
    for (int k = 0; k < P; ++k) {
        const V pivot = 1.0 / A[k * ld + k];
        A[k * ld + k] = pivot;
        for (int i = k + 1; i < P; ++i) {
            const V factor = A[i * ld + k] * pivot;
            A[i * ld + k] = factor;
            for (int j = k + 1; j < P; ++j) A[i * ld + j] -= factor * A[k * ld + j];
        }
    }
}

template <class V>
inline void apply_factors(const V* A, V* r, int ld, int P) {
    for (int i = 1; i < P; ++i)
        for (int k = 0; k < i; ++k) r[i] -= A[i * ld + k] * r[k];
    for (int i = P - 1; i >= 0; --i) {
        for (int k = i + 1; k < P; ++k) r[i] -= A[i * ld + k] * r[k];
        r[i] *= A[i * ld + i];
    }
}

// Eliminates a node of P unknowns: A factored, U := A^-1 U (P x Q), r := A^-1 r; next -= L U and next_r -= L r (L is Q x P).
template <class V, int P, int Q>
inline void eliminate_node(V* A, V* U, V* r, const V* L, V* next, V* next_r, int ld) {
    factorise<V>(A, ld, P);
    apply_factors<V>(A, r, ld, P);
    for (int i = 1; i < P; ++i) subtract<V, Q>(U + i * ld, A + i * ld, U, ld, 0, i);
    for (int i = P - 1; i >= 0; --i) {
        subtract<V, Q>(U + i * ld, A + i * ld, U, ld, i + 1, P);
        scale<V, Q>(U + i * ld, A[i * ld + i]);
    }
    for (int i = 0; i < Q; ++i) {
        subtract<V, Q>(next + i * ld, L + i * ld, U, ld, 0, P);
        for (int k = 0; k < P; ++k) next_r[i] -= L[i * ld + k] * r[k];
    }
}

// The same for sizes known only at run time.
template <class V>
void eliminate_node_any(V* A, V* U, V* r, const V* L, V* next, V* next_r, int ld, int P, int Q) {
    factorise<V>(A, ld, P);
    apply_factors<V>(A, r, ld, P);
    for (int j = 0; j < Q; ++j) {
        for (int i = 1; i < P; ++i)
            for (int k = 0; k < i; ++k) U[i * ld + j] -= A[i * ld + k] * U[k * ld + j];
        for (int i = P - 1; i >= 0; --i) {
            for (int k = i + 1; k < P; ++k) U[i * ld + j] -= A[i * ld + k] * U[k * ld + j];
            U[i * ld + j] *= A[i * ld + i];
        }
    }
    for (int i = 0; i < Q; ++i)
        for (int k = 0; k < P; ++k) {
            for (int j = 0; j < Q; ++j) next[i * ld + j] -= L[i * ld + k] * U[k * ld + j];
            next_r[i] -= L[i * ld + k] * r[k];
        }
}

template <class V>
inline void eliminate(V* A, V* U, V* r, const V* L, V* next, V* next_r, int ld, int P, int Q) {
    if (P == 11 && Q == 11) return eliminate_node<V, 11, 11>(A, U, r, L, next, next_r, ld);
    if (P == 6 && Q == 6) return eliminate_node<V, 6, 6>(A, U, r, L, next, next_r, ld);
    if (P == 10 && Q == 10) return eliminate_node<V, 10, 10>(A, U, r, L, next, next_r, ld);
    if (P == 5 && Q == 5) return eliminate_node<V, 5, 5>(A, U, r, L, next, next_r, ld);
    if (P == 16 && Q == 16) return eliminate_node<V, 16, 16>(A, U, r, L, next, next_r, ld);
    if (P == 1 && Q == 1) return eliminate_node<V, 1, 1>(A, U, r, L, next, next_r, ld);
    eliminate_node_any<V>(A, U, r, L, next, next_r, ld, P, Q);
}

template <class V>
inline ElementView<V> view(const KernelProblem& pb, const KernelState& st, int e) {
    const int stride = pb.stride, ld = st.block_stride, square = stride * ld;
    V *x = lanes<V>(st.unknowns), *r = lanes<V>(st.rhs), *A = lanes<V>(st.diagonal);
    ElementView<V> el;
    for (int a = 0; a < 2; ++a) {
        el.x[a] = x + (e + a) * stride;
        el.r[a] = r + (e + a) * stride;
        el.block[a][a] = A + (e + a) * square;
    }
    el.block[0][1] = lanes<V>(st.upper) + e * square;
    el.block[1][0] = lanes<V>(st.lower) + e * square;
    el.ld = ld;
    return el;
}

// Slack and multiplier steps that belong to `step`: w + dw = gap - d . delta, lambda dw + w dlambda = eps - lambda w.
template <class V>
void recover_multipliers(const KernelProblem& pb, const KernelState& st, const V* level) {
    const int ld = pb.stride;
    const V *x = lanes<V>(st.unknowns), *step = lanes<V>(st.step), *lambda = lanes<V>(st.multiplier), *slack = lanes<V>(st.slack);
    V *change = lanes<V>(st.multiplier_step), *slack_change = lanes<V>(st.slack_step);
    for (int e = 0; e < pb.elements; ++e)
        for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k) {
            const int p = pb.contact_pair[k];
            const ContactPoint<V> at = contact_point<V>(pb, k, x + e * ld, x + (e + 1) * ld);
            const ContactPoint<V> move = contact_point<V>(pb, k, step + e * ld, step + (e + 1) * ld);
            const V eps = level[0] * (pb.barrier_scale[p] * pb.contact_weight[k]);
            slack_change[k] = at.gap - slack[k] - (at.d[0] * move.d[0] + at.d[1] * move.d[1]);
            change[k] = (eps - lambda[k] * slack_change[k]) / slack[k] - lambda[k];
        }
}

template <class V>
void back_substitute(const KernelProblem& pb, const KernelState& st) {
    const int stride = pb.stride, ld = st.block_stride, square = stride * ld;
    const V *r = lanes<V>(st.rhs), *U = lanes<V>(st.upper);
    V* step = lanes<V>(st.step);
    for (int k = pb.nodes - 1; k >= 0; --k) {
        const int P = pb.node_unknowns[k];
        const int Q = k + 1 < pb.nodes ? pb.element_unknowns[k] : 0;
        for (int i = 0; i < stride; ++i) {
            V sum = i < P ? -r[k * stride + i] : zero_of(V{});
            if (i < P)
                for (int j = 0; j < Q; ++j) sum -= U[k * square + i * ld + j] * step[(k + 1) * stride + j];
            step[k * stride + i] = sum;
        }
    }
}

template <class V>
void newton(const KernelProblem& pb, const KernelState& st, const double* level_values, const double* damping_values) {
    const int stride = pb.stride, ld = st.block_stride, square = stride * ld;
    V level = zero_of(V{}), damping = zero_of(V{});
    for (int lane = 0; lane < Lane<V>::count; ++lane) {
        Lane<V>::at(level, lane) = level_values[lane];
        Lane<V>::at(damping, lane) = damping_values[lane];
    }
    V *r = lanes<V>(st.rhs), *A = lanes<V>(st.diagonal), *U = lanes<V>(st.upper), *L = lanes<V>(st.lower);
    clear(r, pb.nodes * stride);
    clear(A, square);
    for (int e = 0; e < pb.elements; ++e) {
        clear(A + (e + 1) * square, square);
        clear(U + e * square, square);
        clear(L + e * square, square);
        add_element<V, true>(pb, st, e, view<V>(pb, st, e), &level, &damping);
        eliminate<V>(A + e * square, U + e * square, r + e * stride, L + e * square, A + (e + 1) * square,
                     r + (e + 1) * stride, ld, pb.node_unknowns[e], pb.element_unknowns[e]);
    }
    const int last = pb.nodes - 1;
    factorise<V>(A + last * square, ld, pb.node_unknowns[last]);
    apply_factors<V>(A + last * square, r + last * stride, ld, pb.node_unknowns[last]);
    back_substitute<V>(pb, st);
    recover_multipliers<V>(pb, st, &level);
}

// Applies the factors to a new right-hand side; the sign is that of a Newton step (solves H step = -rhs).
template <class V>
void solve(const KernelProblem& pb, const KernelState& st) {
    const int stride = pb.stride, ld = st.block_stride, square = stride * ld;
    V *r = lanes<V>(st.rhs), *A = lanes<V>(st.diagonal), *L = lanes<V>(st.lower);
    for (int k = 0; k < pb.nodes; ++k) {
        const int P = pb.node_unknowns[k];
        V* b = r + k * stride;
        apply_factors<V>(A + k * square, b, ld, P);
        if (k + 1 == pb.nodes) break;
        for (int i = 0; i < pb.element_unknowns[k]; ++i)
            for (int j = 0; j < P; ++j) r[(k + 1) * stride + i] -= L[k * square + i * ld + j] * b[j];
    }
    back_substitute<V>(pb, st);
}

template <class V>
void residual(const KernelProblem& pb, const KernelState& st, const double* level_values, double* moment, double* complementarity) {
    const int ld = pb.stride;
    V level = zero_of(V{});
    for (int lane = 0; lane < Lane<V>::count; ++lane) Lane<V>::at(level, lane) = level_values[lane];
    V* r = lanes<V>(st.rhs);
    const V* lambda = lanes<V>(st.multiplier);
    clear(r, pb.nodes * ld);
    V worst = zero_of(V{}), gap_error = zero_of(V{});
    for (int e = 0; e < pb.elements; ++e) {
        const ElementView<V> el = view<V>(pb, st, e);
        add_element<V, false>(pb, st, e, el, &level, nullptr);
        const double h = pb.length[e];
        const int P = pb.node_unknowns[e];
        for (int i = 0; i < P; ++i) worst = larger(worst, (i % 5 == 1 || i % 5 == 2) ? h * magnitude(el.r[0][i]) : magnitude(el.r[0][i]));
        for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k) {
            const V eps = level * (pb.barrier_scale[pb.contact_pair[k]] * pb.contact_weight[k]);
            const V gap = contact_point<V>(pb, k, el.x[0], el.x[1]).gap;
            gap_error = larger(gap_error, magnitude(lambda[k] * gap - eps) / eps);
        }
    }
    const int last = pb.nodes - 1;
    const double h = pb.length[pb.elements - 1];
    for (int i = 0; i < pb.node_unknowns[last]; ++i) {
        const V value = magnitude(r[last * ld + i]);
        worst = larger(worst, (i % 5 == 1 || i % 5 == 2) ? h * value : value);
    }
    for (int lane = 0; lane < Lane<V>::count; ++lane) {
        moment[lane] = Lane<V>::at(worst, lane);
        complementarity[lane] = Lane<V>::at(gap_error, lane);
    }
}

template <class V>
void step_length(const KernelProblem& pb, const KernelState& st, double keep, double* primal, double* dual) {
    const V *lambda = lanes<V>(st.multiplier), *change = lanes<V>(st.multiplier_step);
    const V *slack = lanes<V>(st.slack), *slack_change = lanes<V>(st.slack_step);
    V worst_primal = broadcast<V>(keep), worst_dual = broadcast<V>(keep);  // largest relative decrease
    for (int k = 0; k < pb.contacts; ++k) {
        worst_primal = larger(worst_primal, -slack_change[k] / slack[k]);
        worst_dual = larger(worst_dual, -change[k] / lambda[k]);
    }
    for (int lane = 0; lane < Lane<V>::count; ++lane) {
        primal[lane] = keep / Lane<V>::at(worst_primal, lane);
        dual[lane] = keep / Lane<V>::at(worst_dual, lane);
    }
}

template <class V>
void advance(const KernelProblem& pb, const KernelState& st, const double* primal, const double* dual) {
    V a = zero_of(V{}), b = zero_of(V{});
    for (int lane = 0; lane < Lane<V>::count; ++lane) {
        Lane<V>::at(a, lane) = primal[lane];
        Lane<V>::at(b, lane) = dual[lane];
    }
    V *x = lanes<V>(st.unknowns), *lambda = lanes<V>(st.multiplier), *slack = lanes<V>(st.slack);
    const V *step = lanes<V>(st.step), *change = lanes<V>(st.multiplier_step), *slack_change = lanes<V>(st.slack_step);
    for (int i = 0; i < pb.nodes * pb.stride; ++i) x[i] += a * step[i];
    for (int k = 0; k < pb.contacts; ++k) {
        lambda[k] += b * change[k];
        slack[k] += a * slack_change[k];
    }
}

const KernelTable kScalar = {newton<double>, step_length<double>, advance<double>, residual<double>, solve<double>};
const KernelTable kVector = {newton<V4>, step_length<V4>, advance<V4>, residual<V4>, solve<V4>};
