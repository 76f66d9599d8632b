// Body of the kernels, included by one translation unit per instruction set inside an anonymous namespace.
// No std::, no Eigen, no functions shared with other translation units (see kernel.hpp).
#include "kernel/lanes.hpp"
#include "mesh/element_functions.hpp"
#include "kernel/elastic.hpp"
#include "kernel/bending_law.hpp"
#include "kernel/softened.hpp"
#include "kernel/contact_points.hpp"
#include "kernel/contact_forces.hpp"
#include "kernel/slip.hpp"
#include "kernel/elimination.hpp"

template <class V, bool MATRIX>
inline void add_element(const KernelProblem& pb, const KernelState& st, int e, const ElementView<V>& el, const V* level,
                        const V* damping) {
    const int m = pb.element_tubes[e];
    const bool free = pb.element_unknowns[e] == 5 * m;
    if (pb.law) add_softened<V, MATRIX>(pb, st, e, el);
    else switch (free ? -m : m) {
        case 1: add_elastic<V, MATRIX>(1, 0, pb, e, el); break;
        case 2: add_elastic<V, MATRIX>(2, 1, pb, e, el); break;
        case 3: add_elastic<V, MATRIX>(3, 2, pb, e, el); break;
        case 4: add_elastic<V, MATRIX>(4, 3, pb, e, el); break;
        case -1: add_elastic<V, MATRIX>(1, 1, pb, e, el); break;
        case -2: add_elastic<V, MATRIX>(2, 2, pb, e, el); break;
        case -3: add_elastic<V, MATRIX>(3, 3, pb, e, el); break;
        default: add_elastic<V, MATRIX>(m, free ? m : m - 1, pb, e, el);
    }
    if (st.slip) follow_slip<V>(pb, st, e, el);
    add_contacts<V, MATRIX>(pb, st, e, el, level);
    if (MATRIX && st.slip) add_slip_tangent<V>(pb, st, e, el);
    if (!MATRIX || !st.anchor) return;
    for (int t = 0; t < m; ++t) {  // lumped, so that it never couples nodes
        const V mass = damping[0] * (0.5 * pb.length[e] * pb.torsional_stiffness[t]);
        const int i = theta_index(t);
        for (int a = 0; a < 2; ++a) {
            el.r[a][i] += mass * (el.x[a][i] - lanes<V>(st.anchor)[(e + a) * pb.stride + i]);
            el.block[a][a][i * (el.ld + 1)] += mass;
        }
    }
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

template <class V>
inline void start_residual(const KernelProblem& pb, const KernelState& st) {
    V* r = lanes<V>(st.rhs);
    const int count = pb.nodes * pb.stride;
    if (st.load) {
        const V* load = reinterpret_cast<const V*>(st.load);
        for (int i = 0; i < count; ++i) r[i] = load[i];
    } else {
        clear(r, count);
    }
    if (pb.law) r[count - pb.stride] -= reinterpret_cast<const V*>(st.load_moment)[pb.elements * 4 * pb.tubes];
}

// Slack and multiplier steps that belong to `step`: w + dw = gap - d . delta, lambda dw + w dlambda = eps - lambda w.
template <class V>
void recover_multipliers(const KernelProblem& pb, const KernelState& st, const V* level) {
    const int ld = pb.stride;
    const V *x = lanes<V>(st.unknowns), *step = lanes<V>(st.step), *slack = lanes<V>(st.slack);
    V *change = lanes<V>(st.multiplier_step), *slack_change = lanes<V>(st.slack_step);
    for (int e = 0; e < pb.elements; ++e)
        each_batch<V>(pb, e, [&](int k, int count) __attribute__((always_inline)) {
            const PointBatch<V> at = read_points<V>(pb, st, k, count, x + e * ld, x + (e + 1) * ld);
            const typename Points<V>::Values w = Points<V>::state(slack + k, count, 1);
            typename Points<V>::Values move[2];
            offset_at(at.shape, pb.contact_pair[k], step + e * ld, step + (e + 1) * ld, move);
            const auto wider = at.gap - w - (at.d[0] * move[0] + at.d[1] * move[1]);
            Points<V>::store(slack_change + k, wider);
            Points<V>::store(change + k, (level[0] * at.scale - at.lambda * wider) / w - at.lambda);
        });
}

template <class V>
void back_substitute(const KernelProblem& pb, const KernelState& st) {
    const int stride = pb.stride, ld = st.block_stride, square = stride * ld;
    const V *r = lanes<V>(st.rhs), *U = lanes<V>(st.upper);
    V* step = lanes<V>(st.step);
    for (int k = pb.nodes - 1; k >= 0; --k) {
        const int P = pb.node_unknowns[k];
        const int Q = k + 1 < pb.nodes ? pb.element_unknowns[k] : 0;
        for (int i = 0; i < stride; ++i) step[k * stride + i] = i < P ? -r[k * stride + i] : zero_of(V{});
        if (Q > 0) subtract_product(U + k * square, step + (k + 1) * stride, step + k * stride, ld, P, Q);
    }
}

template <class V>
void newton(const KernelProblem& pb, const KernelState& st, const double* level_values, const double* damping_values) {
    const int stride = pb.stride, ld = st.block_stride, square = stride * ld;
    V level = zero_of(V{}), damping = zero_of(V{});
    for (int lane = 0; lane < Lane<V>::count; ++lane) {
        Lane<V>::at(level, lane) = level_values[lane];
        if (st.anchor) Lane<V>::at(damping, lane) = damping_values[lane];
    }
    V *r = lanes<V>(st.rhs), *A = lanes<V>(st.diagonal), *U = lanes<V>(st.upper), *L = lanes<V>(st.lower);
    start_residual<V>(pb, st);
    clear(A, square);
    for (int e = 0; e < pb.elements; ++e) {
        const int rows = pb.element_unknowns[e] * ld;
        clear(A + (e + 1) * square, pb.node_unknowns[e + 1] * ld);
        clear(U + e * square, pb.node_unknowns[e] * ld);
        clear(L + e * square, rows);
        add_element<V, true>(pb, st, e, view<V>(pb, st, e), &level, &damping);
        eliminate<V>(A + e * square, U + e * square, r + e * stride, L + e * square, A + (e + 1) * square,
                     r + (e + 1) * stride, ld, pb.node_unknowns[e], pb.element_unknowns[e]);
    }
    const int last = pb.nodes - 1;
    factorise<V>(A + last * square, ld, pb.node_unknowns[last]);
    apply_factors(A + last * square, r + last * stride, ld, pb.node_unknowns[last]);
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
        apply_factors(A + k * square, b, ld, P);
        if (k + 1 == pb.nodes) break;
        subtract_product(L + k * square, b, r + (k + 1) * stride, ld, pb.element_unknowns[k], P);
    }
    back_substitute<V>(pb, st);
}

