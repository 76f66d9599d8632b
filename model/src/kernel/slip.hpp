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

// Derivative of the friction force and torques by phi, times that of phi by the unknowns.
template <class V>
inline void add_slip_tangent(const KernelProblem& pb, const KernelState& st, int e, const ElementView<V>& el) {
    const SlipLaw& law = *st.slip;
    const int ld = el.ld;
    for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k) {
        const double slope = slip_at<V>(pb, law, k, el).slope * law.friction[k];
        if (slope == 0) continue;
        const int p = pb.contact_pair[k], inner = theta_index(p), outer = theta_index(p + 1);
        const double* shape = pb.contact_shape + 4 * k;
        const double linear[2] = {1 - pb.contact_xi[k], pb.contact_xi[k]};
        const ContactPoint<V> at = contact_point<V>(pb, k, el.x[0], el.x[1]);
        const V lambda = lanes<V>(st.multiplier)[k], load = slope * lambda;
        const V square = at.d[0] * at.d[0] + at.d[1] * at.d[1];
        // twelve unknowns: per node theta_in, theta_out, and the Hermite values and slopes of d
        int index[12];
        V force[12], slips[12];
        for (int a = 0; a < 2; ++a) {
            const int at_in = 6 * a, at_out = 6 * a + 1;
            index[at_in] = inner;
            index[at_out] = outer;
            force[at_in] = pb.inner_torque_arm[p] * linear[a] * load * square;
            force[at_out] = -pb.outer_torque_arm[p] * linear[a] * load * square;
            slips[at_in] = zero_of(V{}) + law.inner_arm[p] * linear[a];
            slips[at_out] = zero_of(V{}) - law.outer_arm[p] * linear[a];
            for (int b = 0; b < 2; ++b)
                for (int plane = 0; plane < 2; ++plane) {
                    const int i = 6 * a + 2 + 2 * b + plane;
                    index[i] = b ? slope_index(p, plane) : offset_index(p, plane);
                    force[i] = shape[2 * a + b] * load * (plane ? at.d[0] : -at.d[1]);  // J d
                    slips[i] = zero_of(V{}) + shape[2 * a + b] * law.across[2 * k + plane];
                }
        }
        for (int i = 0; i < 12; ++i)
            for (int j = 0; j < 12; ++j) el.block[i / 6][j / 6][index[i] * ld + index[j]] += force[i] * slips[j];
    }
}
