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
// For linear round tubes that carry no loads, with the constitutive relation of docs/model.md; the barrier's level is held.
class TipGradient {
  public:
    static bool applies(const FrictionSolver& solver, const LaneState& state);

    // state: one lane, converged and factorised on the solver's mesh for the friction states phi, per pair, outermost first.
    void compute(const FrictionSolver& solver, LaneState& state, const std::vector<double>& phi);
    TipValues along(const NumberChange& change) const;

  private:
    struct ElementBend {  // bending against the outermost tube present, and the precurvature as turned, at the Gauss points
        double sine[2][kMaxTubes], cosine[2][kMaxTubes];
        double running[2][kMaxTubes][2];
        double stretched[2][kMaxTubes][2];  // length of the element times the derivative of `running` by it
        double turned[2][kMaxTubes][2];
    };
    void measure_bend(const KernelProblem& pb, const LaneState& state, int element, ElementBend& out) const;
    void differentiate_tip(const FrictionSolver& solver, const LaneState& state);
    void add_curvature(const KernelProblem& pb, int element, const TipValues (&by_curvature)[2][2]);
    void solve_transposed(const KernelProblem& pb, const KernelState& state);
    void add_elements(const KernelProblem& pb, const LaneState& state, int element);
    void add_contacts(const KernelProblem& pb, const LaneState& state, double level, const std::vector<double>& phi);
    TipValues& unknown(int node, int index) { return adjoint_[static_cast<std::size_t>(node) * stride_ + index]; }

    NumberLayout at_;
    int stride_ = 0;
    std::vector<TipValues> gradient_;  // by every number
    std::vector<TipValues> adjoint_;   // [node][stride]: tip by unknown, then -H^-T of it
    std::vector<ElementBend> bend_;
    Backbone backbone_;
    BackboneTracer tracer_;
};

}  // namespace ctr