// The step of newton() in `st`, corrected with the same factors by what contacts add at second order.
template <class V>
void correct(const KernelProblem& pb, const KernelState& st, const KernelState& corrected) {
    const int stride = pb.stride, count = pb.nodes * stride;
    const V *x = lanes<V>(st.unknowns), *step = lanes<V>(st.step), *slack = lanes<V>(st.slack);
    const V *change = lanes<V>(st.multiplier_step), *wider = lanes<V>(st.slack_step);
    V *more = lanes<V>(corrected.step), *new_change = lanes<V>(corrected.multiplier_step), *new_wider = lanes<V>(corrected.slack_step);
    clear(lanes<V>(st.rhs), count);
    for (int e = 0; e < pb.elements; ++e) add_second_order<V>(pb, st, e, view<V>(pb, st, e));
    solve<V>(pb, corrected);
    for (int e = 0; e < pb.elements; ++e)
        each_batch<V>(pb, e, [&](int k, int points) __attribute__((always_inline)) {
            const int here = e * stride, next = here + stride, p = pb.contact_pair[k];
            const PointBatch<V> at = read_points<V>(pb, st, k, points, x + here, x + next);
            const auto dw = Points<V>::state(wider + k, points, 0), dlambda = Points<V>::state(change + k, points, 0);
            typename Points<V>::Values first[2], second[2];
            offset_at(at.shape, p, step + here, step + next, first);
            offset_at(at.shape, p, more + here, more + next, second);
            const auto further = -(at.d[0] * second[0] + at.d[1] * second[1]) - 0.5 * (first[0] * first[0] + first[1] * first[1]);
            Points<V>::store(new_wider + k, dw + further);
            Points<V>::store(new_change + k, dlambda - (dlambda * dw + at.lambda * further) / Points<V>::state(slack + k, points, 1));
        });
    for (int i = 0; i < count; ++i) more[i] += step[i];
}

