// Mass and starting vector of the modes of the tubes' angles, [node][tube].
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "ctr/kernel.hpp"

namespace ctr {

// Consistent mass of the angles; those that are held have none.
inline void weigh_angles(const KernelProblem& pb, const double* x, double* Mx) {
    const int n = pb.tubes;
    std::fill(Mx, Mx + static_cast<std::size_t>(pb.nodes) * n, 0.0);
    for (int e = 0; e < pb.elements; ++e)
        for (int t = 0; t < pb.element_tubes[e]; ++t) {
            const double h = pb.length[e], a = x[e * n + t], b = x[(e + 1) * n + t];
            if (5 * t < pb.node_unknowns[e]) Mx[e * n + t] += h / 6 * (2 * a + b);
            if (5 * t < pb.node_unknowns[e + 1]) Mx[(e + 1) * n + t] += h / 6 * (a + 2 * b);
        }
}

inline double inner_product(const double* a, const double* b, std::size_t count) {
    double sum = 0;
    for (std::size_t i = 0; i < count; ++i) sum += a[i] * b[i];
    return sum;
}

// Near the lowest mode of tubes held at their bases, and overlapping every other.
inline void starting_mode(const KernelProblem& pb, const std::vector<double>& s, double base_l, double length, double* x) {
    const int n = pb.tubes;
    std::fill(x, x + static_cast<std::size_t>(pb.nodes) * n, 0.0);
    for (int k = 1; k < pb.nodes; ++k)
        for (int t = 0; t < n; ++t)
            if (5 * t < pb.node_unknowns[k]) x[k * n + t] = (s[k] - base_l) / length + 0.1 * std::sin(1.0 + 0.1 * k + t);
}

}  // namespace ctr
