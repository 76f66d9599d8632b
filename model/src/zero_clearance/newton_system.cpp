// The linear system of a Newton step of the zero-clearance model: assembled, factored, solved.
#include <algorithm>
#include <cmath>

#include "ctr/kernel.hpp"
#include "ctr/zero_clearance.hpp"

namespace ctr {
namespace {

#include "zero_clearance/blocks.hpp"

constexpr double kConvexity = 1.02;       // margin for what the elements do not resolve

// Calls work with the number of tubes as a constant where it is a usual one.
template <class Work>
__attribute__((always_inline)) inline auto with_constant(int m, const Work& work) {
    switch (m) {
        case 2: return work(2);
        case 3: return work(3);
        case 4: return work(4);
        default: return work(m);
    }
}

double larger(double most, double value) { return value <= most ? most : value; }  // a NaN stays

}  // namespace

void ZeroClearance::clear_blocks() {
    std::fill(A_.begin(), A_.end(), 0.0);
    std::fill(U_.begin(), U_.end(), 0.0);
}

// The tubes behind the plate: torsion springs from the bases.
void ZeroClearance::add_transmissions(bool matrix) {
    for (int t = 0; t < n_; ++t) {
        if (is_clamped(t)) continue;
        const double k = transmission_stiffness(t);
        r_[2 * t] += k * (x_[2 * t] - base_theta_[t]);
        if (matrix) A_[2 * t * ld_ + 2 * t] += k;
    }
}

// Identity rows for angles that are fixed at the plate; returns the largest imbalance of the others.
double ZeroClearance::hold_fixed(bool matrix) {
    for (int t = 0; t < n_; ++t) {
        if (!is_clamped(t)) continue;
        const int i = 2 * t;
        r_[i] = 0;
        if (!matrix) continue;
        for (int j = 0; j < ld_; ++j) A_[i * ld_ + j] = A_[j * ld_ + i] = U_[i * ld_ + j] = 0;
        A_[i * ld_ + i] = 1;
    }
    for (int t = tubes_[0]; matrix && t < n_; ++t) A_[(2 * t + 1) * (ld_ + 1)] = 1;  // ends at the plate: no twist beyond it
    double worst = 0;
    for (int k = 0; k < nodes_; ++k) {
        const double length = s_[std::min(k + 1, nodes_ - 1)] - s_[std::max(k - 1, 0)];
        for (int i = 0; i < node_unknowns(k); ++i) worst = larger(worst, std::fabs(r_[k * ld_ + i]) / (i % 2 ? length : 1.0));
    }
    return worst;
}

double ZeroClearance::assemble(double scale, bool matrix) {
    std::fill(r_.begin(), r_.end(), 0.0);
    if (matrix) clear_blocks();
    add_transmissions(matrix);
    const int block = ld_ * ld_;
    for (int e = 0; e + 1 < nodes_; ++e) {
        const ElementData data{s_[e + 1] - s_[e], &P_[row_[e] * n_ * n_], gj_.data(), &v_[e * kGaussPoints * n_ * 2],
                               &x_[e * ld_], &x_[(e + 1) * ld_], &r_[e * ld_], &r_[(e + 1) * ld_],
                               &A_[e * block], &U_[e * block], &A_[(e + 1) * block], n_, ld_};
        if (matrix) with_constant(tubes_[e], [&](int m) __attribute__((always_inline)) { add_element(m, data, scale, true); });
        else with_constant(tubes_[e], [&](int m) __attribute__((always_inline)) { add_element(m, data, scale, false); });
    }
    return hold_fixed(matrix) / scale_moment_;
}

bool ZeroClearance::is_convex() {
    std::fill(r_.begin(), r_.end(), 0.0);
    clear_blocks();
    add_transmissions(true);
    const int block = ld_ * ld_;
    for (int e = 0; e + 1 < nodes_; ++e) {
        const ElementData data{s_[e + 1] - s_[e], &P_[row_[e] * n_ * n_], gj_.data(), &v_[e * kGaussPoints * n_ * 2],
                               &x_[e * ld_], &x_[(e + 1) * ld_], &r_[e * ld_], &r_[(e + 1) * ld_],
                               &A_[e * block], &U_[e * block], &A_[(e + 1) * block], n_, ld_};
        with_constant(tubes_[e], [&](int m) __attribute__((always_inline)) { add_least(m, data, kConvexity); });
    }
    hold_fixed(true);
    return factorise() == 0;
}

int ZeroClearance::factorise() {
    int negative = 0;
    const int block = ld_ * ld_;
    for (int k = 0; k < nodes_; ++k) {
        const int p = node_unknowns(k), q = k + 1 < nodes_ ? node_unknowns(k + 1) : 0;
        double *A = &A_[k * block], *U = &U_[k * block], *r = &r_[k * ld_], *next = A + block, *next_r = r + ld_;
        if (p == 6 && q == 6) negative += eliminate(6, 6, A, U, r, next, next_r, ld_);
        else if (p == 4 && q == 4) negative += eliminate(4, 4, A, U, r, next, next_r, ld_);
        else if (p == 8 && q == 8) negative += eliminate(8, 8, A, U, r, next, next_r, ld_);
        else negative += eliminate(p, q, A, U, r, next, next_r, ld_);
    }
    return negative;
}

void ZeroClearance::solve_system() {
    negative_ = factorise();
    const int block = ld_ * ld_;
    for (int k = nodes_ - 1; k >= 0; --k) {
        const int p = node_unknowns(k), q = k + 1 < nodes_ ? node_unknowns(k + 1) : 0;
        double* step = &step_[k * ld_];
        for (int i = p; i < ld_; ++i) step[i] = 0;
        substitute(p, q, &A_[k * block], &U_[k * block], &r_[k * ld_], step + ld_, step, ld_);
    }
}

}  // namespace ctr
