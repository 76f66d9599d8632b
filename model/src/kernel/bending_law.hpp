// How a cross section bends where tubes soften, are oval, or are loaded: moments, tangents, and the common curvature.
// Included inside anonymous namespaces, by the kernels and by shape/bending.cpp: no std::, no Eigen.

// A tube's cross section: its moment as a curvature vector in the twist-free frame, and the derivatives of the moment.
template <class V>
struct BentSection {
    V sine, cosine;      // of the angle of its first oval axis
    V curved[2];         // precurvature along the oval axes, 1/m
    V moment[2];         // N m
    V tangent[3];        // d moment / d curvature: xx, xy, yy
    V share;             // f, of the stiffness that is left of the moment
    V by_angle[2];       // d moment / d theta; also minus the derivative of the torque by the curvature
};

template <class V>
inline void turn_section(const BendingLaw& law, const double* v, V theta, BentSection<V>& section) {
    double sine, cosine;
    sine_cosine<double>(law.axis, sine, cosine);
    section.curved[0] = broadcast<V>(cosine * v[0] + sine * v[1]);
    section.curved[1] = broadcast<V>(cosine * v[1] - sine * v[0]);
    sine_cosine<V>(theta + law.axis, section.sine, section.cosine);
}

// moment = EI f D k with k = R^T kappa - v along the oval axes, D = diag(1 + e, 1 - e) and f = 1 up to the knee of
// sqrt(k . D k), beyond it the share that keeps the tangent at `fraction`: the gradient of an energy.
template <class V>
inline void bend(const BendingLaw& law, const V* kappa, BentSection<V>& section) {
    const V c = section.cosine, s = section.sine, zero = zero_of(V{});
    const V k0 = c * kappa[0] + s * kappa[1] - section.curved[0], k1 = c * kappa[1] - s * kappa[0] - section.curved[1];
    const double stiff = 1 + law.ovality, soft = 1 - law.ovality;
    const V n0 = stiff * k0, n1 = soft * k1;
    const V square = k0 * n0 + k1 * n1;
    const V knee = zero + law.knee, knee_square = knee * knee;
    const V bent = root(larger(square, knee_square));  // the knee itself below it
    const V f = law.fraction + (1 - law.fraction) * (knee / bent);
    const V drop = (1 - law.fraction) * knee / (bent * bent * bent);
    const V falls = square > knee_square ? drop : zero;  // -f' / |k|_D
    section.share = f;
    const double EI = law.stiffness;
    const V m0 = EI * (f * n0), m1 = EI * (f * n1);
    section.moment[0] = c * m0 - s * m1;
    section.moment[1] = s * m0 + c * m1;
    const V t00 = EI * (f * stiff - falls * n0 * n0), t01 = -EI * (falls * n0 * n1), t11 = EI * (f * soft - falls * n1 * n1);
    section.tangent[0] = c * c * t00 - 2.0 * c * s * t01 + s * s * t11;
    section.tangent[1] = c * s * (t00 - t11) + (c * c - s * s) * t01;
    section.tangent[2] = s * s * t00 + 2.0 * c * s * t01 + c * c * t11;
    // J moment - tangent J kappa
    section.by_angle[0] = -section.moment[1] + section.tangent[0] * kappa[1] - section.tangent[1] * kappa[0];
    section.by_angle[1] = section.moment[0] + section.tangent[1] * kappa[1] - section.tangent[2] * kappa[0];
}

// What adds to the mean curvature if every tube kept its secant stiffness f EI D: the energies are concave in the square of
// the curvature, so that this step lowers their sum from wherever it starts.
template <class V>
inline void secant_step(int M, const BendingLaw* law, const BentSection<V>* section, const V* missing, V* step) {
    const V zero = zero_of(V{});
    V sum[3] = {zero, zero, zero};
    for (int t = 0; t < M; ++t) {
        const V c = section[t].cosine, s = section[t].sine, kept = law[t].stiffness * section[t].share;
        const V stiff = kept * (1 + law[t].ovality), soft = kept * (1 - law[t].ovality);
        sum[0] += c * c * stiff + s * s * soft;
        sum[1] += c * s * (stiff - soft);
        sum[2] += s * s * stiff + c * c * soft;
    }
    const V over = 1.0 / (sum[0] * sum[2] - sum[1] * sum[1]);
    step[0] = over * (sum[2] * missing[0] - sum[1] * missing[1]);
    step[1] = over * (sum[0] * missing[1] - sum[1] * missing[0]);
}

// Curvature `mean` of the outermost tube at which the moments of all M tubes add up to the load's, where a convex energy is
// least: Newton's method, exact after one step where nothing softens, by secant stiffnesses where that does not come nearer.
// against[t]: curvature of tube t against the outermost. Leaves the sections bent and the inverse of the sum of tangents
// (xx, xy, yy).
template <class V>
inline void free_mean(int M, const BendingLaw* law, const V (*against)[2], const V* load, BentSection<V>* section, V* mean,
                      V* inverse) {
    constexpr int kMost = 60;
    const V zero = zero_of(V{});
    double total = 0;
    mean[0] = load[0];
    mean[1] = load[1];
    for (int t = 0; t < M; ++t) {
        const BentSection<V>& at = section[t];
        const double EI = law[t].stiffness;
        total += EI;
        mean[0] += EI * (at.cosine * at.curved[0] - at.sine * at.curved[1] - against[t][0]);
        mean[1] += EI * (at.sine * at.curved[0] + at.cosine * at.curved[1] - against[t][1]);
    }
    mean[0] *= 1 / total;
    mean[1] *= 1 / total;
    V least = zero + 1e300;
    for (int step = 0;; ++step) {
        V missing[2] = {load[0], load[1]}, sum[3] = {zero, zero, zero};
        for (int t = 0; t < M; ++t) {
            const V kappa[2] = {mean[0] + against[t][0], mean[1] + against[t][1]};
            bend(law[t], kappa, section[t]);
            for (int i = 0; i < 2; ++i) missing[i] -= section[t].moment[i];
            for (int i = 0; i < 3; ++i) sum[i] += section[t].tangent[i];
        }
        const V over = 1.0 / (sum[0] * sum[2] - sum[1] * sum[1]);
        inverse[0] = sum[2] * over;
        inverse[1] = -sum[1] * over;
        inverse[2] = sum[0] * over;
        const V worst = larger(magnitude(missing[0]), magnitude(missing[1]));
        bool settled = true, nearer = true;
        for (int lane = 0; lane < Lane<V>::count; ++lane) {
            settled = settled && Lane<V>::at(worst, lane) < 1e-13 * total;
            nearer = nearer && Lane<V>::at(worst, lane) <= 0.5 * Lane<V>::at(least, lane);
        }
        if (settled || step == kMost) return;
        V by[2] = {inverse[0] * missing[0] + inverse[1] * missing[1], inverse[1] * missing[0] + inverse[2] * missing[1]};
        if (!nearer) {
            V safe[2];
            secant_step(M, law, section, missing, safe);
            for (int i = 0; i < 2; ++i) by[i] = worst <= 0.5 * least ? by[i] : safe[i];
        }
        least = worst < least ? worst : least;
        mean[0] += by[0];
        mean[1] += by[1];
    }
}
