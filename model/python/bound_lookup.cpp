#include "bound_lookup.hpp"

#include <cstddef>

#include "bindings.hpp"
#include "configurations.hpp"
#include "walk.hpp"

namespace {

std::vector<ctr::FieldAxis> read(const ctr::Robot& robot, const FieldLookup::Axes& given, const FieldLookup::Values& values) {
    std::vector<ctr::FieldAxis> axes;
    std::size_t points = 1;
    for (const auto& [tube, rotation, lower, step, count] : given) {
        if (tube < (rotation ? 1 : 0) || tube >= robot.count() || count < 2 || !(step > 0)) throw ctr::InvalidInput("an axis of the bound field is malformed");
        axes.push_back({tube, rotation, lower, step, count});
        points *= static_cast<std::size_t>(count);
    }
    if (axes.size() > ctr::kMostAxes || values.shape(0) != points || values.shape(1) != ctr::kFieldFloats)
        throw ctr::InvalidInput("the values of the bound field do not fit its axes");
    return axes;
}

// Where in a row of an entry its numbers stand: name -> (first, count).
nb::dict entry_columns() {
    nb::dict columns;
    auto add = [&](const char* name, std::size_t offset, std::size_t size) { columns[name] = nb::make_tuple(offset / sizeof(float), size / sizeof(float)); };
#define CTR_COLUMN(member) add(#member, offsetof(ctr::FieldEntry, member), sizeof(ctr::FieldEntry::member))
    CTR_COLUMN(position);
    CTR_COLUMN(tangent);
    CTR_COLUMN(stability);
    CTR_COLUMN(strain);
    CTR_COLUMN(valid);
    CTR_COLUMN(point);
    CTR_COLUMN(tip_tangent);
    CTR_COLUMN(envelope);
#undef CTR_COLUMN
    return columns;
}

}  // namespace

nb::object to_python(const std::vector<ctr::FieldEntry>& entries) {
    const float* first = reinterpret_cast<const float*>(entries.data());
    return array(std::vector<double>(first, first + entries.size() * ctr::kFieldFloats), {entries.size(), static_cast<std::size_t>(ctr::kFieldFloats)});
}

FieldLookup::FieldLookup(const ctr::Robot& robot, const Axes& axes, Values values, double margin)
    : robot_(robot), values_(values), field_(robot, read(robot, axes, values), values.data(), margin) {}

nb::object FieldLookup::sample(Matrix theta, Matrix l) const {
    const std::vector<ctr::Configuration> all = configurations(theta, l, robot_.count());
    return to_python(column<ctr::FieldEntry>(all, [&](const ctr::Configuration& q) { return field_.sample(q); }));
}

nb::dict FieldLookup::check_path(Matrix theta, Matrix l, const Grid* grid, const ctr::PathDensity& density, const ctr::PathLimits& limits) const {
    return to_python(field_.check_path(configurations(theta, l, robot_.count()), field_of(grid), density, limits), false);
}

void bind_bound_lookup(nb::module_& m) {
    m.def("entry_columns", &entry_columns, "where the numbers of an entry stand: name -> (first, count)");
    nb::class_<FieldLookup>(m, "FieldLookup")
        .def("sample", &FieldLookup::sample, "theta_b"_a.noconvert(), "l_b"_a.noconvert())
        .def("check_path", &FieldLookup::check_path, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "field"_a.none(), "density"_a, "limits"_a);
}
