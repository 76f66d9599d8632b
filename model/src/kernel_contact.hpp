// Contact and friction forces of an element.
// Part of the kernels (kernel_body.hpp): included inside an anonymous namespace, no std::, no Eigen.

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

// What the contact points of one pair add up to in an element, before it is spread over the blocks.
template <class V>
struct PairSums {
    V force[4][2];          // per Hermite function and plane
    V torque[2];            // per node, over the torque arm
    V tangent[10][2][2];    // per pair of Hermite functions a <= b: sum N_a N_b T
    V slope[2][4][2];       // per node and Hermite function: derivative of the torque by the offset
};

// Adds N_a N_b T of one contact point; for a single lane all of T at once.
inline void add_tangent(const double* shape, const V4 (&T)[2][2], PairSums<V4>& sums) {
    int ab = 0;
    for (int a = 0; a < 4; ++a)
        for (int b = a; b < 4; ++b, ++ab) {
            const double product = shape[a] * shape[b];
            for (int row = 0; row < 2; ++row)
                for (int plane = 0; plane < 2; ++plane) sums.tangent[ab][row][plane] += product * T[row][plane];
        }
}

inline void add_tangent(const double* shape, const double (&T)[2][2], PairSums<double>& sums) {
    V4 all;
    __builtin_memcpy(&all, T, sizeof all);
    int ab = 0;
    for (int a = 0; a < 4; ++a)
        for (int b = a; b < 4; ++b, ++ab) {
            V4 sum;
            __builtin_memcpy(&sum, sums.tangent[ab], sizeof sum);
            sum += (shape[a] * shape[b]) * all;
            __builtin_memcpy(sums.tangent[ab], &sum, sizeof sum);
        }
}

inline bool rubs(double friction) { return friction != 0; }
inline bool rubs(V4) { return true; }

// Contact forces of one element. The gap w = (c^2 - |d|^2) / 2 has a slack variable of its own, so that contact points may
// slide around the bore in one step; `value` is the iterate's multiplier for the true residual, and in a Newton step what
// eliminating multiplier and slack leaves of it. The primal-dual derivative follows if MATRIX.
template <class V, bool MATRIX>
inline void sum_contact(const KernelProblem& pb, const KernelState& st, int k, const ElementView<V>& el, V level, PairSums<V>& sums) {
    const int p = pb.contact_pair[k];
    const double* shape = pb.contact_shape + 4 * k;
    const double linear[2] = {1 - pb.contact_xi[k], pb.contact_xi[k]};
    const V lambda = lanes<V>(st.multiplier)[k], friction = lanes<V>(st.phi_mu)[k];
    const ContactPoint<V> at = contact_point<V>(pb, st, k, el.x[0], el.x[1]);
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
    add_tangent(shape, T, sums);
    if (!rubs(friction)) return;
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
