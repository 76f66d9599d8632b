#include "exact/alignment.hpp"

#include "ctr/friction_solver.hpp"
#include "ctr/shape.hpp"

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"

constexpr double kSpacing = 0.05;  // of the knots, over the innermost tube's length

}  // namespace

void Alignment::build(const FrictionSolver& solver) {
    spacing_ = kSpacing * solver.robot().tubes.back().length();
    const KernelProblem& pb = solver.mesh().problem();
    needs_.resize(pb.nodes);
    offset_.resize(pb.nodes);
}

void Alignment::find_range(const KernelProblem& pb, int pair) {
    first_ = 0;
    last_ = pb.elements;
    while (offsets_of(pb, first_) <= pair) ++first_;
    while (offsets_of(pb, last_ - 1) <= pair) --last_;
}

void Alignment::record(const FrictionSolver& solver, LaneState& state, int lane, const GaussField& curvature,
                       const std::vector<Frame>& frame) {
    const KernelProblem& pb = solver.mesh().problem();
    const int n = pb.tubes;
    for (int p = 0; p + 1 < n; ++p) {
        find_range(pb, p);
        for (int k = first_; k <= last_; ++k) {
            const bool beside = (k > first_ && p + 1 < pb.element_tubes[k - 1]) || (k < last_ && p + 1 < pb.element_tubes[k]);
            const Frame axis;  // where no tube is outside
            const Frame &inner = frame[k * n + p], &outer = beside ? frame[k * n + p + 1] : axis;
            const Vec3 arm{inner.p[0] - outer.p[0], inner.p[1] - outer.p[1], inner.p[2] - outer.p[2]};
            for (int plane = 0; plane < 2; ++plane) offset_[k][plane] = dot(outer.column(plane), arm);
        }
        find_needs(pb, curvature, p);
        for (int k = first_; k <= last_; ++k)
            for (int plane = 0; plane < 2; ++plane)
                state.need(k, p, plane, lane) = needs_[k][plane] - state.unknown(k, 1 + 5 * p + plane, lane);
    }
}

// With eps and alpha what the inner tube is ahead and turned, to first order in the offset d:
//     eps' = kappa . d,  alpha' = d' x kappa,  needs' = d' + eps kappa - int alpha J kappa.
void Alignment::find_needs(const KernelProblem& pb, const GaussField& curvature, int pair) {
    double ahead = 0, turn = 0;
    Plane slope{0, 0}, sum{0, 0};
    needs_[first_] = offset_[first_];
    for (int k = first_ + 1; k <= last_; ++k) {
        const int e = k - 1;
        if (pair + 1 < pb.element_tubes[e]) {
            const double h = pb.length[e];
            const double(*first)[2] = curvature.at(e, 0), (*second)[2] = curvature.at(e, 1);
            const Plane inner{0.5 * (first[pair][0] + second[pair][0]), 0.5 * (first[pair][1] + second[pair][1])};
            const Plane outer{0.5 * (first[pair + 1][0] + second[pair + 1][0]), 0.5 * (first[pair + 1][1] + second[pair + 1][1])};
            const Plane &a = offset_[e], &b = offset_[k];
            const Plane both{0.5 * (inner[0] + outer[0]), 0.5 * (inner[1] + outer[1])};
            const double ahead_by = 0.5 * h * (outer[0] * (a[0] + b[0]) + outer[1] * (a[1] + b[1]));
            const double turn_by = (b[0] - a[0]) * both[1] - (b[1] - a[1]) * both[0];
            const Plane bent{(turn + 0.5 * turn_by) * inner[1] * h, -(turn + 0.5 * turn_by) * inner[0] * h};
            for (int plane = 0; plane < 2; ++plane) {
                sum[plane] += h * ((ahead + 0.5 * ahead_by) * outer[plane] + slope[plane] + 0.5 * bent[plane]);
                slope[plane] += bent[plane];
            }
            ahead += ahead_by;
            turn += turn_by;
        } else {
            for (int plane = 0; plane < 2; ++plane) sum[plane] += pb.length[e] * slope[plane];
        }
        for (int plane = 0; plane < 2; ++plane) needs_[k][plane] = offset_[k][plane] + sum[plane];
    }
}

