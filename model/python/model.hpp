// Binding of a robot: its shapes, bounds, tips and motions.
#pragma once

#include <limits>
#include <memory>

#include "arrays.hpp"
#include "configurations.hpp"
#include "ctr/tip_solver.hpp"
#include "field_lookup.hpp"
#include "path_history.hpp"
#include "solver_pool.hpp"

// A robot and its solvers.
class Model {
  public:
    Model(const std::vector<std::vector<double>>& tubes, const std::vector<std::vector<std::vector<double>>>& sections,
          const std::vector<std::vector<double>>& pairs, const std::vector<std::vector<double>>& loads) {
        for (std::size_t i = 0; i < tubes.size(); ++i) {
            const std::vector<double>& t = tubes[i];
            if (t.size() != 11) throw ctr::InvalidInput("a tube is given by eleven numbers");
            ctr::Tube tube{t[0], t[1], t[2], t[3], t[4], {}, t[5], t[6], t[7], t[8], t[9], t[10]};
            for (const std::vector<double>& s : sections.at(i)) tube.sections.push_back({s.at(0), s.at(1), s.at(2), s.at(3)});
            robot_.tubes.push_back(tube);
        }
        for (const std::vector<double>& p : pairs) robot_.pairs.push_back({p.at(0), p.at(1), p.at(2), p.at(3)});
        for (int k = 0; k < 3; ++k) {
            robot_.loads.tip_force[k] = loads.at(0).at(k);
            robot_.loads.tip_moment[k] = loads.at(1).at(k);
            robot_.loads.gravity[k] = loads.at(2).at(k);
        }
        ctr::validate(robot_);
        if (robot_.count() > ctr::kMaxTubes) throw ctr::InvalidInput("at most 12 tubes are supported");
    }

    nb::dict zero_clearance(Vector theta, Vector l) {
        const ctr::Configuration q = valid_configuration(robot_, theta, l);
        ctr::ZeroClearance solution;
        ctr::Shape shape;
        {
            nb::gil_scoped_release release;
            const bool done = solution.solve(robot_, q);
            shape = ctr::make_shape(robot_, solution, q);
            ctr::ZeroClearance other;
            if (!done) shape.status = ctr::Status::failed;
            else if (solution.negative_pivots()) shape.status = ctr::Status::unstable;
            else shape.status = solution.search_other(0, other) >= 0 ? ctr::Status::multiple : ctr::Status::converged;
        }
        return to_python(shape);
    }

    nb::dict solve(Vector theta, Vector l, Vector phi, int level, double refinement) {
        const ctr::Configuration q = valid_configuration(robot_, theta, l);
        if (phi.shape(0) != robot_.pairs.size()) throw ctr::InvalidInput("phi needs one value per neighbouring pair");
        const std::vector<double> friction(phi.data(), phi.data() + phi.shape(0));
        ctr::Shape shape;
        {
            nb::gil_scoped_release release;
            SolverPool::Loan loan(solvers_);
            loan->solve_single(q, accuracy(level).refined(refinement), friction);
            shape = ctr::make_shape(loan->solver(), loan->frictionless_state(), 0, q);
            shape.status = loan->status();
            shape.stability = loan->stability();
            shape.residual = loan->frictionless().residual;
        }
        return to_python(shape);
    }

