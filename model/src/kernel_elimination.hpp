// Block elimination of a node.
// Part of the kernels (kernel_body.hpp): included inside an anonymous namespace, no std::, no Eigen.

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
