// Bounds step by step (ctr/walker.hpp), one thread at a time.
#include "ctr/walker.hpp"

#include <mutex>

#include "bindings.hpp"
#include "bounds.hpp"
#include "configurations.hpp"
#include "unlocked.hpp"
#include "walk.hpp"

namespace {

class LockedWalker {
  public:
    LockedWalker(const ctr::Model& model, const std::string& level) : robot_(model.robot()), walker_(model.robot(), accuracy(level)) {}

    // Numbers alone, no arrays: a step takes a fifth of a millisecond.
    nb::tuple step(Vector theta, Vector l) {
        const ctr::Configuration q = valid_configuration(robot_, theta, l);
        const std::unique_lock<std::mutex> lock = hold();
        const ctr::BoundRows row = unlocked([&] { return walker_.step(q); });
        return nb::make_tuple(row.position_bound[0], row.tangent_bound[0], row.stability[0], row.max_strain[0], row.residual[0],
                              static_cast<int>(row.status[0]), row.tip[0], row.tangent[0], walker_.started_cold(), walker_.solves());
    }

    nb::dict check_path(Matrix theta, Matrix l, const Grid* grid, const ctr::PathDensity& density, const ctr::PathLimits& limits, bool shapes) {
        const std::vector<ctr::Configuration> corners = valid_configurations(robot_, theta, l);
        const std::unique_lock<std::mutex> lock = hold();
        return to_python(unlocked([&] { return walker_.check_path(corners, field_of(grid), density, limits, shapes); }), shapes);
    }

    nb::dict shapes() const {
        const std::unique_lock<std::mutex> lock = hold();
        return to_python(unlocked([&] { return walker_.shapes(); }));
    }

  private:
    // Nobody waits here with the interpreter's lock, so that the holder can always take it.
    std::unique_lock<std::mutex> hold() const {
        nb::gil_scoped_release release;
        return std::unique_lock<std::mutex>(mutex_);
    }

    ctr::Robot robot_;
    ctr::Walker walker_;
    mutable std::mutex mutex_;
};

}  // namespace

void bind_walker(nb::module_& m) {
    nb::class_<LockedWalker>(m, "Walker")
        .def("__init__", [](LockedWalker* self, const ctr::Model& model, const std::string& level) { new (self) LockedWalker(model, level); },
             "model"_a, "accuracy"_a)
        .def("step", &LockedWalker::step, "theta_b"_a.noconvert(), "l_b"_a.noconvert())
        .def("check_path", &LockedWalker::check_path, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "field"_a.none(), "density"_a, "limits"_a,
             "shapes"_a)
        .def("shapes", &LockedWalker::shapes);
}