    nb::dict bound(Vector theta, Vector l, int level) {
        const ctr::Configuration q = valid_configuration(robot_, theta, l);
        std::vector<ctr::Shape> shapes;
        double position = 0, tangent = 0;
        std::vector<double> envelope;
        int worst = 0;
        {
            nb::gil_scoped_release release;
            SolverPool::Loan loan(solvers_);
            loan->solve(q, accuracy(level));
            loan->search_others();
            position = loan->position;
            tangent = loan->tangent;
            envelope = loan->envelope;
            worst = loan->worst_corner;
            shapes.push_back(ctr::make_shape(loan->solver(), loan->frictionless_state(), 0, q));
            shapes.back().status = loan->status();
            shapes.back().stability = loan->stability();
            shapes.back().residual = loan->frictionless().residual;
            for (int k = 0; k < loan->corners(); ++k) {
                shapes.push_back(ctr::make_shape(loan->solver(), loan->corner_state(k), loan->corner_lane(k), q));
                shapes.back().residual = loan->corner(k).residual;
                shapes.back().stability = loan->stability();
                shapes.back().status = loan->corner(k).converged ? loan->status() : ctr::Status::failed;
            }
        }
        nb::list corners;
        for (std::size_t k = 1; k < shapes.size(); ++k) corners.append(to_python(shapes[k]));
        nb::dict result;
        result["position"] = position;
        result["tangent"] = tangent;
        result["envelope"] = array(envelope);
        result["worst_corner"] = worst;
        result["frictionless"] = to_python(shapes[0]);
        result["corners"] = corners;
        return result;
    }

    // Columns of the result: position bound, tangent bound, stability, max strain, residual, status, tip (3), tangent (3).
    nb::object bound_many(Matrix theta, Matrix l, int level, int threads) {
        const std::vector<ctr::Configuration> all = valid_configurations(robot_, theta, l);
        constexpr std::size_t kColumns = 12;
        std::vector<double> out(all.size() * kColumns);
        {
            nb::gil_scoped_release release;
            solvers_.parallel(all.size(), threads, [&](ctr::BoundSolver& solver, std::size_t k) {
                solver.solve(all[k], accuracy(level));
                solver.search_others();
                double* row = &out[k * kColumns];
                row[0] = solver.position;
                row[1] = solver.tangent;
                row[2] = solver.stability();
                row[3] = solver.max_strain;
                row[4] = solver.frictionless().residual;
                for (int c = 0; c < solver.corners(); ++c) row[4] = std::max(row[4], solver.corner(c).residual);
                row[5] = static_cast<int>(solver.all_converged() ? solver.status() : ctr::Status::failed);
                const ctr::Frame& tip = solver.backbone.frame.back();
                const ctr::Vec3 tangent = tip.tangent();
                const bool found = solver.frictionless().converged;
                for (int i = 0; i < 3; ++i) {
                    row[6 + i] = found ? tip.p[i] : std::numeric_limits<double>::quiet_NaN();
                    row[9 + i] = found ? tangent[i] : std::numeric_limits<double>::quiet_NaN();
                }
                if (!found) row[2] = row[3] = std::numeric_limits<double>::quiet_NaN();
            });
        }
        return array(std::move(out), {all.size(), kColumns});
    }

    // Zero-clearance tips of many configurations: tip (3), tangent (3), status.
    nb::object tips(Matrix theta, Matrix l, int threads) {
        const std::vector<ctr::Configuration> all = valid_configurations(robot_, theta, l);
        std::vector<double> out(all.size() * 7);
        {
            nb::gil_scoped_release release;
            solvers_.parallel(all.size(), threads, [&](ctr::BoundSolver& solver, std::size_t k) {
                ctr::ZeroClearance& solution = solver.zero_clearance();
                const bool done = solution.solve(robot_, all[k]);
                const ctr::Frame tip = solution.tip();
                const ctr::Vec3 tangent = tip.tangent();
                double* row = &out[k * 7];
                for (int i = 0; i < 3; ++i) {
                    row[i] = tip.p[i];
                    row[3 + i] = tangent[i];
                }
                row[6] = !done ? 3 : solution.negative_pivots() ? 2 : 0;
            });
        }
        return array(std::move(out), {all.size(), 7});
    }

