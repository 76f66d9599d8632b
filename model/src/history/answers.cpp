// What a history says of where it stands, and along a path.
#include <limits>
#include <memory>

#include "ctr/history.hpp"
#include "ctr/watch.hpp"
#include "history/put_back.hpp"

namespace ctr {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

}  // namespace

WaypointRows::WaypointRows(std::size_t rows, std::size_t pairs)
    : status(rows, Status::failed), snaps(rows, kNaN), tip(rows, Vec3{kNaN, kNaN, kNaN}), tangent(tip), phi(rows * pairs, kNaN) {}

WaypointRows History::follow(const std::vector<Configuration>& path) {
    return put_back_if_interrupted([&] { return move_along(path); });
}

WaypointRows History::move_along(const std::vector<Configuration>& path) {
    const std::size_t pairs = inner_arm_.size();
    WaypointRows out(path.size(), pairs);
    Backbone backbone;
    for (std::size_t k = 0; k < path.size(); ++k) {
        Watch::tell(static_cast<double>(k) / static_cast<double>(path.size()));
        out.status[k] = move(path[k]);
        if (status_ == Status::failed) break;
        tracer_.trace(solver_, state_, 0, 1, path[k].l.back(), &backbone);
        out.snaps[k] = snaps_;
        out.tip[k] = backbone.tip.p;
        out.tangent[k] = backbone.tip.tangent();
        mean_phi(out.phi.data() + k * pairs);
    }
    return out;
}

Shape History::shape() const {
    Shape shape = make_shape(solver_, state_, 0, q_);
    shape.status = status_;
    shape.residual = residual();
    shape.stability = kNaN;
    const auto setting = std::make_shared<Setting>(Setting{solver_.robot(), q_, accuracy_, solver_.mesh()});
    shape.equilibrium = std::make_shared<ContactEquilibrium>(setting, state_, 0);
    return shape;
}

std::vector<PairFriction> History::friction() const {
    const KernelProblem& pb = solver_.mesh().problem();
    const Shape whole = make_shape(solver_, state_, 0, q_);
    std::vector<PairFriction> pairs(inner_arm_.size());
    for (std::size_t pair = 0; pair < pairs.size(); ++pair) {
        pairs[pair].s = whole.contacts[pair].s;
        pairs[pair].force = whole.contacts[pair].force;
    }
    for (int k = 0; k < pb.contacts; ++k) {
        PairFriction& pair = pairs[pb.tubes - 2 - pb.contact_pair[k]];
        pair.phi.push_back(phi_[k]);
        pair.psi.push_back(psi_[k]);
    }
    return pairs;
}

}  // namespace ctr
