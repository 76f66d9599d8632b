// Contact and friction forces of an element.
// Part of the kernels (kernel/body.hpp): included inside an anonymous namespace, no std::, no Eigen.

// What the contact points of one pair add up to in an element, before it is spread over the blocks.
template <class V>
struct PairSums {
    V force[4][2];          // per Hermite function and plane
    V torque[2];            // per node, over the torque arm
    V tangent[10][2][2];    // per pair of Hermite functions a <= b: sum N_a N_b T
    V slope[2][4][2];       // per node and Hermite function: derivative of the torque by the offset
};

// Contact forces of a batch. The gap w = (c^2 - |d|^2) / 2 has a slack variable of its own, so that contact points may
// slide around the bore in one step; `value` is the iterate's multiplier for the true residual, and in a Newton step what
// eliminating multiplier and slack leaves of it. The primal-dual derivative follows if MATRIX.
template <class V, bool MATRIX>
inline void sum_contacts(const PointBatch<V>& at, typename Points<V>::Values slack, typename Points<V>::Values level, bool rubs,
                         PairSums<typename Points<V>::Values>& sums) {
    typedef typename Points<V>::Values W;
    W value = at.lambda, ratio = zero_of(W{});
    if (MATRIX) {
        const W inverse_slack = 1.0 / slack;
        ratio = at.lambda * inverse_slack;
        value = level * at.scale * inverse_slack + ratio * (slack - at.gap);
    }
    const W g[2] = {at.d[0] - at.friction * at.d[1], at.d[1] + at.friction * at.d[0]};  // (I + phi mu J) d
    CTR_UNROLL
    for (int plane = 0; plane < 2; ++plane) {
        const W force = value * g[plane];
        CTR_UNROLL
        for (int a = 0; a < 4; ++a) sums.force[a][plane] += at.shape[a] * force;
    }
    const W square = at.d[0] * at.d[0] + at.d[1] * at.d[1];
    if (rubs) {
        const W torque = at.friction * value * square;
        CTR_UNROLL
        for (int a = 0; a < 2; ++a) sums.torque[a] += at.linear[a] * torque;
    }
    if (!MATRIX) return;
    const W T[2][2] = {{at.lambda + ratio * g[0] * at.d[0], ratio * g[0] * at.d[1] - at.lambda * at.friction},
                        {ratio * g[1] * at.d[0] + at.lambda * at.friction, at.lambda + ratio * g[1] * at.d[1]}};
    int ab = 0;
    CTR_UNROLL
    for (int a = 0; a < 4; ++a)
        CTR_UNROLL
        for (int b = a; b < 4; ++b, ++ab) {
            const auto product = at.shape[a] * at.shape[b];
            CTR_UNROLL
            for (int row = 0; row < 2; ++row)
                CTR_UNROLL
                for (int plane = 0; plane < 2; ++plane) sums.tangent[ab][row][plane] += product * T[row][plane];
        }
    if (!rubs) return;
    const W torque_slope = at.friction * (ratio * square + 2.0 * at.lambda);
    CTR_UNROLL
    for (int plane = 0; plane < 2; ++plane) {
        const W slope = torque_slope * at.d[plane];
        CTR_UNROLL
        for (int b = 0; b < 4; ++b) {
            const W s = at.shape[b] * slope;
            CTR_UNROLL
            for (int a = 0; a < 2; ++a) sums.slope[a][b][plane] += at.linear[a] * s;
        }
    }
}

// Sums over the points of batches, where a batch has several.
template <bool MATRIX, class V>
inline const PairSums<V>& summed(const PairSums<V>& sums, bool, PairSums<V>&) {
    return sums;
}
template <bool MATRIX>
inline const PairSums<double>& summed(const PairSums<V4>& sums, bool rubs, PairSums<double>& out) {
    sum_lanes(&sums.force[0][0], 8, &out.force[0][0]);
    if (MATRIX) sum_lanes(&sums.tangent[0][0][0], 40, &out.tangent[0][0][0]);
    if (!rubs) return out;
    sum_lanes(sums.torque, 2, out.torque);
    if (MATRIX) sum_lanes(&sums.slope[0][0][0], 16, &out.slope[0][0][0]);
    return out;
}

// Place of the pair of Hermite functions (a, b) among those with a <= b.
constexpr int place(int a, int b) { return a <= b ? a * 4 - a * (a - 1) / 2 + b - a : place(b, a); }

// Row `row` of function a (2 node + 0 offset, 1 slope) of sum N_a N_b T, with both functions b of a node, is added to `to`.
template <class V>
inline void add_tangent_row(const PairSums<V>& sums, int a, int node, int row, V* to) {
    CTR_UNROLL
    for (int b = 0; b < 2; ++b)
        CTR_UNROLL
        for (int plane = 0; plane < 2; ++plane) to[2 * b + plane] += sums.tangent[place(a, 2 * node + b)][row][plane];
}
inline void add_tangent_row(const PairSums<double>& sums, int a, int node, int row, double* to) {
    const double *offset = sums.tangent[place(a, 2 * node)][row], *slope = sums.tangent[place(a, 2 * node + 1)][row];
    Quad<double>::add(to, V4{offset[0], offset[1], slope[0], slope[1]});
}

// Adds factor times the four values of a pair's offsets and slopes at a node.
template <class V>
inline void add_quad(double factor, const V* values, V* to) {
    CTR_UNROLL
    for (int i = 0; i < 4; ++i) to[i] += factor * values[i];
}
inline void add_quad(double factor, const double* values, double* to) { Quad<double>::add(to, factor * Points<double>::read(values)); }

