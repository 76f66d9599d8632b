// Shapes as dictionaries of arrays, by the names of ctrplan.mechanics.shapes.
#pragma once

#include <nanobind/stl/shared_ptr.h>

#include <memory>

#include "arrays.hpp"
#include "ctr/shape.hpp"

inline nb::dict to_python(ctr::TubeShape&& tube) {
    nb::dict made;
    made["s_m"] = array(std::move(tube.s));
    made["centreline_m"] = array(std::move(tube.position));
    made["frames"] = array(std::move(tube.frame));
    made["theta_rad"] = array(std::move(tube.theta));
    made["curvature_per_m"] = array(std::move(tube.curvature));
    made["strain"] = array(std::move(tube.strain));
    return made;
}

inline nb::dict to_python(ctr::Shape&& shape) {
    nb::list tubes, s, force, angle;
    for (ctr::TubeShape& tube : shape.tubes) tubes.append(to_python(std::move(tube)));
    for (ctr::ContactForces& contact : shape.contacts) {
        s.append(array(std::move(contact.s)));
        force.append(array(std::move(contact.force)));
        angle.append(array(std::move(contact.angle)));
    }
    nb::dict made;
    made["tubes"] = tubes;
    made["radius_m"] = array(std::move(shape.radius));
    made["contact_s_m"] = nb::tuple(s);
    made["contact_force_N"] = nb::tuple(force);
    made["contact_angle_rad"] = nb::tuple(angle);
    made["status"] = static_cast<int>(shape.status);
    made["residual"] = shape.residual;
    made["stability"] = shape.stability;
    made["max_strain"] = shape.max_strain;
    made["equilibrium"] = shape.equilibrium;
    return made;
}
