// Block elimination of a node.
// Part of the kernels (kernel/body.hpp): included inside an anonymous namespace, no std::, no Eigen.

// Rows of the blocks are handled in chunks that fill a register: one entry of all lanes, or four entries of a single lane.
template <class V>
struct Chunk {
    typedef V Register;
    static constexpr int width = 1;
    static V load(const V* p) { return *p; }
    static void store(V* p, V v) { *p = v; }
};
template <>
struct Chunk<double> {
    typedef V4 Register;
    static constexpr int width = 4;
    static V4 load(const double* p) {
        V4 v;
        __builtin_memcpy(&v, p, sizeof v);
        return v;
    }
    static void store(double* p, V4 v) { __builtin_memcpy(p, &v, sizeof v); }
};

// Work with 0, 1, .. N - 1, each a constant to the compiler.
template <int K>
struct Constant {
    static constexpr int value = K;
};
template <int N>
struct Each {
    template <class Work>
    __attribute__((always_inline)) static void run(const Work& work) {
        if constexpr (N > 0) {
            Each<N - 1>::run(work);
            work(Constant<N - 1>{});
        }
    }
};

// LU of the leading P x P part of A in place, pivots inverted. No pivoting: the blocks are elastic stiffnesses plus contact
// terms; a bad pivot shows in the residual, which is checked afterwards. Several lanes: row by row, each in registers meanwhile.
template <int P, class V>
__attribute__((noinline)) void factorise_rows(V* A, int ld) {
    Each<P>::run([&](auto row_index) __attribute__((always_inline)) {
        constexpr int i = row_index.value;
        V row[P];
        Each<P>::run([&](auto j) __attribute__((always_inline)) { row[j.value] = A[i * ld + j.value]; });
        Each<i>::run([&](auto k) __attribute__((always_inline)) {
            const V* above = A + k.value * ld;
            row[k.value] *= above[k.value];
            for (int j = k.value + 1; j < P; ++j) row[j] -= row[k.value] * above[j];
        });
        row[i] = 1.0 / row[i];
        Each<P>::run([&](auto j) __attribute__((always_inline)) { A[i * ld + j.value] = row[j.value]; });
    });
}

// One lane: pivot by pivot, so that the rows below do not wait for each other.
template <int P>
__attribute__((noinline)) void factorise_rows(double* A, int ld) {
    constexpr int count = (P + 3) / 4;
    Each<P>::run([&](auto pivot) __attribute__((always_inline)) {
        constexpr int k = pivot.value, first = k / 4;
        V4 upper[count];
        for (int c = first; c < count; ++c) upper[c] = Chunk<double>::load(A + k * ld + 4 * c);
        const double inverse = 1.0 / A[k * ld + k];
        A[k * ld + k] = inverse;
        for (int i = k + 1; i < P; ++i) {
            const double factor = A[i * ld + k] * inverse;
            V4 row = Chunk<double>::load(A + i * ld + 4 * first), changed = row - factor * upper[first];
            for (int lane = 0; lane < k % 4; ++lane) changed[lane] = row[lane];  // factors of earlier pivots
            changed[k % 4] = factor;
            Chunk<double>::store(A + i * ld + 4 * first, changed);
            for (int c = first + 1; c < count; ++c)
                Chunk<double>::store(A + i * ld + 4 * c, Chunk<double>::load(A + i * ld + 4 * c) - factor * upper[c]);
        }
    });
}

