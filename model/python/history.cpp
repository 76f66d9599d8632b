#include "history.hpp"

#include <limits>

#include "bindings.hpp"
#include "configurations.hpp"
#include "shapes.hpp"
#include "unlocked.hpp"

// Nobody waits here with the interpreter's lock, so that the holder can always take it.
std::unique_lock<std::mutex> PathHistory::hold() const {
    nb::gil_scoped_release release;
    return std::unique_lock<std::mutex>(mutex_);
}

int PathHistory::start(Vector theta, Vector l, Vector phi) {
    std::vector<double> friction = friction_state(robot_, phi);
    const ctr::Configuration q = valid_configuration(robot_, theta, l);
    friction.resize(std::max<std::size_t>(friction.size(), 1));
    const std::unique_lock<std::mutex> lock = hold();
    return static_cast<int>(unlocked([&] { return history_.start(q, friction); }));
}

nb::dict PathHistory::advance(Vector theta, Vector l) {
    const ctr::Configuration q = valid_configuration(robot_, theta, l);
    const std::unique_lock<std::mutex> lock = hold();
    const ctr::Status status = unlocked([&] { return history_.advance(q); });
    const ctr::EnergyBalance& energy = history_.energy();
    nb::dict balance, made;
    balance["work_J"] = energy.work;
    balance["elastic_J"] = energy.elastic;
    balance["breakaway_J"] = energy.breakaway;
    balance["loss_J"] = energy.loss;
    balance["smallest_loss_J"] = energy.smallest_loss;
    made["status"] = static_cast<int>(status);
    made["steps"] = history_.steps();
    made["snaps"] = history_.snaps();
    made["energy"] = balance;
    return made;
}

nb::dict PathHistory::follow(Matrix theta, Matrix l, const nb::object& progress) {
    const std::vector<ctr::Configuration> path = valid_configurations(robot_, theta, l);
    const std::unique_lock<std::mutex> lock = hold();
    ctr::WaypointRows rows = unlocked([&] { return history_.follow(path); }, progress);
    nb::dict made;
    made["position_m"] = array(std::move(rows.tip));
    made["tangent"] = array(std::move(rows.tangent));
    made["phi"] = array(std::move(rows.phi), {path.size(), robot_.pairs.size()});
    made["snaps"] = array(std::move(rows.snaps));
    made["status"] = array(rows.status);
    return made;
}

nb::object PathHistory::shape() const {
    const std::unique_lock<std::mutex> lock = hold();
    return to_python(history_.shape());
}

nb::list PathHistory::friction() const {
    const std::unique_lock<std::mutex> lock = hold();
    nb::list pairs;
    for (ctr::PairFriction& pair : history_.friction()) {
        nb::dict made;
        made["s_m"] = array(std::move(pair.s));
        made["phi"] = array(std::move(pair.phi));
        made["psi"] = array(std::move(pair.psi));
        made["force_N"] = array(std::move(pair.force));
        pairs.append(made);
    }
    return pairs;
}

// Tip (3) at friction states phi on the branch that the history is on; NaN where it ends before.
nb::object PathHistory::beside(Vector phi) {
    const std::vector<double> friction = friction_state(robot_, phi);
    constexpr double nan = std::numeric_limits<double>::quiet_NaN();
    ctr::Backbone backbone;
    const std::unique_lock<std::mutex> lock = hold();
    const bool found = unlocked([&] { return history_.solve_beside(friction, backbone); });
    const ctr::Vec3 tip = found ? backbone.frame.back().p : ctr::Vec3{nan, nan, nan};
    return array(std::vector<double>(tip.begin(), tip.end()));
}

ctr::History::State PathHistory::save() const {
    const std::unique_lock<std::mutex> lock = hold();
    return history_.save();
}

void PathHistory::restore(const ctr::History::State& state) {
    const std::unique_lock<std::mutex> lock = hold();
    history_.restore(state);
}

void bind_history(nb::module_& m) {
    nb::class_<ctr::History::State>(m, "HistoryState");
    nb::class_<PathHistory>(m, "History")
        .def("start", &PathHistory::start, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "phi"_a.noconvert())
        .def("advance", &PathHistory::advance, "theta_b"_a.noconvert(), "l_b"_a.noconvert())
        .def("follow", &PathHistory::follow, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "progress"_a.none())
        .def("shape", &PathHistory::shape)
        .def("friction", &PathHistory::friction)
        .def("beside", &PathHistory::beside, "phi"_a.noconvert())
        .def("save", &PathHistory::save)
        .def("restore", &PathHistory::restore, "state"_a);
}