template <class V>
void residual(const KernelProblem& pb, const KernelState& st, const double* level_values, double* moment, double* complementarity) {
    const int ld = pb.stride;
    V level = zero_of(V{});
    for (int lane = 0; lane < Lane<V>::count; ++lane) Lane<V>::at(level, lane) = level_values[lane];
    V* r = lanes<V>(st.rhs);
    start_residual<V>(pb, st);
    V worst = zero_of(V{});
    auto gap_error = zero_of(typename Points<V>::Values{});
    for (int e = 0; e < pb.elements; ++e) {
        const ElementView<V> el = view<V>(pb, st, e);
        add_element<V, false>(pb, st, e, el, &level, nullptr);
        const double h = pb.length[e];
        const int P = pb.node_unknowns[e];
        for (int i = 0; i < P; ++i) worst = larger(worst, (i % 5 == 1 || i % 5 == 2) ? h * magnitude(el.r[0][i]) : magnitude(el.r[0][i]));
        each_batch<V>(pb, e, [&](int k, int count) __attribute__((always_inline)) {
            const PointBatch<V> at = read_points<V>(pb, st, k, count, el.x[0], el.x[1]);
            const auto eps = level * at.scale;
            gap_error = larger(gap_error, among_points<V>(magnitude(at.lambda * at.gap - eps) / eps, count));
        });
    }
    const int last = pb.nodes - 1;
    const double h = pb.length[pb.elements - 1];
    for (int i = 0; i < pb.node_unknowns[last]; ++i) {
        const V value = magnitude(r[last * ld + i]);
        worst = larger(worst, (i % 5 == 1 || i % 5 == 2) ? h * value : value);
    }
    for (int lane = 0; lane < Lane<V>::count; ++lane) {
        moment[lane] = Lane<V>::at(worst, lane);
        complementarity[lane] = largest_of<V>(gap_error, lane);
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

template <class V>
void bending(const KernelProblem& pb, const double* unknowns, double* innermost, double* strain_square) {
    const V* x = lanes<V>(unknowns);
    V* out = lanes<V>(innermost);
    V largest = zero_of(V{});
    for (int e = 0; e < pb.elements; ++e) {
        const int M = pb.element_tubes[e], offsets = offsets_of(pb, e);
        const double* EI = pb.bending_stiffness + pb.element_regime[e] / 2 * pb.tubes;
        const double* radius = pb.outer_radius + pb.element_regime[e] / 2 * pb.tubes;
        double total = 0, b[4];
        for (int t = 0; t < M; ++t) total += EI[t];
        const double share = pb.element_regime[e] % 2 == 0 ? 1 / total : 0.0;  // behind the plate no bending is common
        ElementView<V> el = {};
        el.x[0] = x + e * pb.stride;
        el.x[1] = el.x[0] + pb.stride;
        Turned<V> turned;
        turn_precurvature<V>(M, pb, e, el, turned);
        V bent[2][kMaxTubes][2];
        for (int g = 0; g < 2; ++g) {
            hermite_second(kGauss[g], pb.length[e], b);
            V against[kMaxTubes][2], common[2] = {zero_of(V{}), zero_of(V{})}, running[2] = {zero_of(V{}), zero_of(V{})};
            for (int t = M - 1; t >= 0; --t)
                for (int plane = 0; plane < 2; ++plane) {
                    const int i = offset_index(t, plane), j = slope_index(t, plane);
                    if (t < offsets) running[plane] += b[0] * el.x[0][i] + b[1] * el.x[0][j] + b[2] * el.x[1][i] + b[3] * el.x[1][j];
                    against[t][plane] = running[plane] - turned.w[g][t][plane];
                    common[plane] -= (share * EI[t]) * against[t][plane];
                }
            for (int t = 0; t < M; ++t)
                for (int plane = 0; plane < 2; ++plane) bent[g][t][plane] = against[t][plane] + common[plane];
            for (int plane = 0; plane < 2; ++plane) out[4 * e + 2 * g + plane] = running[plane] + common[plane];
        }
        // linear along the element but for the twist, so that its ends are strained most
        constexpr double kBeyond = kGauss[0] / (kGauss[1] - kGauss[0]);
        for (int end = 0; end < 2; ++end)
            for (int t = 0; t < M; ++t) {
                V square = zero_of(V{});
                for (int plane = 0; plane < 2; ++plane) {
                    const V there = bent[end][t][plane] + kBeyond * (bent[end][t][plane] - bent[1 - end][t][plane]);
                    square += there * there;
                }
                largest = larger(largest, (radius[t] * radius[t]) * square);
            }
    }
    for (int lane = 0; lane < Lane<V>::count; ++lane) strain_square[lane] = Lane<V>::at(largest, lane);
}

template <class V>
constexpr KernelTable table_of = {newton<V>, step_length<V>, advance<V>, residual<V>, solve<V>, correct<V>, bending<V>};
