// The records that a robot is made of (ctr/robot.hpp): every number by its name, SI units.
#include "arrays.hpp"
#include "bindings.hpp"
#include "ctr/robot.hpp"

namespace {

void make_tube(ctr::Tube* self, double outer_radius, double inner_radius, double bending_stiffness, double torsional_stiffness,
               double collar_length, const std::vector<ctr::Section>& sections, double ovality, double ovality_axis, double softening_strain,
               double softening_fraction, double shaft_compliance, double mass_per_length, bool retractable) {
    new (self) ctr::Tube{outer_radius, inner_radius, bending_stiffness, torsional_stiffness, collar_length,    sections,
                         ovality,      ovality_axis, softening_strain,  softening_fraction,  shaft_compliance, mass_per_length, retractable};
}

void make_loads(ctr::Loads* self, const std::array<double, 3>& tip_force, const std::array<double, 3>& tip_moment,
                const std::array<double, 3>& gravity) {
    new (self) ctr::Loads();
    std::copy(tip_force.begin(), tip_force.end(), self->tip_force);
    std::copy(tip_moment.begin(), tip_moment.end(), self->tip_moment);
    std::copy(gravity.begin(), gravity.end(), self->gravity);
}

}  // namespace

void bind_robot(nb::module_& m) {
    nb::class_<ctr::Section>(m, "Section")
        .def("__init__", [](ctr::Section* self, double length, double curvature_x, double curvature_y, double gradient) {
            new (self) ctr::Section{length, curvature_x, curvature_y, gradient};
        }, nb::kw_only(), "length"_a, "curvature_x"_a, "curvature_y"_a, "gradient"_a);
    nb::class_<ctr::Tube>(m, "Tube")
        .def("__init__", &make_tube, nb::kw_only(), "outer_radius"_a, "inner_radius"_a, "bending_stiffness"_a, "torsional_stiffness"_a,
             "collar_length"_a, "sections"_a, "ovality"_a, "ovality_axis"_a, "softening_strain"_a, "softening_fraction"_a,
             "shaft_compliance"_a, "mass_per_length"_a, "retractable"_a);
    nb::class_<ctr::Pair>(m, "Pair")
        .def("__init__", [](ctr::Pair* self, double clearance, double friction, double outer_inner_radius, double inner_outer_radius) {
            new (self) ctr::Pair{clearance, friction, outer_inner_radius, inner_outer_radius};
        }, nb::kw_only(), "clearance"_a, "friction"_a, "outer_inner_radius"_a, "inner_outer_radius"_a);
    nb::class_<ctr::Loads>(m, "Loads")
        .def("__init__", &make_loads, nb::kw_only(), "tip_force"_a, "tip_moment"_a, "gravity"_a);
}
