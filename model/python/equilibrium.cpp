// A solution kept by a shape (ctr/equilibrium.hpp), to evaluate its balance again.
#include "ctr/equilibrium.hpp"

#include "arrays.hpp"
#include "bindings.hpp"
#include "unlocked.hpp"

namespace {

ctr::Equilibrium::Values values(const std::vector<Vector>& given) {
    ctr::Equilibrium::Values made;
    for (const Vector& one : given) made.emplace_back(one.data(), one.data() + one.shape(0));
    return made;
}

double residual(const ctr::Equilibrium& equilibrium, const std::vector<Vector>& theta, const std::vector<Vector>& force) {
    const ctr::Equilibrium::Values angles = values(theta), forces = values(force);
    return unlocked([&] { return equilibrium.residual(angles, forces); });
}

}  // namespace

void bind_equilibrium(nb::module_& m) {
    nb::class_<ctr::Equilibrium>(m, "Equilibrium").def("residual", &residual, "theta"_a, "force"_a);
}