template <class V>
void factorise_any(V* A, int ld, int P) {
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
inline void factorise(V* A, int ld, int P) {
    switch (P) {
        case 0: return;
        case 1: return factorise_rows<1>(A, ld);
        case 5: return factorise_rows<5>(A, ld);
        case 6: return factorise_rows<6>(A, ld);
        case 10: return factorise_rows<10>(A, ld);
        case 11: return factorise_rows<11>(A, ld);
        case 15: return factorise_rows<15>(A, ld);
        case 16: return factorise_rows<16>(A, ld);
        case 20: return factorise_rows<20>(A, ld);
        case 21: return factorise_rows<21>(A, ld);
        default: return factorise_any<V>(A, ld, P);
    }
}

// Of a row of a block and a vector.
template <class V>
inline V product(const V* row, const V* vector, int count) {
    V sum = zero_of(V{});
    for (int j = 0; j < count; ++j) sum += row[j] * vector[j];
    return sum;
}
template <>
inline double product<double>(const double* row, const double* vector, int count) {
    V4 sum = zero_of(V4{});
    int j = 0;
    for (; j + 4 <= count; j += 4) sum += Chunk<double>::load(row + j) * Chunk<double>::load(vector + j);
    double rest = 0;
    for (; j < count; ++j) rest += row[j] * vector[j];
    return rest + (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

// to -= M x for a block of `rows` rows, of which `count` entries are in use. A single lane takes four rows at a time and whole
// registers of each: the rest of a row is zero, and x is finite beyond its end (kernel.hpp).
template <class V>
inline void subtract_product(const V* M, const V* x, V* to, int ld, int rows, int count) {
    for (int i = 0; i < rows; ++i) to[i] -= product<V>(M + i * ld, x, count);
}
inline V4 four_products(const double* M, const double* x, int ld, int count) {
    V4 sum[4] = {zero_of(V4{}), zero_of(V4{}), zero_of(V4{}), zero_of(V4{})}, column[4];
    for (int j = 0; j < count; j += 4) {
        const V4 values = Chunk<double>::load(x + j);
        CTR_UNROLL
        for (int row = 0; row < 4; ++row) sum[row] += Chunk<double>::load(M + row * ld + j) * values;
    }
    transpose(sum, column);
    return (column[0] + column[1]) + (column[2] + column[3]);
}
inline void subtract_product(const double* M, const double* x, double* to, int ld, int rows, int count) {
    int i = 0;
    for (; i + 4 <= rows; i += 4) Chunk<double>::store(to + i, Chunk<double>::load(to + i) - four_products(M + i * ld, x, ld, count));
    if (i < rows && rows >= 4) {  // the last four once more, those that are done left out
        const V4 place = {0, 1, 2, 3}, more = four_products(M + (rows - 4) * ld, x, ld, count);
        const V4 kept = Chunk<double>::load(to + rows - 4);
        Chunk<double>::store(to + rows - 4, place < broadcast<V4>(4 - (rows - i)) ? kept : kept - more);
    } else {
        for (; i < rows; ++i) to[i] -= product<double>(M + i * ld, x, count);
    }
}

// r := A^-1 r with the factors of P x P, column by column, r in registers meanwhile.
template <int P, class V>
__attribute__((noinline)) void apply_factors_fixed(const V* A, V* r, int ld) {
    V value[P];
    Each<P>::run([&](auto i) __attribute__((always_inline)) { value[i.value] = r[i.value]; });
    Each<P>::run([&](auto column) __attribute__((always_inline)) {
        constexpr int j = column.value;
        Each<P - 1 - j>::run([&](auto below) __attribute__((always_inline)) {
            constexpr int i = j + 1 + below.value;
            value[i] -= A[i * ld + j] * value[j];
        });
    });
    Each<P>::run([&](auto back) __attribute__((always_inline)) {
        constexpr int j = P - 1 - back.value;
        value[j] *= A[j * ld + j];
        Each<j>::run([&](auto i) __attribute__((always_inline)) { value[i.value] -= A[i.value * ld + j] * value[j]; });
    });
    Each<P>::run([&](auto i) __attribute__((always_inline)) { r[i.value] = value[i.value]; });
}

template <class V>
inline void apply_factors(const V* A, V* r, int ld, int P) {
    switch (P) {
        case 0: return;
        case 1: return apply_factors_fixed<1>(A, r, ld);
        case 5: return apply_factors_fixed<5>(A, r, ld);
        case 6: return apply_factors_fixed<6>(A, r, ld);
        case 10: return apply_factors_fixed<10>(A, r, ld);
        case 11: return apply_factors_fixed<11>(A, r, ld);
        case 15: return apply_factors_fixed<15>(A, r, ld);
        case 16: return apply_factors_fixed<16>(A, r, ld);
        case 20: return apply_factors_fixed<20>(A, r, ld);
        case 21: return apply_factors_fixed<21>(A, r, ld);
        default:
            for (int i = 1; i < P; ++i) r[i] -= product<V>(A + i * ld, r, i);
            for (int i = P - 1; i >= 0; --i) r[i] = (r[i] - product<V>(A + i * ld + i + 1, r + i + 1, P - i - 1)) * A[i * ld + i];
    }
}

// Chunks of the entries of a row and of the right-hand side after the last, and how many of them stay in registers at once.
template <class V, int Q>
constexpr int kChunks = Q / Chunk<V>::width + 1;
constexpr int kRegisters = 12;

// row -= sum over k in [from, to) of factors[k] * rows[k]; the row's C chunks stay in registers meanwhile.
template <class V, int C>
__attribute__((always_inline)) inline void subtract(typename Chunk<V>::Register (&kept)[C], const V* factors, const V* rows, int ld, int from, int to) {
    for (int k = from; k < to; ++k) {
        const V factor = factors[k];
        for (int c = 0; c < C; ++c) kept[c] -= factor * Chunk<V>::load(rows + k * ld + c * Chunk<V>::width);
    }
}

template <class V, int C>
__attribute__((always_inline)) inline void read(typename Chunk<V>::Register (&kept)[C], const V* row) {
    for (int c = 0; c < C; ++c) kept[c] = Chunk<V>::load(row + c * Chunk<V>::width);
}

template <class V, int C>
__attribute__((always_inline)) inline void write(V* row, const typename Chunk<V>::Register (&kept)[C]) {
    for (int c = 0; c < C; ++c) Chunk<V>::store(row + c * Chunk<V>::width, kept[c]);
}

// C chunks of columns of a node of P unknowns, factored: U := A^-1 U, next -= L U (L has Q rows).
template <class V, int C>
__attribute__((always_inline)) inline void eliminate_chunks(const V* A, V* U, const V* L, V* next, int ld, int P, int Q) {
    typename Chunk<V>::Register kept[C];
    for (int i = 1; i < P; ++i) {
        read<V, C>(kept, U + i * ld);
        subtract<V, C>(kept, A + i * ld, U, ld, 0, i);
        write<V, C>(U + i * ld, kept);
    }
    for (int i = P - 1; i >= 0; --i) {
        read<V, C>(kept, U + i * ld);
        subtract<V, C>(kept, A + i * ld, U, ld, i + 1, P);
        for (int c = 0; c < C; ++c) kept[c] *= A[i * ld + i];
        write<V, C>(U + i * ld, kept);
    }
    for (int i = 0; i < Q; ++i) {
        read<V, C>(kept, next + i * ld);
        subtract<V, C>(kept, L + i * ld, U, ld, 0, P);
        write<V, C>(next + i * ld, kept);
    }
}

// Eliminates a node of P unknowns, factored: U := A^-1 U (P x Q), r := A^-1 r; next -= L U and next_r -= L r (L is Q x P). r
// rides along in the entries after the rows of U, which a row has room for (kernel.hpp) and which are zero otherwise.
template <class V, int Q>
__attribute__((noinline)) void eliminate_columns(const V* A, V* U, V* r, const V* L, V* next, V* next_r, int ld, int P) {
    constexpr int chunks = kChunks<V, Q>, parts = (chunks + kRegisters - 1) / kRegisters, longer = (chunks + parts - 1) / parts;
    for (int i = 0; i < P; ++i) U[i * ld + Q] = r[i];
    for (int i = 0; i < Q; ++i) next[i * ld + Q] = next_r[i];
    Each<parts>::run([&](auto part) __attribute__((always_inline)) {
        constexpr int first = part.value * longer, count = first + longer < chunks ? longer : chunks - first;
        constexpr int column = first * Chunk<V>::width;
        eliminate_chunks<V, count>(A, U + column, L, next + column, ld, P, Q);
    });
    for (int i = 0; i < P; ++i) {
        r[i] = U[i * ld + Q];
        U[i * ld + Q] = zero_of(V{});
    }
    for (int i = 0; i < Q; ++i) {
        next_r[i] = next[i * ld + Q];
        next[i * ld + Q] = zero_of(V{});
    }
}

// The same for sizes known only at run time.
template <class V>
void eliminate_columns_any(const V* A, V* U, V* r, const V* L, V* next, V* next_r, int ld, int P, int Q) {
    apply_factors(A, r, ld, P);
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
    factorise<V>(A, ld, P);
    switch (Q) {
        case 1: return eliminate_columns<V, 1>(A, U, r, L, next, next_r, ld, P);
        case 5: return eliminate_columns<V, 5>(A, U, r, L, next, next_r, ld, P);
        case 6: return eliminate_columns<V, 6>(A, U, r, L, next, next_r, ld, P);
        case 10: return eliminate_columns<V, 10>(A, U, r, L, next, next_r, ld, P);
        case 11: return eliminate_columns<V, 11>(A, U, r, L, next, next_r, ld, P);
        case 15: return eliminate_columns<V, 15>(A, U, r, L, next, next_r, ld, P);
        case 16: return eliminate_columns<V, 16>(A, U, r, L, next, next_r, ld, P);
        case 20: return eliminate_columns<V, 20>(A, U, r, L, next, next_r, ld, P);
        case 21: return eliminate_columns<V, 21>(A, U, r, L, next, next_r, ld, P);
        default: return eliminate_columns_any<V>(A, U, r, L, next, next_r, ld, P, Q);
    }
}