    // Zero-clearance shapes in front of the plate: clearance at points `step` apart, -inf without a stable solution, tip (3).
    nb::object rooms(Matrix theta, Matrix l, nb::object field, Vector origin, double spacing, Matrix R_AB, Vector p_AB, double step,
                     int threads) {
        const std::vector<ctr::Configuration> all = valid_configurations(robot_, theta, l);
        Field values;
        const ctr::SignedDistanceField sdf = distance_field(field, values, origin, spacing, R_AB, p_AB);
        std::vector<double> out(all.size() * 4);
        {
            nb::gil_scoped_release release;
            solvers_.parallel(all.size(), threads, [&](ctr::BoundSolver& solver, std::size_t k) {
                ctr::ZeroClearance& solution = solver.zero_clearance();
                const bool stable = solution.solve(robot_, all[k]) && !solution.negative_pivots();
                ctr::Frame tip;
                const double clearance = solution.clearance(robot_, sdf, step, tip);
                out[4 * k] = stable ? clearance : -std::numeric_limits<double>::infinity();
                for (int i = 0; i < 3; ++i) out[4 * k + 1 + i] = tip.p[i];
            });
        }
        return array(std::move(out), {all.size(), 4});
    }

    std::unique_ptr<PathHistory> history(int level, double breakaway, double rotation, double translation, double state_change) const {
        ctr::HistoryOptions options;
        options.breakaway = breakaway;
        options.rotation = rotation;
        options.translation = translation;
        options.state_change = state_change;
        return std::make_unique<PathHistory>(robot_, accuracy(level), options);
    }

    std::vector<std::string> number_names() const { return ctr::number_names(robot_); }

    // Tips under friction of many configurations, phi (K, pairs). Columns: tip (3), tangent (3), status, residual, max strain,
    // then per direction the derivatives of tip (3) and tangent (3). A direction is (indices into number_names, weights, step).
    nb::object tips_with_friction(Matrix theta, Matrix l, Matrix phi,
                                  const std::vector<std::tuple<std::vector<int>, std::vector<double>, double>>& given,
                                  int level, int threads) {
        const std::vector<ctr::Configuration> all = valid_configurations(robot_, theta, l);
        const std::size_t pairs = robot_.pairs.size();
        if (phi.shape(0) != all.size() || phi.shape(1) != pairs) throw ctr::InvalidInput("phi needs one row per configuration, one value per pair");
        const int names = static_cast<int>(ctr::number_names(robot_).size());
        std::vector<ctr::Direction> directions;
        for (const auto& [indices, weights, step] : given) {
            directions.push_back({{}, step});
            for (std::size_t k = 0; k < indices.size(); ++k) {
                if (indices[k] < 0 || indices[k] >= names) throw ctr::InvalidInput("a direction names a number that does not exist");
                directions.back().weights.emplace_back(indices[k], weights.at(k));
            }
        }
        const std::size_t columns = 9 + 6 * directions.size();
        std::vector<double> out(all.size() * columns, std::numeric_limits<double>::quiet_NaN());
        // rows of one configuration stay together, they share their mesh
        std::vector<std::size_t> first;
        for (std::size_t k = 0; k < all.size(); ++k)
            if (k == 0 || all[k].theta != all[k - 1].theta || all[k].l != all[k - 1].l) first.push_back(k);
        first.push_back(all.size());
        {
            nb::gil_scoped_release release;
            share(first.size() - 1, threads, [&] { return std::make_unique<ctr::TipSolver>(robot_); }, [&](ctr::TipSolver& solver, std::size_t group) {
                std::vector<ctr::TipDerivative> derivatives;
                for (std::size_t k = first[group]; k < first[group + 1]; ++k) {
                    const double* state = phi.data() + k * pairs;
                    ctr::Status status = solver.solve(all[k], accuracy(level), std::vector<double>(state, state + pairs));
                    double* row = &out[k * columns];
                    const ctr::Vec3 tangent = solver.tip().tangent();
                    for (int i = 0; i < 3; ++i) {
                        row[i] = solver.tip().p[i];
                        row[3 + i] = tangent[i];
                    }
                    row[6] = static_cast<int>(status);
                    row[7] = solver.convergence().residual;
                    row[8] = solver.max_strain();
                    if (directions.empty() || status == ctr::Status::failed) continue;
                    solver.differentiate(directions, derivatives);
                    for (std::size_t j = 0; j < directions.size(); ++j)
                        for (int i = 0; i < 3; ++i) {
                            row[9 + 6 * j + i] = derivatives[j].position[i];
                            row[12 + 6 * j + i] = derivatives[j].tangent[i];
                        }
                }
            });
        }
        return array(std::move(out), {all.size(), columns});
    }

