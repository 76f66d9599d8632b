#include "ctr/equilibrium.hpp"

#include <cmath>
#include <utility>

#include "ctr/friction_solver.hpp"
#include "ctr/shape.hpp"
#include "ctr/zero_clearance.hpp"

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"

constexpr const char* kMisfit = "angles and forces of the shape do not fit the mesh that it was solved on";

// Distance between the centrelines of a pair at a contact point.
double distance(const KernelProblem& pb, const LaneState& state, int e, int k) {
    const int p = pb.contact_pair[k];
    const double* N = pb.contact_shape + 4 * k;
    double d[2];
    for (int plane = 0; plane < 2; ++plane) {
        const int i = offset_index(p, plane), j = slope_index(p, plane);
        d[plane] = N[0] * state.unknown(e, i, 0) + N[1] * state.unknown(e, j, 0) + N[2] * state.unknown(e + 1, i, 0) +
                   N[3] * state.unknown(e + 1, j, 0) + state.shift(k, plane, 0);
    }
    return std::hypot(d[0], d[1]);
}

void fill_in(Shape& shape, Shape&& whole) {
    shape.tubes = std::move(whole.tubes);
    shape.contacts = std::move(whole.contacts);
    shape.radius = std::move(whole.radius);
    shape.max_strain = whole.max_strain;
}

}  // namespace

ContactEquilibrium::ContactEquilibrium(std::shared_ptr<const Setting> setting, const LaneState& state, int lane)
    : setting_(std::move(setting)), kept_(state.keep(lane)) {}

double ContactEquilibrium::residual(const Values& theta, const Values& force) const {
    FrictionSolver solver(setting_->robot);
    solver.adopt(setting_->mesh, setting_->q, setting_->accuracy);
    LaneState state;
    state.resize(solver.mesh().problem(), 1);
    state.put(kept_, solver.mesh().problem());
    set_angles(theta, state);
    set_forces(force, state);
    return solver.imbalance(state);
}

void ContactEquilibrium::lay_out(Shape& shape) const {
    FrictionSolver solver(setting_->robot);
    solver.adopt(setting_->mesh, setting_->q, setting_->accuracy);
    LaneState state;
    state.resize(solver.mesh().problem(), 1);
    state.put(kept_, solver.mesh().problem());
    fill_in(shape, make_shape(solver, state, 0, setting_->q));
}

void ContactEquilibrium::set_angles(const Values& theta, LaneState& state) const {
    const KernelProblem& pb = setting_->mesh.problem();
    if (theta.size() != static_cast<std::size_t>(pb.tubes)) throw InvalidInput(kMisfit);
    for (int t = 0; t < pb.tubes; ++t) {
        const std::vector<double>& angles = theta[pb.tubes - 1 - t];
        std::size_t station = 0;
        for (int e = 0; e < pb.elements; ++e) {
            if (pb.element_tubes[e] <= t) continue;
            if (station + 1 >= angles.size()) throw InvalidInput(kMisfit);
            state.unknown(e, 5 * t, 0) = angles[station];
            state.unknown(e + 1, 5 * t, 0) = angles[++station];
        }
        if (station + 1 != angles.size()) throw InvalidInput(kMisfit);
    }
}

void ContactEquilibrium::set_forces(const Values& force, LaneState& state) const {
    const KernelProblem& pb = setting_->mesh.problem();
    std::vector<std::size_t> point(pb.tubes, 0);
    if (force.size() + 1 != static_cast<std::size_t>(pb.tubes)) throw InvalidInput(kMisfit);
    for (int e = 0; e < pb.elements; ++e)
        for (int k = pb.contact_begin[e]; k < pb.contact_begin[e + 1]; ++k) {
            const int p = pb.contact_pair[k];
            const std::vector<double>& forces = force[pb.tubes - 2 - p];
            if (point[p] >= forces.size()) throw InvalidInput(kMisfit);
            const double along = distance(pb, state, e, k), newtons = forces[point[p]++];
            if (along > 0) state.multiplier(k, 0) = newtons / along;
        }
    for (int p = 0; p + 1 < pb.tubes; ++p)
        if (point[p] != force[pb.tubes - 2 - p].size()) throw InvalidInput(kMisfit);
}

ZeroClearanceEquilibrium::ZeroClearanceEquilibrium(const Robot& robot, const Configuration& q, ZeroClearance solution)
    : robot_(robot), q_(q), solution_(std::make_shared<ZeroClearance>(std::move(solution))) {}

double ZeroClearanceEquilibrium::residual(const Values&, const Values&) const { return solution_->imbalance(); }

void ZeroClearanceEquilibrium::lay_out(Shape& shape) const { fill_in(shape, make_shape(robot_, *solution_, q_)); }

}  // namespace ctr
