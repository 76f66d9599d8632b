// Friction that follows the slip of a step, and what that adds to the Newton matrix.
// Part of the kernels (kernel/body.hpp): included inside an anonymous namespace, no std::, no Eigen.

struct Slip {
    double value;      // circumferential, m
    double phi;        // after the return to the unit disc
    double slope;      // d phi / d slip, 1/m
};

template <class V>
inline Slip slip_at(const KernelProblem& pb, const SlipLaw& law, int k, const ElementView<V>& el) {
    const int p = pb.contact_pair[k], inner = theta_index(p), outer = theta_index(p + 1);
    const double xi = pb.contact_xi[k];
    const ContactPoint<V> at = contact_point<V>(pb, k, el.x[0], el.x[1]);
    const double theta_in = Lane<V>::at((1 - xi) * el.x[0][inner] + xi * el.x[1][inner], 0);
    const double theta_out = Lane<V>::at((1 - xi) * el.x[0][outer] + xi * el.x[1][outer], 0);
    Slip slip;
    slip.value = law.inner_arm[p] * theta_in - law.outer_arm[p] * theta_out + law.across[2 * k] * Lane<V>::at(at.d[0], 0) +
                 law.across[2 * k + 1] * Lane<V>::at(at.d[1], 0) - law.reference[k];
    const double trial = law.phi[k] + slip.value / law.breakaway;
    const double norm = root(trial * trial + law.psi[k] * law.psi[k]);
    if (norm <= 1) {
        slip.phi = trial;
        slip.slope = 1 / law.breakaway;
    } else {
        slip.phi = trial / norm;
        slip.slope = law.psi[k] * law.psi[k] / (norm * norm * norm * law.breakaway);
    }
    return slip;
}

// Brings the friction of an element's contacts up to date.
template <class V>
inline void follow_slip(const KernelProblem& pb, const KernelState& st, int e, const ElementView<V>& el) {
    for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k)
        lanes<V>(st.phi_mu)[k] = zero_of(V{}) + st.slip->friction[k] * slip_at<V>(pb, *st.slip, k, el).phi;
}

// Derivative of the friction force and torques by phi, times that of phi by the unknowns: of each pair with its contacts in the
// element. Six neighbours per node are concerned: theta_in, both offsets, both slopes, theta_out.
template <class V>
inline void add_slip_tangent(const KernelProblem& pb, const KernelState& st, int e, const ElementView<V>& el) {
    constexpr int own = 6, all = 2 * own;
    const SlipLaw& law = *st.slip;
    const int end = pb.contact_begin[e + 1];
    for (int k = pb.contact_begin[e]; k < end;) {
        const int p = pb.contact_pair[k], first = theta_index(p);
        V sum[all][all];
        for (int i = 0; i < all; ++i)
            for (int j = 0; j < all; ++j) sum[i][j] = zero_of(V{});
        for (; k < end && pb.contact_pair[k] == p; ++k) {
            const double slope = slip_at<V>(pb, law, k, el).slope * law.friction[k];
            if (slope == 0) continue;
            const double* shape = pb.contact_shape + 4 * k;
            const double linear[2] = {1 - pb.contact_xi[k], pb.contact_xi[k]};
            const ContactPoint<V> at = contact_point<V>(pb, k, el.x[0], el.x[1]);
            const V load = slope * lanes<V>(st.multiplier)[k];
            const V square = at.d[0] * at.d[0] + at.d[1] * at.d[1];
            const V turned[2] = {-at.d[1], at.d[0]};  // J d
            V force[all];
            double slips[all];
            for (int a = 0; a < 2; ++a) {
                V* f = force + own * a;
                double* s = slips + own * a;
                f[0] = pb.inner_torque_arm[p] * linear[a] * load * square;
                s[0] = law.inner_arm[p] * linear[a];
                for (int b = 0; b < 2; ++b)
                    for (int plane = 0; plane < 2; ++plane) {
                        f[1 + 2 * b + plane] = shape[2 * a + b] * load * turned[plane];
                        s[1 + 2 * b + plane] = shape[2 * a + b] * law.across[2 * k + plane];
                    }
                f[5] = -pb.outer_torque_arm[p] * linear[a] * load * square;
                s[5] = -law.outer_arm[p] * linear[a];
            }
            for (int i = 0; i < all; ++i)
                for (int j = 0; j < all; ++j) sum[i][j] += force[i] * slips[j];
        }
        for (int a = 0; a < 2; ++a)
            for (int c = 0; c < 2; ++c)
                for (int i = 0; i < own; ++i) {
                    V* row = el.block[a][c] + (first + i) * el.ld + first;
                    for (int j = 0; j < own; ++j) row[j] += sum[own * a + i][own * c + j];
                }
    }
}