void Alignment::place_knots(const std::vector<double>& s) {
    const int first = first_, last = last_;
    knots_.clear();
    for (int k = first; k <= last; ++k) {
        const bool far = k > first && s[k] - s[knots_.back().node] >= spacing_ && s[last] - s[k] >= spacing_;
        if (k == first || k == last || far) knots_.push_back({k, needs_[k], {0, 0}});
    }
    for (std::size_t k = 1; k < knots_.size(); ++k) {  // a parabola's slopes; the first is clamped
        const bool end = k + 1 == knots_.size();
        const Knot &a = knots_[k - 1], &c = knots_[end ? k : k + 1];
        Knot& b = knots_[k];
        const double ab = s[b.node] - s[a.node], bc = end ? ab : s[c.node] - s[b.node];
        for (int plane = 0; plane < 2; ++plane) {
            const double left = (b.value[plane] - a.value[plane]) / ab;
            b.slope[plane] = end ? 2 * left - a.slope[plane]
                                 : (left * bc + (c.value[plane] - b.value[plane]) / bc * ab) / (ab + bc);
        }
    }
}

// Bends the tubes inside the pair against those outside; the mean is kept where it is free.
void Alignment::bend(const FrictionSolver& solver, LaneState& state, int lane, int pair, GaussField& curvature) const {
    const KernelProblem& pb = solver.mesh().problem();
    const std::vector<double>& s = solver.mesh().s();
    for (std::size_t k = 0; k + 1 < knots_.size(); ++k) {
        const Knot &a = knots_[k], &c = knots_[k + 1];
        const double span = s[c.node] - s[a.node];
        for (int e = a.node; e < c.node; ++e) {
            const int m = pb.element_tubes[e];
            double inside = 0, total = 0;
            for (int t = 0; t < m; ++t) {
                const double EI = pb.bending_stiffness[pb.element_regime[e] / 2 * pb.tubes + t];
                total += EI;
                if (t <= pair) inside += EI;
            }
            const double mean = solver.mesh().mean_is_free(e) ? inside / total : 0.0;
            for (int g = 0; g < 2; ++g) {
                const double xi = (s[e] + kGauss[g] * pb.length[e] - s[a.node]) / span;
                for (int plane = 0; plane < 2; ++plane) {
                    const double change = ((12 * xi - 6) / span * (a.value[plane] - c.value[plane]) + (6 * xi - 4) * a.slope[plane] +
                                           (6 * xi - 2) * c.slope[plane]) / span;
                    for (int t = 0; t < m; ++t) {
                        const double part = ((t <= pair ? 1.0 : 0.0) - mean) * change;
                        state.bend_at_gauss(e, g, t, plane, lane) += part;
                        curvature.at(e, g)[t][plane] += part;
                    }
                }
            }
        }
    }
}

void Alignment::correct(const FrictionSolver& solver, LaneState& state, int lane, GaussField& curvature) {
    const KernelProblem& pb = solver.mesh().problem();
    for (int p = 0; p + 1 < pb.tubes; ++p) {
        find_range(pb, p);
        for (int k = first_; k <= last_; ++k)
            for (int plane = 0; plane < 2; ++plane) offset_[k][plane] = state.unknown(k, 1 + 5 * p + plane, lane);
        find_needs(pb, curvature, p);
        for (int k = first_; k <= last_; ++k)
            for (int plane = 0; plane < 2; ++plane) needs_[k][plane] -= state.need(k, p, plane, lane) + offset_[k][plane];
        place_knots(solver.mesh().s());
        bend(solver, state, lane, p, curvature);
    }
}

}  // namespace ctr
