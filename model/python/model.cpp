// A robot's compiled model (ctr/model.hpp): what it answers, as arrays by name.
#include "ctr/model.hpp"

#include <nanobind/stl/optional.h>

#include <memory>
#include <optional>
#include <tuple>

#include "bindings.hpp"
#include "bounds.hpp"
#include "configurations.hpp"
#include "ctr/tip_solver.hpp"
#include "history.hpp"
#include "shapes.hpp"
#include "unlocked.hpp"
#include "walk.hpp"

namespace {

using ctr::Model;
using Directions = std::vector<std::tuple<std::vector<int>, std::vector<double>, double>>;  // indices into number_names, weights, step

// guide: arc lengths s (K,), bases theta (R, n), l (R, n) and angles (R, n, K).
using Guided = std::tuple<Vector, Matrix, Matrix, Tensor>;

std::shared_ptr<const ctr::Guide> read(const Guided& given, std::size_t tubes) {
    const auto& [s, theta, l, angles] = given;
    const std::size_t rows = theta.shape(0), count = s.shape(0);
    if (rows == 0 || count == 0 || theta.shape(1) != tubes || l.shape(0) != rows || l.shape(1) != tubes || angles.shape(0) != rows ||
        angles.shape(1) != tubes || angles.shape(2) != count)
        throw ctr::InvalidInput("a guide needs arc lengths (places), rotations and translations (rows, tubes), angles (rows, tubes, places)");
    auto values = [](const auto& array) { return std::vector<double>(array.data(), array.data() + array.size()); };
    return std::make_shared<const ctr::Guide>(ctr::Guide{values(s), values(theta), values(l), values(angles), tubes});
}

void make_model(Model* self, const std::vector<ctr::Tube>& tubes, const std::vector<ctr::Pair>& pairs, const ctr::Loads& loads,
                const std::optional<Guided>& guide) {
    new (self) Model(ctr::Robot{tubes, pairs, loads, guide ? read(*guide, tubes.size()) : nullptr});
}

nb::object zero_clearance(const Model& model, Vector theta, Vector l) {
    const ctr::Configuration q = valid_configuration(model.robot(), theta, l);
    return to_python(unlocked([&] { return model.zero_clearance(q); }));
}

nb::object solve(Model& model, Vector theta, Vector l, Vector phi, const std::string& level, double refinement) {
    const ctr::Configuration q = valid_configuration(model.robot(), theta, l);
    const std::vector<double> friction = friction_state(model.robot(), phi);
    return to_python(unlocked([&] { return model.solve(q, accuracy(level).refined(refinement), friction); }));
}

nb::dict bound(Model& model, Vector theta, Vector l, const std::string& level, bool extremes_only, const nb::object& progress) {
    const ctr::Configuration q = valid_configuration(model.robot(), theta, l);
    return to_python(unlocked([&] { return model.bound(q, accuracy(level), extremes_only); }, progress));
}

nb::dict bound_many(Model& model, Matrix theta, Matrix l, const std::string& level, int threads) {
    const std::vector<ctr::Configuration> all = valid_configurations(model.robot(), theta, l);
    return to_python(unlocked([&] { return model.bounds(all, accuracy(level), threads); }));
}

// Zero-clearance tips, tangents and status.
nb::tuple tips(Model& model, Matrix theta, Matrix l, int threads, const nb::object& progress) {
    const std::vector<ctr::Configuration> all = valid_configurations(model.robot(), theta, l);
    ctr::TipRows rows = unlocked([&] { return model.zero_clearance_tips(all, threads); }, progress);
    return nb::make_tuple(array(std::move(rows.tip)), array(std::move(rows.tangent)), array(rows.status));
}

// Clearances of zero-clearance shapes at points `step` apart, and their tips.
nb::tuple clearances(Model& model, Matrix theta, Matrix l, const Grid* grid, double step, int threads) {
    const std::vector<ctr::Configuration> all = valid_configurations(model.robot(), theta, l);
    ctr::ClearanceRows rows = unlocked([&] { return model.zero_clearance_clearances(all, field_of(grid), step, threads); });
    return nb::make_tuple(array(std::move(rows.clearance)), array(std::move(rows.tip)));
}

std::vector<ctr::Direction> read(const Directions& given, int names) {
    std::vector<ctr::Direction> directions;
    for (const auto& [indices, weights, step] : given) {
        directions.push_back({{}, step});
        for (std::size_t k = 0; k < indices.size(); ++k) {
            if (indices[k] < 0 || indices[k] >= names) throw ctr::InvalidInput("a direction names a number that does not exist");
            directions.back().weights.emplace_back(indices[k], weights.at(k));
        }
    }
    return directions;
}

nb::dict tips_with_friction(const Model& model, Matrix theta, Matrix l, Matrix phi, const Directions& given, const std::string& level, int threads,
                           const nb::object& progress, ctr::TipMemory* memory, const std::vector<std::size_t>& places) {
    const std::vector<ctr::Configuration> all = valid_configurations(model.robot(), theta, l);
    if (memory && places.size() != all.size()) throw ctr::InvalidInput("places needs one number per configuration");
    if (phi.shape(0) != all.size() || phi.shape(1) != model.robot().pairs.size())
        throw ctr::InvalidInput("phi needs one row per configuration, one value per pair");
    const std::vector<ctr::Direction> directions = read(given, static_cast<int>(ctr::number_names(model.robot()).size()));
    ctr::FrictionTipRows rows = unlocked([&] { return model.friction_tips(all, phi.data(), directions, accuracy(level), threads, memory, places); },
                                           progress);
    nb::dict made;
    made["position_m"] = array(std::move(rows.tip));
    made["tangent"] = array(std::move(rows.tangent));
    made["status"] = array(rows.status);
    made["residual"] = array(std::move(rows.residual));
    made["max_strain"] = array(std::move(rows.max_strain));
    made["position_by"] = array(std::move(rows.tip_by), {all.size(), 3, rows.parameters});
    made["tangent_by"] = array(std::move(rows.tangent_by), {all.size(), 3, rows.parameters});
    return made;
}

// Points (N, 4) with outer radii, their derivatives (N, 3, P), stability and its derivatives (P).
nb::tuple body_derivatives(const Model& model, Vector theta, Vector l, Vector phi, const Directions& given, const std::string& level, double spacing) {
    const ctr::Configuration q = valid_configuration(model.robot(), theta, l);
    const std::vector<double> state = friction_state(model.robot(), phi);
    const std::vector<ctr::Direction> directions = read(given, static_cast<int>(ctr::number_names(model.robot()).size()));
    ctr::BodyDerivatives found = unlocked([&] { return model.body_derivatives(q, accuracy(level), state, directions, spacing); });
    const std::size_t count = found.point.size() / 4;
    return nb::make_tuple(array(std::move(found.point), {count, 4}), array(std::move(found.point_by), {count, 3, directions.size()}),
                          found.stability, array(std::move(found.stability_by)));
}

nb::dict check_path(Model& model, Matrix theta, Matrix l, const Grid* grid, const ctr::PathDensity& density, const ctr::PathLimits& limits,
                    const std::string& level, bool shapes) {
    const std::vector<ctr::Configuration> corners = valid_configurations(model.robot(), theta, l);
    return to_python(unlocked([&] { return model.check_path(corners, accuracy(level), field_of(grid), density, limits, shapes); }), shapes);
}

// Points (shapes, N, 3) and outer radii (N).
nb::tuple body(Model& model, Vector theta, Vector l, const std::string& level) {
    const ctr::Configuration q = valid_configuration(model.robot(), theta, l);
    ctr::Body found = unlocked([&] { return model.body(q, accuracy(level)); });
    const std::size_t shapes = found.shapes, count = found.radius.size();
    return nb::make_tuple(hand_over<double>(std::move(found.point), {shapes, count, 3}), array(std::move(found.radius)));
}

// Tips, tangents, status, stability, and angles of S rotations and friction states solved from shapes with angles (S, n, K) at s (K,).
nb::tuple solve_from(Model& model, Matrix theta, Vector l, Matrix phi, Vector s, Tensor angles, const std::string& level) {
    const std::size_t rows = phi.shape(0), tubes = model.robot().tubes.size(), count = s.shape(0);
    if (theta.shape(0) != rows || theta.shape(1) != tubes || phi.shape(1) + 1 != tubes || rows == 0)
        throw ctr::InvalidInput("shapes need rotations (states, tubes) and friction states (states, pairs)");
    if (angles.shape(0) != rows || angles.shape(1) != tubes || angles.shape(2) != count || count == 0)
        throw ctr::InvalidInput("shapes need angles (states, tubes, places)");
    const ctr::Configuration q{std::vector<double>(theta.data(), theta.data() + tubes), std::vector<double>(l.data(), l.data() + l.shape(0))};
    ctr::validate(model.robot(), q);
    const ctr::GivenShapes given{s.data(), angles.data(), theta.data(), phi.data(), count, rows};
    ctr::BranchRows found = unlocked([&] { return model.solve_from(q, accuracy(level), given); });
    return nb::make_tuple(array(std::move(found.tip)), array(std::move(found.tangent)), array(found.status), array(std::move(found.stability)),
                          array(std::move(found.theta), {rows, tubes, count}));
}

nb::object corners_apart(Model& model, Vector theta, Vector l, const std::string& level) {
    const ctr::Configuration q = valid_configuration(model.robot(), theta, l);
    return array(unlocked([&] { return model.corners_apart(q, accuracy(level)); }));
}

std::unique_ptr<PathHistory> history(const Model& model, const std::string& level, double breakaway, double rotation, double translation,
                                     double state_change) {
    return std::make_unique<PathHistory>(model.robot(), accuracy(level), ctr::HistoryOptions{breakaway, rotation, translation, state_change});
}

}  // namespace

