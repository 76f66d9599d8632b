// The thin Python face of the core: arrays in, arrays by name out. ctrplan/mechanics is its only user.
#include <cstdlib>

#include "bindings.hpp"
#include "ctr/kernel.hpp"
#include "ctr/robot.hpp"

namespace nb = nanobind;

NB_MODULE(_model, m) {
    m.doc() = "Mechanics of concentric tube robots with clearance and friction (C++ core of ctrplan)";
    // Somebody who still holds a robot when Python ends is told so only if they ask; the tests do.
    nb::set_leak_warnings(std::getenv("CTRPLAN_LEAK_WARNINGS") != nullptr);
    nb::exception<ctr::InvalidInput>(m, "InvalidInput", PyExc_ValueError);
    // Longest steps of a followed branch [rad], [m], the largest correction [rad], and the shortest step as a share of those.
    m.attr("GUIDE_STEPS") = nb::make_tuple(ctr::Guide::kRotation, ctr::Guide::kTranslation, ctr::Guide::kCorrection, ctr::Guide::kShortest);
    m.def("kernel_name", &ctr::kernel_name, "instruction set of the kernel in use");
    bind_robot(m);
    bind_walk(m);
    bind_equilibrium(m);
    bind_shape(m);
    bind_history(m);
    bind_model(m);
    bind_walker(m);
    bind_triangle_tree(m);
    bind_friction_states(m);
    bind_friction_cells(m);
    bind_tip_torus(m);
}
