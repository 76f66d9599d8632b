// Between numpy and the core: arrays, shapes, samples of paths.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <vector>

#include "ctr/walk.hpp"
#include "ctr/shape.hpp"

namespace nb = nanobind;
using namespace nb::literals;

using Vector = nb::ndarray<const double, nb::numpy, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Matrix = nb::ndarray<const double, nb::numpy, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Field = nb::ndarray<const float, nb::numpy, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// Hands a buffer over to numpy.
inline nb::object array(std::vector<double>&& values, std::initializer_list<std::size_t> shape) {
    auto* owned = new std::vector<double>(std::move(values));
    nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<double>*>(p); });
    return nb::cast(nb::ndarray<nb::numpy, double>(owned->data(), shape, owner));
}

inline nb::object array(const std::vector<ctr::Vec3>& values) {
    std::vector<double> flat;
    flat.reserve(values.size() * 3);
    for (const ctr::Vec3& v : values) flat.insert(flat.end(), v.begin(), v.end());
    return array(std::move(flat), {values.size(), 3});
}

inline nb::object array(const std::vector<std::array<double, 9>>& values) {
    std::vector<double> flat;
    flat.reserve(values.size() * 9);
    for (const auto& v : values) flat.insert(flat.end(), v.begin(), v.end());
    return array(std::move(flat), {values.size(), 3, 3});
}

inline nb::object array(const std::vector<double>& values) {
    std::vector<double> copy(values);
    return array(std::move(copy), {values.size()});
}

inline nb::dict to_python(const ctr::Shape& shape) {
    nb::list tubes, contacts;
    for (const ctr::TubeShape& tube : shape.tubes)
        tubes.append(nb::make_tuple(array(tube.s), array(tube.position), array(tube.frame), array(tube.theta),
                                    array(tube.curvature), array(tube.strain)));
    for (const ctr::ContactForces& contact : shape.contacts)
        contacts.append(nb::make_tuple(array(contact.s), array(contact.force), array(contact.angle)));
    nb::dict result;
    result["tubes"] = tubes;
    result["contacts"] = contacts;
    result["radius"] = array(shape.radius);
    result["status"] = static_cast<int>(shape.status);
    result["residual"] = shape.residual;
    result["stability"] = shape.stability;
    result["max_strain"] = shape.max_strain;
    return result;
}

// Levels as in ctrplan.mechanics.
inline ctr::Accuracy accuracy(int level) {
    return level == 2 ? ctr::Accuracy::exact_geometry() : level == 1 ? ctr::Accuracy::certificate() : ctr::Accuracy::search();
}

// A view of a grid given by Python; `values` keeps it alive.
inline ctr::SignedDistanceField distance_field(const nb::object& field, Field& values, const Vector& origin, double spacing, const Matrix& R_AB,
                                        const Vector& p_AB) {
    ctr::SignedDistanceField sdf;
    if (field.is_none()) return sdf;
    values = nb::cast<Field>(field);
    sdf.values = values.data();
    sdf.nx = static_cast<int>(values.shape(0));
    sdf.ny = static_cast<int>(values.shape(1));
    sdf.nz = static_cast<int>(values.shape(2));
    sdf.spacing = spacing;
    std::copy(R_AB.data(), R_AB.data() + 9, sdf.R_AB.begin());
    std::copy(p_AB.data(), p_AB.data() + 3, sdf.p_AB.begin());
    std::copy(origin.data(), origin.data() + 3, sdf.origin.begin());
    return sdf;
}

// Columns: segment, fraction, position bound, tangent bound, stability, max strain, clearance, motion, status, tip (3), tangent (3),
// solves, tip of each corner (3), which lookups don't know.
inline nb::object table(const std::vector<ctr::PathSample>& samples) {
    const std::size_t columns = 16 + 3 * (samples.empty() ? 0 : samples.front().corner_tips.size());
    std::vector<double> out;
    out.reserve(samples.size() * columns);
    for (const ctr::PathSample& s : samples) {
        for (double value : {static_cast<double>(s.segment), s.fraction, s.position_bound, s.tangent_bound, s.stability, s.max_strain,
                             s.clearance, s.motion, static_cast<double>(static_cast<int>(s.status))})
            out.push_back(value);
        out.insert(out.end(), s.tip.begin(), s.tip.end());
        out.insert(out.end(), s.tangent.begin(), s.tangent.end());
        out.push_back(s.solves);
        for (const ctr::Vec3& tip : s.corner_tips) out.insert(out.end(), tip.begin(), tip.end());
    }
    return array(std::move(out), {samples.size(), columns});
}
