// Friction states of one configuration (ctr/bound.hpp), for as many calls and threads as there are.
#include <utility>

#include "bindings.hpp"
#include "configurations.hpp"
#include "ctr/model.hpp"
#include "unlocked.hpp"
#include "walk.hpp"

namespace {

class StatesOfConfiguration {
  public:
    StatesOfConfiguration(ctr::Model& model, Vector theta, Vector l, const std::string& level) : model_(model) {
        const ctr::Configuration q = valid_configuration(model.robot(), theta, l);
        start_ = unlocked([&] { return model_.begin_states(q, accuracy(level)); });
    }

    // Points (states, N, 4) with outer radii, status, largest strain and stability of each state.
    nb::tuple bodies(Tensor phi, double spacing) const {
        if (phi.shape(2) != model_.robot().pairs.size() || phi.shape(1) == 0) throw ctr::InvalidInput("phi needs one value per pair");
        const std::size_t states = phi.shape(0);
        const ctr::FrictionStates of{phi.data(), states, static_cast<int>(phi.shape(1))};
        ctr::FrictionBodies found = unlocked([&] { return model_.friction_bodies(start_, of, spacing); });
        const std::size_t count = states ? found.point.size() / (4 * states) : 0;
        return nb::make_tuple(array(std::move(found.point), {states, count, 4}), array(found.status), array(std::move(found.max_strain)),
                              array(std::move(found.stability)));
    }

  private:
    ctr::Model& model_;  // outlives this
    ctr::FrictionlessStart start_;
};

}  // namespace

void bind_friction_states(nb::module_& m) {
    nb::class_<StatesOfConfiguration>(m, "FrictionStates")
        .def("__init__", [](StatesOfConfiguration* self, ctr::Model& model, Vector theta, Vector l, const std::string& level) {
                 new (self) StatesOfConfiguration(model, theta, l, level);
             },
             "model"_a, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "accuracy"_a, nb::keep_alive<1, 2>())
        .def("bodies", &StatesOfConfiguration::bodies, "phi"_a.noconvert(), "spacing"_a);
}