    // See ctr::check_path. Columns: segment, fraction, position bound, tangent bound, stability, max strain, clearance,
    // motion, status, tip (3), tangent (3), solves, tip of each corner (3). density: the five numbers of ctr::PathDensity;
    // limits: the three of PathLimits. With bodies, a second item lists per sample the points (N, 4) of all shapes with their outer radius.
    nb::tuple check_path(Matrix theta, Matrix l, nb::object field, Vector origin, double spacing, Matrix R_AB, Vector p_AB,
                         Vector density_values, Vector limit_values, int level, bool bodies) {
        const std::vector<ctr::Configuration> corners = valid_configurations(robot_, theta, l);
        Field values;
        const ctr::SignedDistanceField sdf = distance_field(field, values, origin, spacing, R_AB, p_AB);
        const ctr::PathLimits limits{limit_values(0), limit_values(1), limit_values(2)};
        const ctr::PathDensity path{density_values(0), density_values(1), density_values(2), density_values(3), density_values(4)};
        std::vector<ctr::PathSample> samples;
        {
            nb::gil_scoped_release release;
            SolverPool::Loan loan(solvers_);
            samples = ctr::check_path(*loan, corners, accuracy(level), sdf, path, limits, bodies);
        }
        nb::list points;
        if (bodies)
            for (ctr::PathSample& s : samples) {
                const std::size_t rows = s.body.size() / 4;
                points.append(array(std::move(s.body), {rows, 4}));
            }
        return nb::make_tuple(table(samples), points);
    }

    // Grid points of a bound field: rows as ctr::FieldEntry.
    nb::object field_entries(Matrix theta, Matrix l, int threads) {
        const std::vector<ctr::Configuration> all = valid_configurations(robot_, theta, l);
        std::vector<double> out(all.size() * ctr::kFieldFloats);
        {
            nb::gil_scoped_release release;
            solvers_.parallel(all.size(), threads, [&](ctr::BoundSolver& solver, std::size_t k) {
                const ctr::FieldEntry entry = ctr::field_entry(solver, all[k], accuracy(0));
                const float* numbers = reinterpret_cast<const float*>(&entry);
                std::copy(numbers, numbers + ctr::kFieldFloats, out.begin() + static_cast<long>(k) * ctr::kFieldFloats);
            });
        }
        return array(std::move(out), {all.size(), static_cast<std::size_t>(ctr::kFieldFloats)});
    }

    std::unique_ptr<FieldLookup> field_lookup(const std::vector<std::tuple<int, bool, double, double, int>>& axes, FieldLookup::Values values,
                                              double margin) const {
        return std::make_unique<FieldLookup>(robot_, axes, values, margin);
    }

    // Body points of the frictionless and all corner shapes in front of the plate: (shapes, N, 4) x, y, z, outer radius.
    nb::object body(Vector theta, Vector l, int level) {
        const ctr::Configuration q = valid_configuration(robot_, theta, l);
        std::vector<double> out;
        std::size_t shapes = 0, points = 0;
        {
            nb::gil_scoped_release release;
            SolverPool::Loan loan(solvers_);
            loan->solve(q, accuracy(level));
            const ctr::Mesh& mesh = loan->solver().mesh();
            const ctr::KernelProblem& pb = mesh.problem();
            auto add = [&](const ctr::Backbone& shape) {
                points = 0;
                for (int k = 0; k < pb.nodes; ++k) {
                    if (mesh.s()[k] < 0) continue;
                    const int m = pb.element_tubes[std::min(k, pb.elements - 1)];
                    out.insert(out.end(), shape.outer_position[k].begin(), shape.outer_position[k].end());
                    out.push_back(robot_.tubes[pb.tubes - m].outer_radius);
                    ++points;
                }
                ++shapes;
            };
            add(loan->backbone);
            for (const ctr::Backbone& shape : loan->corner_backbones) add(shape);
        }
        return array(std::move(out), {shapes, points, 4});
    }

  private:
    ctr::Robot robot_;
    SolverPool solvers_{robot_};
};