template <class V, bool MATRIX>
inline void spread_contacts(const KernelProblem& pb, int p, bool rubs, const ElementView<V>& el, const PairSums<V>& sums) {
    const int ld = el.ld, outer = theta_index(p + 1), inner = theta_index(p), first = offset_index(p, 0);
    const double arm_out = pb.outer_torque_arm[p], arm_in = pb.inner_torque_arm[p];
    CTR_UNROLL
    for (int node = 0; node < 2; ++node) add_quad(1, sums.force[2 * node], el.r[node] + first);
    if (MATRIX)
        CTR_UNROLL
        for (int a = 0; a < 4; ++a)
            CTR_UNROLL
            for (int node = 0; node < 2; ++node)
                CTR_UNROLL
                for (int row = 0; row < 2; ++row)
                    add_tangent_row(sums, a, node, row, el.block[a >> 1][node] + (first + 2 * (a & 1) + row) * ld + first);
    if (!rubs) return;
    CTR_UNROLL
    for (int a = 0; a < 2; ++a) {
        el.r[a][outer] -= arm_out * sums.torque[a];
        el.r[a][inner] += arm_in * sums.torque[a];
        CTR_UNROLL
        for (int node = 0; MATRIX && node < 2; ++node) {
            add_quad(-arm_out, sums.slope[a][2 * node], el.block[a][node] + outer * ld + first);
            add_quad(arm_in, sums.slope[a][2 * node], el.block[a][node] + inner * ld + first);
        }
    }
}

// Spreads what `add` sums up of the batches of an element, pair by pair; it says whether there is friction.
template <class V, bool MATRIX, class Add>
__attribute__((always_inline)) inline void spread_pairs(const KernelProblem& pb, int e, const ElementView<V>& el, const Add& add) {
    typedef typename Points<V>::Values W;
    constexpr int used = MATRIX ? sizeof(PairSums<W>) / sizeof(W) : 10;
    static_assert(__builtin_offsetof(PairSums<V4>, tangent) == 10 * sizeof(V4));
    const int end = pb.contact_begin[e + 1];
    PairSums<V> total;
    for (int k = pb.contact_begin[e]; k < end;) {
        const int pair = pb.contact_pair[k];
        bool rubbing = false;
        PairSums<W> sums;
        clear(reinterpret_cast<W*>(&sums), used);
        while (k < end && pb.contact_pair[k] == pair) {
            const int count = batch_size<V>(pb, k, end);
            if (add(k, count, sums)) rubbing = true;
            k += count;
        }
        spread_contacts<V, MATRIX>(pb, pair, rubbing, el, summed<MATRIX>(sums, rubbing, total));
    }
}

template <class V, bool MATRIX>
inline void add_contacts(const KernelProblem& pb, const KernelState& st, int e, const ElementView<V>& el, const V* level) {
    typedef typename Points<V>::Values W;
    spread_pairs<V, MATRIX>(pb, e, el, [&](int k, int count, PairSums<W>& sums) __attribute__((always_inline)) {
        const PointBatch<V> at = read_points<V>(pb, st, k, count, el.x[0], el.x[1]);
        const bool rubbing = rubs(at);
        sum_contacts<V, MATRIX>(at, Points<V>::state(lanes<V>(st.slack) + k, count, 1), zero_of(W{}) + level[0], rubbing, sums);
        return rubbing;
    });
}

// What the contacts of an element do beyond first order when they move by the step: the gap is quadratic in the offset,
// complementarity, forces and torques have products of multiplier, slack and offset.
template <class V>
inline void add_second_order(const KernelProblem& pb, const KernelState& st, int e, const ElementView<V>& el) {
    const int ld = pb.stride;
    const V* step = lanes<V>(st.step) + e * ld;
    typedef typename Points<V>::Values W;
    spread_pairs<V, false>(pb, e, el, [&](int k, int count, PairSums<W>& sums) __attribute__((always_inline)) {
        const PointBatch<V> at = read_points<V>(pb, st, k, count, el.x[0], el.x[1]);
        const W slack = Points<V>::state(lanes<V>(st.slack) + k, count, 1), wider = Points<V>::state(lanes<V>(st.slack_step) + k, count, 0);
        const W change = Points<V>::state(lanes<V>(st.multiplier_step) + k, count, 0);
        W move[2], push[2];
        offset_at(at.shape, pb.contact_pair[k], step, step + ld, move);
        const W moved = move[0] * move[0] + move[1] * move[1];
        const W value = (0.5 * at.lambda * moved - change * wider) / slack;
        for (int plane = 0; plane < 2; ++plane) push[plane] = value * at.d[plane] + change * move[plane];
        const W force[2] = {push[0] - at.friction * push[1], push[1] + at.friction * push[0]};
        CTR_UNROLL
        for (int a = 0; a < 4; ++a)
            for (int plane = 0; plane < 2; ++plane) sums.force[a][plane] += at.shape[a] * force[plane];
        if (!rubs(at)) return false;
        const W torque = at.friction * (value * (at.d[0] * at.d[0] + at.d[1] * at.d[1]) + at.lambda * moved +
                                         2.0 * change * (at.d[0] * move[0] + at.d[1] * move[1]));
        for (int a = 0; a < 2; ++a) sums.torque[a] += at.linear[a] * torque;
        return true;
    });
}