void bind_model(nb::module_& m) {
    nb::class_<ctr::TipMemory>(m, "TipMemory", "Solutions near which those of the same places are sought").def(nb::init<>());
    nb::class_<Model>(m, "Model")
        .def("__init__", &make_model, "tubes"_a, "pairs"_a, "loads"_a, "guide"_a.none())
        .def("zero_clearance", &zero_clearance, "theta_b"_a.noconvert(), "l_b"_a.noconvert())
        .def("solve", &solve, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "phi"_a.noconvert(), "accuracy"_a, "refinement"_a)
        .def("bound", &bound, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "accuracy"_a, "extremes_only"_a, "progress"_a.none())
        .def("bound_many", &bound_many, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "accuracy"_a, "threads"_a)
        .def("tips", &tips, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "threads"_a, "progress"_a.none())
        .def("clearances", &clearances, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "field"_a.none(), "step"_a, "threads"_a)
        .def("history", &history, "accuracy"_a, "breakaway"_a, "rotation"_a, "translation"_a, "state_change"_a)
        .def("number_names", [](const Model& model) { return ctr::number_names(model.robot()); })
        .def("tips_with_friction", &tips_with_friction, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "phi"_a.noconvert(), "directions"_a,
             "accuracy"_a, "threads"_a, "progress"_a.none(), "memory"_a.none(), "places"_a)
        .def("body_derivatives", &body_derivatives, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "phi"_a.noconvert(), "directions"_a,
             "accuracy"_a, "spacing"_a)
        .def("check_path", &check_path, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "field"_a.none(), "density"_a, "limits"_a, "accuracy"_a,
             "shapes"_a)
        .def("solve_from", &solve_from, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "phi"_a.noconvert(), "s"_a.noconvert(),
             "angles"_a.noconvert(), "accuracy"_a)
        .def("corners_apart", &corners_apart, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "accuracy"_a)
        .def("body", &body, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "accuracy"_a);
}
