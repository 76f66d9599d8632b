// Contact points of an element, a register at a time.
// Part of the kernels (kernel/body.hpp): included inside an anonymous namespace, no std::, no Eigen.

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

// The same for the iterate, with what exact geometry adds to the offset.
template <class V>
inline ContactPoint<V> contact_point(const KernelProblem& pb, const KernelState& st, int k, const V* proximal, const V* distal) {
    ContactPoint<V> point = contact_point<V>(pb, k, proximal, distal);
    if (!st.shift) return point;
    const V* shift = reinterpret_cast<const V*>(st.shift) + 2 * k;
    for (int plane = 0; plane < 2; ++plane) point.d[plane] += shift[plane];
    point.gap = pb.half_square_clearance[pb.contact_pair[k]] - 0.5 * (point.d[0] * point.d[0] + point.d[1] * point.d[1]);
    return point;
}

// Contact points are treated a register at a time: one point in several friction states, or four points of one pair in a
// single state. Then what belongs to the mesh has four values too, and points beyond the last of the pair carry nothing.
template <class V>
struct Points {
    typedef V Values;
    static constexpr int width = 1;
    typedef double Real;  // a value of the mesh
    static double real(const double* values, int) { return values[0]; }
    static V state(const V* values, int, double) { return values[0]; }
    static void read_shapes(const double* shapes, int, double* shape) {
        for (int a = 0; a < 4; ++a) shape[a] = shapes[a];
    }
    static void read_shift(const V* values, V* shift) {
        for (int plane = 0; plane < 2; ++plane) shift[plane] = values[plane];
    }
    static void store(V* values, V value) { values[0] = value; }
};

// Arrays over contacts have room for four values from every contact on (kernel.hpp).
template <>
struct Points<double> {
    typedef V4 Values;
    static constexpr int width = 4;
    typedef V4 Real;
    static V4 read(const double* values) {
        V4 v;
        __builtin_memcpy(&v, values, sizeof v);
        return v;
    }
    static V4 among(V4 v, int count, double otherwise) {
        const V4 place = {0, 1, 2, 3};
        return place < broadcast<V4>(count) ? v : broadcast<V4>(otherwise);
    }
    static V4 real(const double* values, int count) { return among(read(values), count, 0); }
    static V4 state(const double* values, int count, double otherwise) { return among(read(values), count, otherwise); }
    static void read_shapes(const double* shapes, int count, V4* shape) {
        V4 row[4];
        for (int i = 0; i < 4; ++i) row[i] = read(shapes + 4 * i);
        transpose(row, shape);
        for (int a = 0; a < 4; ++a) shape[a] = among(shape[a], count, 0);
    }
    static void read_shift(const double* values, V4* shift) {
        const V4 first = read(values), second = read(values + 4);
        shift[0] = V4{first[0], first[2], second[0], second[2]};
        shift[1] = V4{first[1], first[3], second[1], second[3]};
    }
    // Those beyond the last are overwritten by the next points, or lie behind the array's end.
    static void store(double* values, V4 value) { __builtin_memcpy(values, &value, sizeof value); }
};

template <class V>
struct PointBatch {
    typename Points<V>::Real shape[4], linear[2], scale;  // scale: barrier level to eps
    typename Points<V>::Values d[2], gap, lambda, friction;
};

// Offset that the values at the nodes of an element amount to at contact points of pair p.
template <class Real, class V, class Values>
inline void offset_at(const Real* shape, int p, const V* proximal, const V* distal, Values* d) {
    for (int plane = 0; plane < 2; ++plane)
        d[plane] = zero_of(Values{}) + shape[0] * proximal[offset_index(p, plane)] + shape[1] * proximal[slope_index(p, plane)] +
                   shape[2] * distal[offset_index(p, plane)] + shape[3] * distal[slope_index(p, plane)];
}

template <class V>
inline PointBatch<V> read_points(const KernelProblem& pb, const KernelState& st, int k, int count, const V* proximal, const V* distal) {
    typedef Points<V> Read;
    const int p = pb.contact_pair[k];
    PointBatch<V> at;
    Read::read_shapes(pb.contact_shape + 4 * k, count, at.shape);
    at.linear[1] = Read::real(pb.contact_xi + k, count);
    at.linear[0] = 1.0 - at.linear[1];
    at.scale = pb.barrier_scale[p] * Read::real(pb.contact_weight + k, count);
    at.lambda = Read::state(lanes<V>(st.multiplier) + k, count, 0);
    at.friction = Read::state(lanes<V>(st.phi_mu) + k, count, 0);
    offset_at(at.shape, p, proximal, distal, at.d);
    if (st.shift) {
        typename Read::Values shift[2];
        Read::read_shift(reinterpret_cast<const V*>(st.shift) + 2 * k, shift);
        for (int plane = 0; plane < 2; ++plane) at.d[plane] += shift[plane];
    }
    at.gap = pb.half_square_clearance[p] - 0.5 * (at.d[0] * at.d[0] + at.d[1] * at.d[1]);
    return at;
}

// Points in the batch that begins with contact k.
template <class V>
inline int batch_size(const KernelProblem& pb, int k, int end) {
    int count = 1;
    while (count < Points<V>::width && k + count < end && pb.contact_pair[k + count] == pb.contact_pair[k]) ++count;
    return count;
}

// Work with the first contact and the number of points of every batch in an element.
template <class V, class Work>
__attribute__((always_inline)) inline void each_batch(const KernelProblem& pb, int e, const Work& work) {
    const int end = pb.contact_begin[e + 1];
    for (int k = pb.contact_begin[e], count; k < end; k += count) work(k, count = batch_size<V>(pb, k, end));
}

// Whether any of a batch has friction; several states differ in that.
template <class V>
inline bool rubs(const PointBatch<V>&) {
    return true;
}
inline bool rubs(const PointBatch<double>& at) {
    return at.friction[0] != 0 || at.friction[1] != 0 || at.friction[2] != 0 || at.friction[3] != 0;
}

// Of errors at the points of a batch: those that there are, and the largest in a lane.
template <class V>
inline typename Points<V>::Values among_points(typename Points<V>::Values values, int) {
    return values;
}
template <>
inline V4 among_points<double>(V4 values, int count) { return Points<double>::among(values, count, 0); }
template <class V>
inline double largest_of(typename Points<V>::Values values, int lane) {
    return values[lane];
}
template <>
inline double largest_of<double>(V4 values, int) { return larger(larger(values[0], values[1]), larger(values[2], values[3])); }
