// Gradient of the tip by every number of a discretised robot, from solves with the transposed factors (docs/model.md).
#pragma once

#include <array>
#include <vector>

#include "ctr/friction_solver.hpp"
#include "ctr/shape.hpp"
#include "derivatives/number_layout.hpp"

namespace ctr {

// Position [m] and tangent of a tip, or derivatives of them.
struct TipValues {
    std::array<double, 6> value{};
    TipValues& operator+=(const TipValues& other) {
        for (int i = 0; i < 6; ++i) value[i] += other.value[i];
        return *this;
    }
    TipValues& operator-=(const TipValues& other) {
        for (int i = 0; i < 6; ++i) value[i] -= other.value[i];
        return *this;
    }
    TipValues& operator*=(double factor) {
        for (double& v : value) v *= factor;
        return *this;
    }
    friend TipValues operator+(TipValues a, const TipValues& b) { return a += b; }
    friend TipValues operator-(TipValues a, const TipValues& b) { return a -= b; }
    friend TipValues operator*(double factor, TipValues a) { return a *= factor; }
};

// With F(x; a) = 0 the balance of forces and y(x, a) the tip, dy/da = y_a - F_a^T H^-T y_x: six solves, however many numbers.
// For tubes that carry no loads, with the constitutive relation of docs/model.md; the barrier's level is held. Among the
// numbers are the moments of loads, all zero: a load is felt through what it is on the shape as it stands.
class TipGradient {
  public:
    static bool applies(const FrictionSolver& solver, const LaneState& state);

    // state: one lane, converged and factorised on the solver's mesh for the friction states phi, per pair, outermost first.
    void compute(const FrictionSolver& solver, LaneState& state, const std::vector<double>& phi);
    TipValues along(const NumberChange& change) const;

  private:
    struct BentTube {  // at a Gauss point; moments and curvatures as vectors in the twist-free frame
        double kappa[2], moment[2], tangent[3], by_angle[2];  // tangent: moment by curvature, xx, xy, yy
        double stretched[2];                                  // length of the element times kappa against the outermost by it
        double sine, cosine, curved[2];                       // of the first oval axis, and the precurvature along the axes
    };
    struct ElementBend {
        BentTube tube[2][kMaxTubes];
        double inverse[2][3];  // of the sum of tangents, where the mean bending is free, else 0
    };
    static void measure_bend(const KernelProblem& pb, const BendingLaw* laws, const LaneState& state, int element, ElementBend& out);
    // What numbers of a tube's law and its precurvature change, where `by` are derivatives by its moment.
    void add_moment(int element, int gauss, int tube, const BendingLaw& law, const BentTube& bent, const TipValues (&by)[2]);
    void differentiate_tip(const FrictionSolver& solver, const LaneState& state);
    void add_curvature(const KernelProblem& pb, const BendingLaw* laws, int element, const TipValues (&by_curvature)[2][2]);
    void solve_transposed(const KernelProblem& pb, const KernelState& state);
    void add_elements(const KernelProblem& pb, const BendingLaw* laws, const LaneState& state, int element);
    void add_contacts(const KernelProblem& pb, const LaneState& state, double level, const std::vector<double>& phi);
    TipValues& unknown(int node, int index) { return adjoint_[static_cast<std::size_t>(node) * stride_ + index]; }

    TipValues& load(int element, int gauss, int tube, int plane) {
        return gradient_[at_.load + ((element * 2 + gauss) * at_.tubes + tube) * 2 + plane];
    }

    NumberLayout at_;
    int stride_ = 0;
    std::vector<TipValues> gradient_;  // by every number
    std::vector<TipValues> adjoint_;   // [node][stride]: tip by unknown, then -H^-T of it
    std::vector<ElementBend> bend_;
    Backbone backbone_;
    BackboneTracer tracer_;
};

}  // namespace ctr
