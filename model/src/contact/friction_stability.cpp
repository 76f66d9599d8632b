// The lowest mode of equilibria with friction, FrictionSolver::stabilities(). Friction that follows the contact force makes
// the Newton matrix unsymmetric, so that the symmetric Lanczos of stability.cpp does not do.
#include <algorithm>
#include <cmath>
#include <limits>

#include "contact/angle_mass.hpp"
#include "ctr/friction_solver.hpp"

namespace ctr {
namespace {

constexpr int kMostModes = 10;
constexpr int kMostNewtonSteps = 60;
constexpr double kModeError = 0.02;  // of a Ritz vector
constexpr double kRootError = 1e-6;

// Upper Hessenberg matrix of the operator in the basis built so far.
struct Hessenberg {
    double entry[kMostModes + 1][kMostModes];

    double bound(int size) const {
        double most = 0;
        for (int i = 0; i < size; ++i) {
            double sum = 0;
            for (int j = std::max(i - 1, 0); j < size; ++j) sum += std::fabs(entry[i][j]);
            most = std::max(most, sum);
        }
        return most;
    }

    // The real eigenvalue nearest to x that Newton's method finds from outside of all of them, by Hyman's recurrence for the
    // characteristic polynomial; `last` is the last component of its unit eigenvector. NaN if there is none.
    double eigenvalue_from(double x, int size, double& last) const {
        double value[kMostModes], slope[kMostModes];
        for (int step = 0; step < kMostNewtonSteps; ++step) {
            value[size - 1] = 1;
            slope[size - 1] = 0;
            double norm = 1;
            for (int i = size - 1; i > 0; --i) {
                double sum = -x * value[i], by = -x * slope[i] - value[i];
                for (int j = i; j < size; ++j) {
                    sum += entry[i][j] * value[j];
                    by += entry[i][j] * slope[j];
                }
                value[i - 1] = -sum / entry[i][i - 1];
                slope[i - 1] = -by / entry[i][i - 1];
                norm += value[i - 1] * value[i - 1];
            }
            double sum = -x * value[0], by = -x * slope[0] - value[0];
            for (int j = 0; j < size; ++j) {
                sum += entry[0][j] * value[j];
                by += entry[0][j] * slope[j];
            }
            last = 1 / std::sqrt(norm);
            if (sum == 0 || by == 0) return x;
            const double change = sum / by;
            x -= change;
            if (std::fabs(change) < kRootError * std::fabs(x)) return x;
        }
        return std::numeric_limits<double>::quiet_NaN();
    }

    // The real eigenvalue with the largest magnitude.
    double largest(int size, double& last) const {
        double last_negative = 1, last_positive = 1;
        const double outside = 1.01 * bound(size) + 1e-300;
        const double positive = eigenvalue_from(outside, size, last_positive), negative = eigenvalue_from(-outside, size, last_negative);
        const bool is_positive = std::isnan(negative) || std::fabs(positive) >= std::fabs(negative);
        last = is_positive ? last_positive : last_negative;
        return is_positive ? positive : negative;
    }
};

}  // namespace

void FrictionSolver::stabilities(LaneState& state, double* stability) {
    const KernelProblem& pb = mesh_.problem();
    const int n = pb.tubes, lanes = state.lanes();
    const double length = robot_.tubes.back().length();
    const std::size_t size = static_cast<std::size_t>(pb.nodes) * n;
    std::vector<double> basis(lanes * (kMostModes + 1) * size), mass(size);
    auto vector = [&](int lane, int mode) { return &basis[(static_cast<std::size_t>(lane) * (kMostModes + 1) + mode) * size]; };
    Hessenberg matrix[kMostLanes] = {};
    double value[kMostLanes];
    bool found[kMostLanes] = {};
    auto norm = [&](const double* x) {
        weigh_angles(pb, x, mass.data());
        return std::sqrt(std::max(inner_product(x, mass.data(), size), 0.0));
    };
    for (int lane = 0; lane < lanes; ++lane) {
        double* first = vector(lane, 0);
        starting_mode(pb, mesh_.s(), base_l_, length, first);
        const double scale = 1 / norm(first);
        for (std::size_t i = 0; i < size; ++i) first[i] *= scale;
    }
    for (int j = 0; j < kMostModes && !std::all_of(found, found + lanes, [](bool done) { return done; }); ++j) {
        for (int lane = 0; lane < lanes; ++lane) {
            weigh_angles(pb, vector(lane, j), mass.data());
            for (int k = 0; k < pb.nodes; ++k)
                for (int i = 0; i < pb.stride; ++i) state.rhs(k, i, lane) = i % 5 == 0 ? -mass[k * n + i / 5] : 0.0;
        }
        kernel(lanes).solve(pb, state.view());
        for (int lane = 0; lane < lanes; ++lane) {
            if (found[lane]) continue;
            double* next = vector(lane, j + 1);
            for (int k = 0; k < pb.nodes; ++k)
                for (int t = 0; t < n; ++t) next[k * n + t] = 5 * t < pb.node_unknowns[k] ? state.step(k, 5 * t, lane) : 0.0;
            for (int i = 0; i <= j; ++i) {
                const double* other = vector(lane, i);
                weigh_angles(pb, other, mass.data());
                const double share = inner_product(next, mass.data(), size);
                matrix[lane].entry[i][j] = share;
                for (std::size_t a = 0; a < size; ++a) next[a] -= share * other[a];
            }
            const double beyond = norm(next);
            matrix[lane].entry[j + 1][j] = beyond;
            double last = 1;
            value[lane] = matrix[lane].largest(j + 1, last);
            found[lane] = !(beyond * std::fabs(last) > kModeError * std::fabs(value[lane]));
            if (!found[lane])
                for (std::size_t a = 0; a < size; ++a) next[a] /= beyond;
        }
    }
    for (int lane = 0; lane < lanes; ++lane) stability[lane] = length * length / (robot_.tubes.back().torsional_stiffness * value[lane]);
}

}  // namespace ctr
