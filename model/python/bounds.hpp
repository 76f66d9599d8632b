// Bounds as dicts of arrays, by the names of ctrplan.mechanics.shapes.
#pragma once

#include "ctr/model.hpp"
#include "shapes.hpp"

inline nb::dict to_python(ctr::BoundShapes&& found) {
    const std::size_t corners = found.corners.size(), pairs = corners ? found.phi.size() / corners : 0;
    nb::list shapes;
    for (ctr::Shape& corner : found.corners) shapes.append(to_python(std::move(corner)));
    nb::dict made;
    made["position_m"] = found.position;
    made["tangent_rad"] = found.tangent;
    made["frictionless"] = to_python(std::move(found.frictionless));
    made["corners"] = shapes;
    made["corner_phi"] = array(std::move(found.phi), {corners, pairs});
    made["envelope_m"] = array(std::move(found.envelope));
    made["worst_corner"] = found.worst_corner;
    return made;
}

inline nb::dict to_python(ctr::BoundRows&& rows) {
    nb::dict made;
    made["position_m"] = array(std::move(rows.position_bound));
    made["tangent_rad"] = array(std::move(rows.tangent_bound));
    made["stability"] = array(std::move(rows.stability));
    made["max_strain"] = array(std::move(rows.max_strain));
    made["residual"] = array(std::move(rows.residual));
    made["status"] = array(rows.status);
    made["tip_m"] = array(std::move(rows.tip));
    made["tip_tangent"] = array(std::move(rows.tangent));
    return made;
}
