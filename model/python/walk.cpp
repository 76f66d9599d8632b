// The records of a walk: how densely, until what, through which grid; and what was found.
#include "walk.hpp"

#include <algorithm>

#include "bindings.hpp"

namespace {

using Sample = ctr::PathSample;

template <class Number>
nb::object numbers(const std::vector<Sample>& samples, Number Sample::* member) {
    return array(column<double>(samples, [&](const Sample& s) { return static_cast<double>(s.*member); }));
}

nb::object counts(const std::vector<Sample>& samples, int Sample::* member) {
    return hand_over<std::int64_t>(column<std::int64_t>(samples, [&](const Sample& s) { return s.*member; }), {samples.size()});
}

nb::object corner_tips(const std::vector<Sample>& samples) {
    const std::size_t corners = samples.empty() ? 0 : samples.front().corner_tips.size();
    std::vector<ctr::Vec3> tips;
    for (const Sample& s : samples) tips.insert(tips.end(), s.corner_tips.begin(), s.corner_tips.end());
    return hand_over<double>(std::move(tips), {samples.size(), corners, 3});
}

nb::object of_shapes(const std::vector<Sample>& samples, std::vector<double> Sample::* member) {
    const std::size_t shapes = samples.empty() ? 0 : (samples.front().*member).size();
    std::vector<double> all;
    for (const Sample& s : samples) all.insert(all.end(), (s.*member).begin(), (s.*member).end());
    return array(std::move(all), {samples.size(), shapes});
}

void make_grid(Grid* self, Grid::Values values, Vector origin, double spacing, Matrix R_AB, Vector p_AB) {
    if (origin.size() != 3 || R_AB.size() != 9 || p_AB.size() != 3) throw ctr::InvalidInput("the pose of a grid is malformed");
    new (self) Grid{values, {}};
    ctr::SignedDistanceField& field = self->field;
    field.values = values.data();
    field.nx = static_cast<int>(values.shape(0));
    field.ny = static_cast<int>(values.shape(1));
    field.nz = static_cast<int>(values.shape(2));
    field.spacing = spacing;
    std::copy_n(R_AB.data(), 9, field.R_AB.begin());
    std::copy_n(p_AB.data(), 3, field.p_AB.begin());
    std::copy_n(origin.data(), 3, field.origin.begin());
}

nb::object sample(const Grid& grid, Matrix points) {
    if (points.shape(1) != 3) throw ctr::InvalidInput("points have three coordinates");
    std::vector<double> found(points.shape(0));
    const double* p = points.data();
    {
        const nb::gil_scoped_release release;
        for (std::size_t k = 0; k < found.size(); ++k) found[k] = grid.field.sample({p[3 * k], p[3 * k + 1], p[3 * k + 2]});
    }
    return array(std::move(found));
}

}  // namespace

nb::dict to_python(std::vector<Sample>&& samples, bool shapes) {
    nb::dict made;
    made["segment"] = counts(samples, &Sample::segment);
    made["fraction"] = numbers(samples, &Sample::fraction);
    made["position_m"] = numbers(samples, &Sample::position_bound);
    made["tangent_rad"] = numbers(samples, &Sample::tangent_bound);
    made["stability"] = numbers(samples, &Sample::stability);
    made["max_strain"] = numbers(samples, &Sample::max_strain);
    made["clearance_m"] = numbers(samples, &Sample::clearance);
    made["motion_m"] = numbers(samples, &Sample::motion);
    made["status"] = array(column<ctr::Status>(samples, [](const Sample& s) { return s.status; }));
    made["tip_m"] = array(column<ctr::Vec3>(samples, [](const Sample& s) { return s.tip; }));
    made["tip_tangent"] = array(column<ctr::Vec3>(samples, [](const Sample& s) { return s.tangent; }));
    made["solves"] = counts(samples, &Sample::solves);
    made["corner_tip_m"] = corner_tips(samples);
    made["nearest_phi"] = of_shapes(samples, &Sample::nearest_phi);
    nb::list points;
    for (Sample& s : samples) {
        const std::size_t rows = s.body.size() / 4;
        if (shapes) points.append(array(std::move(s.body), {rows, 4}));
    }
    made["shape_stability"] = of_shapes(samples, &Sample::shape_stability);
    made["shape_max_strain"] = of_shapes(samples, &Sample::shape_max_strain);
    made["bodies"] = nb::tuple(points);
    return made;
}

void bind_walk(nb::module_& m) {
    nb::class_<Grid>(m, "Grid")
        .def("__init__", &make_grid, nb::kw_only(), "values"_a.noconvert(), "origin"_a.noconvert(), "spacing"_a, "R_AB"_a.noconvert(),
             "p_AB"_a.noconvert())
        .def("sample", &sample, "points_m"_a.noconvert());
    nb::class_<ctr::PathDensity>(m, "PathDensity")
        .def("__init__", [](ctr::PathDensity* self, double rotation, double translation, double motion, double near, double point_spacing,
                            bool between_corners) {
            new (self) ctr::PathDensity{rotation, translation, motion, near, point_spacing, between_corners};
        }, nb::kw_only(), "rotation"_a, "translation"_a, "motion"_a, "near"_a, "point_spacing"_a, "between_corners"_a);
    nb::class_<ctr::PathLimits>(m, "PathLimits")
        .def("__init__", [](ctr::PathLimits* self, double stability, double max_strain, double clearance) {
            new (self) ctr::PathLimits{stability, max_strain, clearance};
        }, nb::kw_only(), "stability"_a, "max_strain"_a, "clearance"_a);
}
