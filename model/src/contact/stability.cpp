// The lowest mode of the second variation, FrictionSolver::stability().
#include <algorithm>
#include <cmath>

#include "contact/angle_mass.hpp"
#include "ctr/friction_solver.hpp"

namespace ctr {
namespace {

constexpr int kMostModes = 16;
constexpr double kModeError = 1e-6;  // of a Ritz vector; the value errs by its square, by more where modes lie close

// Eigenvalues below x of the symmetric tridiagonal matrix with this diagonal and these squares beside it.
int count_below(double x, int size, const double* diagonal, const double* square) {
    int below = 0;
    double pivot = 1;
    for (int i = 0; i < size; ++i) {
        pivot = diagonal[i] - x - (i ? square[i - 1] / pivot : 0.0);
        if (pivot == 0) pivot = 1e-300;
        below += pivot < 0;
    }
    return below;
}

// Value over slope of its characteristic polynomial: from where bisection ends to the last digits, which differences need.
double newton_step(double x, int size, const double* diagonal, const double* square) {
    double value = 1, before = 0, slope = 0, slope_before = 0;
    for (int i = 0; i < size; ++i) {
        const double beside = i ? square[i - 1] : 0.0, next = (diagonal[i] - x) * value - beside * before;
        const double next_slope = (diagonal[i] - x) * slope - value - beside * slope_before;
        before = value;
        value = next;
        slope_before = slope;
        slope = next_slope;
    }
    return slope == 0 ? 0.0 : value / slope;
}

// Its eigenvalue with the largest magnitude by bisection, and the last component of the unit eigenvector.
double largest_eigenvalue(int size, const double* diagonal, const double* beside, double& last) {
    double square[kMostModes], low = 0, high = 0;
    for (int i = 0; i < size; ++i) {
        const double reach = (i ? beside[i - 1] : 0.0) + (i + 1 < size ? beside[i] : 0.0);
        low = std::min(low, diagonal[i] - reach);
        high = std::max(high, diagonal[i] + reach);
        square[i] = i + 1 < size ? beside[i] * beside[i] : 0.0;
    }
    auto eigenvalue = [&](int index) {  // counted from the smallest
        double a = low, b = high;
        while (b - a > 1e-9 * (high - low)) {
            const double middle = 0.5 * (a + b);
            (count_below(middle, size, diagonal, square) > index ? b : a) = middle;
        }
        return 0.5 * (a + b);
    };
    const double smallest = eigenvalue(0), largest = eigenvalue(size - 1);
    double value = largest >= -smallest ? largest : smallest;
    value -= newton_step(value, size, diagonal, square);
    double component = 1, before = 0, norm = 1;
    for (int i = 0; i + 1 < size; ++i) {
        const double next = ((value - diagonal[i]) * component - (i ? beside[i - 1] : 0.0) * before) / beside[i];
        before = component;
        component = next;
        norm += next * next;
    }
    last = component / std::sqrt(norm);
    return value;
}

}  // namespace

double FrictionSolver::stability(LaneState& state, int& negative) {
    const KernelProblem& pb = mesh_.problem();
    negative = 0;
    for (int k = 0; k < pb.nodes; ++k)
        for (int i = 0; i < pb.node_unknowns[k]; ++i)
            if (state.inverse_pivot(k, i, 0) < 0) ++negative;
    // Lanczos on H^-1 M
    const int n = pb.tubes;
    const double length = robot_.tubes.back().length();
    const std::size_t size = static_cast<std::size_t>(pb.nodes) * n;
    modes_.assign(4 * size, 0.0);
    double *before = modes_.data(), *now = before + size, *next = now + size, *mass = next + size;
    starting_mode(pb, mesh_.s(), base_l_, length, now);
    weigh_angles(pb, now, mass);
    double scale = 1 / std::sqrt(inner_product(now, mass, size)), alpha[kMostModes], beta[kMostModes] = {}, value = 0;
    for (int j = 0; j < kMostModes; ++j) {
        for (std::size_t i = 0; i < size; ++i) {
            now[i] *= scale;
            mass[i] *= scale;
        }
        for (int k = 0; k < pb.nodes; ++k)
            for (int i = 0; i < pb.stride; ++i) state.rhs(k, i, 0) = i % 5 == 0 ? -mass[k * n + i / 5] : 0.0;
        kernel(1).solve(pb, state.view());
        for (int k = 0; k < pb.nodes; ++k)
            for (int t = 0; t < n; ++t) next[k * n + t] = 5 * t < pb.node_unknowns[k] ? state.step(k, 5 * t, 0) : 0.0;
        alpha[j] = inner_product(next, mass, size);
        for (std::size_t i = 0; i < size; ++i) next[i] -= alpha[j] * now[i] + (j ? beta[j - 1] : 0.0) * before[i];
        weigh_angles(pb, next, mass);
        beta[j] = std::sqrt(std::max(inner_product(next, mass, size), 0.0));
        double last = 1;
        value = largest_eigenvalue(j + 1, alpha, beta, last);
        if (!(beta[j] * std::fabs(last) > kModeError * std::fabs(value))) break;
        scale = 1 / beta[j];
        std::swap(before, now);
        std::swap(now, next);
    }
    return length * length / (robot_.tubes.back().torsional_stiffness * value);
}

}  // namespace ctr
