// A shape that Python holds. Most callers look at the tip alone: nothing else is converted before somebody does.
#include <cmath>

#include "bindings.hpp"
#include "shapes.hpp"

namespace {

using ctr::Shape;
using Self = nb::handle_t<Shape>;

Shape& of(Self self) {
    Shape& shape = nb::cast<Shape&>(self);
    shape.lay_out();
    return shape;
}

// Values of the shape, which the array keeps alive.
template <class Element>
nb::object view(std::vector<Element>& values, std::initializer_list<std::size_t> shape, Self owner) {
    return nb::cast(nb::ndarray<nb::numpy, double>(reinterpret_cast<double*>(values.data()), shape, owner));
}

nb::list tubes(Self self) {
    nb::list all;
    for (ctr::TubeShape& tube : of(self).tubes) {
        const std::size_t count = tube.s.size();
        nb::dict made;
        made["s_m"] = view(tube.s, {count}, self);
        made["centreline_m"] = view(tube.position, {count, 3}, self);
        made["frames"] = view(tube.frame, {count, 3, 3}, self);
        made["theta_rad"] = view(tube.theta, {count}, self);
        made["curvature_per_m"] = view(tube.curvature, {count, 3}, self);
        made["strain"] = view(tube.strain, {count}, self);
        all.append(made);
    }
    return all;
}

nb::object radius(Self self) { return view(of(self).radius, {of(self).radius.size()}, self); }

template <std::vector<double> ctr::ContactForces::*Values>
nb::tuple contacts(Self self) {
    nb::list all;
    for (ctr::ContactForces& contact : of(self).contacts) all.append(view(contact.*Values, {(contact.*Values).size()}, self));
    return nb::tuple(all);
}

nb::object vector(const ctr::Vec3& at) { return array(std::vector<double>(at.begin(), at.end())); }

// Whether every number is finite that a solution must have: the tip is not where a place or an angle before it is not.
bool is_finite(const Shape& shape) {
    auto finite = [](const ctr::Vec3& at) { return std::isfinite(at[0]) && std::isfinite(at[1]) && std::isfinite(at[2]); };
    return std::isfinite(shape.residual) && std::isfinite(shape.max_strain) && finite(shape.tip) && finite(shape.tip_tangent);
}

}  // namespace

void bind_shape(nb::module_& m) {
    nb::class_<Shape>(m, "Shape")
        .def_prop_ro("status", [](const Shape& shape) { return static_cast<int>(shape.status); })
        .def_ro("residual", &Shape::residual)
        .def_ro("stability", &Shape::stability)
        .def_prop_ro("max_strain", [](Self self) { return of(self).max_strain; })
        .def_ro("equilibrium", &Shape::equilibrium)
        .def_prop_ro("is_finite", &is_finite)
        .def_prop_ro("tip_m", [](const Shape& shape) { return vector(shape.tip); })
        .def_prop_ro("tip_tangent", [](const Shape& shape) { return vector(shape.tip_tangent); })
        .def("tubes", &tubes)
        .def_prop_ro("radius_m", &radius)
        .def_prop_ro("contact_s_m", &contacts<&ctr::ContactForces::s>)
        .def_prop_ro("contact_force_N", &contacts<&ctr::ContactForces::force>)
        .def_prop_ro("contact_angle_rad", &contacts<&ctr::ContactForces::angle>);
}
