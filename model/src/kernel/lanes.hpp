// Values of one, four or eight lanes: arithmetic, square roots, sines and cosines.
// Part of the kernels (kernel/body.hpp): included inside an anonymous namespace, no std::, no Eigen.

// Loops of known length over members of small arrays: their indices should be constants, so that values stay in registers.
#ifdef __clang__
#define CTR_UNROLL _Pragma("clang loop unroll(full)")
#else
#define CTR_UNROLL _Pragma("GCC unroll 16")
#endif

typedef double V4 __attribute__((vector_size(32)));

// The lanes of a value: a double has one, a vector as many as it has entries.
template <class V>
struct Lane {
    static constexpr int count = sizeof(V) / sizeof(double);
    static double& at(V& v, int lane) { return reinterpret_cast<double*>(&v)[lane]; }
    static double at(const V& v, int lane) { return reinterpret_cast<const double*>(&v)[lane]; }
};

template <class V>
inline V zero_of(V) {
    return V{};
}
template <class V>
inline V broadcast(double value) {
    return zero_of(V{}) + value;
}
inline double root(double v) { return __builtin_sqrt(v); }
template <class V>
inline V root(V v) {
    CTR_UNROLL
    for (int lane = 0; lane < Lane<V>::count; ++lane) v[lane] = __builtin_sqrt(v[lane]);
    return v;
}
template <class V>
inline V larger(V a, V b) {
    return a > b ? a : b;
}
template <class V>
inline V magnitude(V v) {
    return larger(v, -v);
}
inline double nearest(double v) { return __builtin_rint(v); }
template <class V>
inline V nearest(V v) {
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

inline void transpose(const V4 (&row)[4], V4* column) {
    const V4 a = {row[0][0], row[1][0], row[0][2], row[1][2]}, b = {row[0][1], row[1][1], row[0][3], row[1][3]};
    const V4 c = {row[2][0], row[3][0], row[2][2], row[3][2]}, d = {row[2][1], row[3][1], row[2][3], row[3][3]};
    column[0] = V4{a[0], a[1], c[0], c[1]};
    column[1] = V4{b[0], b[1], d[0], d[1]};
    column[2] = V4{a[2], a[3], c[2], c[3]};
    column[3] = V4{b[2], b[3], d[2], d[3]};
}

// The sum over the lanes of each value.
inline void sum_lanes(const V4* values, int count, double* sums) {
    int i = 0;
    for (; i + 4 <= count; i += 4) {
        V4 column[4];
        const V4 row[4] = {values[i], values[i + 1], values[i + 2], values[i + 3]};
        transpose(row, column);
        const V4 sum = (column[0] + column[1]) + (column[2] + column[3]);
        __builtin_memcpy(sums + i, &sum, sizeof sum);
    }
    for (; i < count; ++i) sums[i] = (values[i][0] + values[i][1]) + (values[i][2] + values[i][3]);
}

template <class V>
inline V* lanes(double* pointer) {
    return reinterpret_cast<V*>(pointer);
}

template <class V>
inline const V* lanes(const double* pointer) {
    return reinterpret_cast<const V*>(pointer);
}

template <class V>
inline void clear(V* values, int count) {
    const V zero = zero_of(V{});
    for (int i = 0; i < count; ++i) values[i] = zero;
}
