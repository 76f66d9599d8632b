// The thin Python face of the core: arrays in, arrays and plain dictionaries out. ctrplan/mechanics.py is its only user.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <atomic>
#include <exception>
#include <limits>
#include <memory>
#include <mutex>
#include <thread>

#include "ctr/bound.hpp"
#include "ctr/bound_field.hpp"
#include "ctr/edge.hpp"
#include "ctr/history.hpp"
#include "ctr/kernel.hpp"
#include "ctr/shape.hpp"
#include "ctr/tip_solver.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Vector = nb::ndarray<const double, nb::numpy, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Matrix = nb::ndarray<const double, nb::numpy, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Field = nb::ndarray<const float, nb::numpy, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// Hands a buffer over to numpy.
nb::object array(std::vector<double>&& values, std::initializer_list<std::size_t> shape) {
    auto* owned = new std::vector<double>(std::move(values));
    nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<double>*>(p); });
    return nb::cast(nb::ndarray<nb::numpy, double>(owned->data(), shape, owner));
}

nb::object array(const std::vector<ctr::Vec3>& values) {
    std::vector<double> flat;
    flat.reserve(values.size() * 3);
    for (const ctr::Vec3& v : values) flat.insert(flat.end(), v.begin(), v.end());
    return array(std::move(flat), {values.size(), 3});
}

nb::object array(const std::vector<std::array<double, 9>>& values) {
    std::vector<double> flat;
    flat.reserve(values.size() * 9);
    for (const auto& v : values) flat.insert(flat.end(), v.begin(), v.end());
    return array(std::move(flat), {values.size(), 3, 3});
}

nb::object array(const std::vector<double>& values) {
    std::vector<double> copy(values);
    return array(std::move(copy), {values.size()});
}

nb::dict to_python(const ctr::Shape& shape) {
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
ctr::Accuracy accuracy(int level) {
    return level == 2 ? ctr::Accuracy::exact_geometry() : level == 1 ? ctr::Accuracy::certificate() : ctr::Accuracy::search();
}

ctr::Configuration configuration(const double* theta, const double* l, int n) {
    return {std::vector<double>(theta, theta + n), std::vector<double>(l, l + n)};
}

// A view of a grid given by Python; `values` keeps it alive.
ctr::SignedDistanceField distance_field(const nb::object& field, Field& values, const Vector& origin, double spacing, const Matrix& R_AB,
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
// tip of each corner (3), which lookups don't know.
nb::object table(const std::vector<ctr::PathSample>& samples) {
    const std::size_t columns = 15 + 3 * (samples.empty() ? 0 : samples.front().corner_tips.size());
    std::vector<double> out;
    out.reserve(samples.size() * columns);
    for (const ctr::PathSample& s : samples) {
        for (double value : {static_cast<double>(s.segment), s.fraction, s.position_bound, s.tangent_bound, s.stability, s.max_strain,
                             s.clearance, s.motion, static_cast<double>(static_cast<int>(s.status))})
            out.push_back(value);
        out.insert(out.end(), s.tip.begin(), s.tip.end());
        out.insert(out.end(), s.tangent.begin(), s.tangent.end());
        for (const ctr::Vec3& tip : s.corner_tips) out.insert(out.end(), tip.begin(), tip.end());
    }
    return array(std::move(out), {samples.size(), columns});
}

// The bound looked up on a grid (ctr/bound_field.hpp). axes: (tube, is rotation, lower, step, count), last one fastest.
class FieldLookup {
  public:
    using Values = nb::ndarray<const float, nb::numpy, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

    FieldLookup(const ctr::Robot& robot, const std::vector<std::tuple<int, bool, double, double, int>>& axes, Values values, double margin)
        : robot_(robot), values_(values), field_(robot, read(robot, axes, values), values.data(), margin) {}

    nb::object check_path(Matrix theta, Matrix l, nb::object field, Vector origin, double spacing, Matrix R_AB, Vector p_AB,
                          Vector density, Vector limit) const {
        const std::size_t n = robot_.tubes.size();
        if (theta.shape(1) != n || l.shape(1) != n || l.shape(0) != theta.shape(0))
            throw ctr::InvalidInput("theta_b and l_b need the same number of rows and one column per tube");
        std::vector<ctr::Configuration> corners;
        for (std::size_t k = 0; k < theta.shape(0); ++k)
            corners.push_back(configuration(theta.data() + k * n, l.data() + k * n, static_cast<int>(n)));
        Field values;
        const ctr::SignedDistanceField sdf = distance_field(field, values, origin, spacing, R_AB, p_AB);
        return table(field_.check_path(corners, sdf, {density(0), density(1), density(2), density(3), density(4)},
                                       {limit(0), limit(1), limit(2)}));
    }

    // Rows as FieldEntry.
    nb::object sample(Matrix theta, Matrix l) const {
        const std::size_t n = robot_.tubes.size(), rows = theta.shape(0);
        std::vector<double> out;
        for (std::size_t k = 0; k < rows; ++k) {
            const ctr::FieldEntry entry = field_.sample(configuration(theta.data() + k * n, l.data() + k * n, static_cast<int>(n)));
            const float* numbers = reinterpret_cast<const float*>(&entry);
            out.insert(out.end(), numbers, numbers + ctr::kFieldFloats);
        }
        return array(std::move(out), {rows, static_cast<std::size_t>(ctr::kFieldFloats)});
    }

  private:
    static std::vector<ctr::FieldAxis> read(const ctr::Robot& robot, const std::vector<std::tuple<int, bool, double, double, int>>& given,
                                            const Values& values) {
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

    ctr::Robot robot_;
    Values values_;
    ctr::BoundField field_;
};

// A simulation of what happens along a joint path (ctr/history.hpp).
class PathHistory {
  public:
    PathHistory(const ctr::Robot& robot, const ctr::Accuracy& accuracy, const ctr::HistoryOptions& options)
        : robot_(robot), history_(robot, accuracy, options) {}

    int start(Vector theta, Vector l, Vector phi) {
        if (phi.shape(0) != robot_.pairs.size()) throw ctr::InvalidInput("phi needs one value per neighbouring pair");
        const ctr::Configuration q = read(theta, l);
        std::vector<double> friction(phi.data(), phi.data() + phi.shape(0));
        friction.resize(std::max<std::size_t>(friction.size(), 1));
        nb::gil_scoped_release release;
        return static_cast<int>(history_.start(q, friction));
    }

    // status, residual, steps, snaps, work, growth of elastic energy, growth of breakaway energy, loss, smallest loss.
    nb::tuple advance(Vector theta, Vector l) {
        const ctr::Configuration q = read(theta, l);
        int status;
        {
            nb::gil_scoped_release release;
            status = static_cast<int>(history_.advance(q));
        }
        const ctr::EnergyBalance& energy = history_.energy();
        return nb::make_tuple(status, history_.residual(), history_.steps(), history_.snaps(), energy.work, energy.elastic,
                              energy.breakaway, energy.loss, energy.smallest_loss);
    }

    // Waypoint after waypoint; columns: status, snaps, tip (3), tangent (3), then per pair phi averaged by normal force.
    // Rows after a failure are NaN.
    nb::object follow(Matrix theta, Matrix l) {
        const std::size_t rows = theta.shape(0), n = robot_.tubes.size(), columns = 8 + n - 1;
        if (theta.shape(1) != n || l.shape(0) != rows || l.shape(1) != n)
            throw ctr::InvalidInput("theta_b and l_b need the same number of rows and one column per tube");
        std::vector<ctr::Configuration> path;
        for (std::size_t k = 0; k < rows; ++k) {
            path.push_back(configuration(theta.data() + k * n, l.data() + k * n, static_cast<int>(n)));
            try {
                ctr::validate(robot_, path.back());
            } catch (const ctr::InvalidInput& reason) {
                throw ctr::InvalidInput("row " + std::to_string(k) + ": " + reason.what());
            }
        }
        std::vector<double> out(rows * columns, std::numeric_limits<double>::quiet_NaN());
        {
            nb::gil_scoped_release release;
            ctr::Backbone backbone;
            for (std::size_t k = 0; k < rows; ++k) {
                double* row = &out[k * columns];
                row[0] = static_cast<int>(history_.advance(path[k]));
                if (history_.status() == ctr::Status::failed) break;
                ctr::trace_backbone(history_.solver(), history_.state(), 0, path[k].l.back(), backbone);
                row[1] = history_.snaps();
                const ctr::Vec3 tangent = backbone.frame.back().tangent();
                for (int i = 0; i < 3; ++i) {
                    row[2 + i] = backbone.frame.back().p[i];
                    row[5 + i] = tangent[i];
                }
                history_.mean_phi(row + 8);
            }
        }
        return array(std::move(out), {rows, columns});
    }

    nb::dict shape() const {
        ctr::Shape shape = ctr::make_shape(history_.solver(), history_.state(), 0, history_.configuration());
        shape.status = history_.status();
        shape.residual = history_.residual();
        shape.stability = std::numeric_limits<double>::quiet_NaN();
        return to_python(shape);
    }

    // Per pair, outermost first: s, phi, psi, normal force of every contact.
    nb::list friction() const {
        const ctr::KernelProblem& pb = history_.solver().mesh().problem();
        nb::list pairs;
        const ctr::Shape shape = ctr::make_shape(history_.solver(), history_.state(), 0, history_.configuration());
        for (int pair = 0; pair + 1 < pb.tubes; ++pair) {
            std::vector<double> phi, psi;
            for (int k = 0; k < pb.contacts; ++k)
                if (pb.contact_pair[k] == pb.tubes - 2 - pair) {
                    phi.push_back(history_.phi()[k]);
                    psi.push_back(history_.psi()[k]);
                }
            pairs.append(nb::make_tuple(array(shape.contacts[pair].s), array(phi), array(psi), array(shape.contacts[pair].force)));
        }
        return pairs;
    }

    // Tip (3) and tangent (3) at friction states phi on the branch that the history is on; NaN where it ends before.
    nb::object beside(Vector phi) {
        if (phi.shape(0) != robot_.pairs.size()) throw ctr::InvalidInput("phi needs one value per neighbouring pair");
        const std::vector<double> friction(phi.data(), phi.data() + phi.shape(0));
        std::vector<double> out(6, std::numeric_limits<double>::quiet_NaN());
        {
            nb::gil_scoped_release release;
            ctr::Backbone backbone;
            if (history_.solve_beside(friction, backbone)) {
                const ctr::Vec3 tangent = backbone.frame.back().tangent();
                for (int i = 0; i < 3; ++i) {
                    out[i] = backbone.frame.back().p[i];
                    out[3 + i] = tangent[i];
                }
            }
        }
        return array(std::move(out), {6});
    }

    ctr::History::State save() const { return history_.save(); }
    void restore(const ctr::History::State& state) { history_.restore(state); }

  private:
    ctr::Configuration read(const Vector& theta, const Vector& l) const {
        const ctr::Configuration q{std::vector<double>(theta.data(), theta.data() + theta.shape(0)),
                                   std::vector<double>(l.data(), l.data() + l.shape(0))};
        ctr::validate(robot_, q);
        return q;
    }

    ctr::Robot robot_;
    ctr::History history_;
};

// A robot with a pool of solvers, one per thread that asks at the same time.
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
        const ctr::Configuration q = read(theta, l);
        ctr::ZeroClearance solution;
        ctr::Shape shape;
        {
            nb::gil_scoped_release release;
            const bool done = solution.solve(robot_, q);
            shape = ctr::make_shape(robot_, solution, q);
            ctr::ZeroClearance other;
            if (!done) shape.status = ctr::Status::failed;
            else if (solution.negative_pivots()) shape.status = ctr::Status::unstable;
            else shape.status = solution.search_other(robot_, q, 0, other) >= 0 ? ctr::Status::multiple : ctr::Status::converged;
        }
        return to_python(shape);
    }

    nb::dict solve(Vector theta, Vector l, Vector phi, int level, double refinement) {
        const ctr::Configuration q = read(theta, l);
        if (phi.shape(0) != robot_.pairs.size()) throw ctr::InvalidInput("phi needs one value per neighbouring pair");
        const std::vector<double> friction(phi.data(), phi.data() + phi.shape(0));
        ctr::Shape shape;
        {
            nb::gil_scoped_release release;
            Loan loan(*this);
            loan->solve_single(q, accuracy(level).refined(refinement), friction);
            shape = ctr::make_shape(loan->solver(), loan->frictionless_state(), 0, q);
            shape.status = loan->status();
            shape.stability = loan->stability();
            shape.residual = loan->frictionless().residual;
        }
        return to_python(shape);
    }

    nb::dict bound(Vector theta, Vector l, int level) {
        const ctr::Configuration q = read(theta, l);
        std::vector<ctr::Shape> shapes;
        double position = 0, tangent = 0;
        std::vector<double> envelope;
        int worst = 0;
        {
            nb::gil_scoped_release release;
            Loan loan(*this);
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
        const std::vector<ctr::Configuration> all = read_many(theta, l);
        constexpr std::size_t kColumns = 12;
        std::vector<double> out(all.size() * kColumns);
        {
            nb::gil_scoped_release release;
            parallel(all.size(), threads, [&](ctr::BoundSolver& solver, std::size_t k) {
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
                for (int i = 0; i < 3; ++i) {
                    row[6 + i] = tip.p[i];
                    row[9 + i] = tangent[i];
                }
            });
        }
        return array(std::move(out), {all.size(), kColumns});
    }

    // Zero-clearance tips of many configurations: tip (3), tangent (3), status.
    nb::object tips(Matrix theta, Matrix l, int threads) {
        const std::vector<ctr::Configuration> all = read_many(theta, l);
        std::vector<double> out(all.size() * 7);
        {
            nb::gil_scoped_release release;
            parallel(all.size(), threads, [&](ctr::BoundSolver& solver, std::size_t k) {
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
        const std::vector<ctr::Configuration> all = read_many(theta, l);
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
    // motion, status, tip (3), tangent (3). density: the five numbers of ctr::PathDensity; limits: the three of PathLimits.
    // With bodies, a second item lists per sample the points (N, 4) of all shapes with their outer radius.
    nb::tuple check_path(Matrix theta, Matrix l, nb::object field, Vector origin, double spacing, Matrix R_AB, Vector p_AB,
                         Vector density_values, Vector limit_values, int level, bool bodies) {
        const std::vector<ctr::Configuration> corners = read_many(theta, l);
        Field values;
        const ctr::SignedDistanceField sdf = distance_field(field, values, origin, spacing, R_AB, p_AB);
        const ctr::PathLimits limits{limit_values(0), limit_values(1), limit_values(2)};
        const ctr::PathDensity path{density_values(0), density_values(1), density_values(2), density_values(3), density_values(4)};
        std::vector<ctr::PathSample> samples;
        {
            nb::gil_scoped_release release;
            Loan loan(*this);
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
        const std::vector<ctr::Configuration> all = read_many(theta, l);
        std::vector<double> out(all.size() * ctr::kFieldFloats);
        {
            nb::gil_scoped_release release;
            parallel(all.size(), threads, [&](ctr::BoundSolver& solver, std::size_t k) {
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
        const ctr::Configuration q = read(theta, l);
        std::vector<double> out;
        std::size_t shapes = 0, points = 0;
        {
            nb::gil_scoped_release release;
            Loan loan(*this);
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
    // A solver borrowed from the pool for the length of a call.
    class Loan {
      public:
        explicit Loan(Model& model) : model_(model) {
            const std::lock_guard lock(model.mutex_);
            if (!model.pool_.empty()) {
                solver_ = std::move(model.pool_.back());
                model.pool_.pop_back();
            }
            if (!solver_) solver_ = std::make_unique<ctr::BoundSolver>(model.robot_);
        }
        ~Loan() {
            const std::lock_guard lock(model_.mutex_);
            model_.pool_.push_back(std::move(solver_));
        }
        ctr::BoundSolver* operator->() { return solver_.get(); }
        ctr::BoundSolver& operator*() { return *solver_; }

      private:
        Model& model_;
        std::unique_ptr<ctr::BoundSolver> solver_;
    };

    template <class Work>
    void parallel(std::size_t count, int threads, const Work& work) {
        share(count, threads, [&] { return std::make_unique<Loan>(*this); }, [&](Loan& loan, std::size_t k) { work(*loan, k); });
    }

    // Hands the numbers below count to threads, each with a workspace of its own; the first failure is thrown at the end.
    template <class Make, class Work>
    static void share(std::size_t count, int threads, const Make& make, const Work& work) {
        std::atomic<std::size_t> next{0};
        std::exception_ptr failure;
        std::mutex guard;
        auto run = [&] {
            try {
                const auto workspace = make();
                for (std::size_t k = next++; k < count; k = next++) work(*workspace, k);
            } catch (...) {
                const std::lock_guard lock(guard);
                if (!failure) failure = std::current_exception();
            }
        };
        const int wanted = threads > 0 ? threads : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
        const int used = static_cast<int>(std::min<std::size_t>(wanted, std::max<std::size_t>(count, 1)));
        std::vector<std::thread> pool;
        for (int k = 1; k < used; ++k) pool.emplace_back(run);
        run();
        for (std::thread& thread : pool) thread.join();
        if (failure) std::rethrow_exception(failure);
    }

    ctr::Configuration read(const Vector& theta, const Vector& l) const {
        const ctr::Configuration q{std::vector<double>(theta.data(), theta.data() + theta.shape(0)),
                                   std::vector<double>(l.data(), l.data() + l.shape(0))};
        ctr::validate(robot_, q);
        return q;
    }

    std::vector<ctr::Configuration> read_many(const Matrix& theta, const Matrix& l) const {
        const int n = robot_.count();
        if (theta.shape(0) != l.shape(0) || static_cast<int>(theta.shape(1)) != n || static_cast<int>(l.shape(1)) != n)
            throw ctr::InvalidInput("theta_b and l_b need the same number of rows and one column per tube");
        std::vector<ctr::Configuration> all;
        all.reserve(theta.shape(0));
        for (std::size_t k = 0; k < theta.shape(0); ++k) {
            all.push_back(configuration(theta.data() + k * n, l.data() + k * n, n));
            try {
                ctr::validate(robot_, all.back());
            } catch (const ctr::InvalidInput& reason) {
                throw ctr::InvalidInput("row " + std::to_string(k) + ": " + reason.what());
            }
        }
        return all;
    }

    ctr::Robot robot_;
    std::mutex mutex_;
    std::vector<std::unique_ptr<ctr::BoundSolver>> pool_;
};

}  // namespace

NB_MODULE(_model, m) {
    m.doc() = "Mechanics of concentric tube robots with clearance and friction (C++ core of ctrplan)";
    nb::exception<ctr::InvalidInput>(m, "InvalidInput", PyExc_ValueError);
    m.def("kernel_name", &ctr::kernel_name, "instruction set of the kernel in use");
    nb::class_<ctr::History::State>(m, "HistoryState");
    nb::class_<PathHistory>(m, "History")
        .def("start", &PathHistory::start, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "phi"_a.noconvert())
        .def("advance", &PathHistory::advance, "theta_b"_a.noconvert(), "l_b"_a.noconvert())
        .def("follow", &PathHistory::follow, "theta_b"_a.noconvert(), "l_b"_a.noconvert())
        .def("shape", &PathHistory::shape)
        .def("friction", &PathHistory::friction)
        .def("beside", &PathHistory::beside, "phi"_a.noconvert())
        .def("save", &PathHistory::save)
        .def("restore", &PathHistory::restore, "state"_a);
    nb::class_<FieldLookup>(m, "FieldLookup")
        .def("sample", &FieldLookup::sample, "theta_b"_a.noconvert(), "l_b"_a.noconvert())
        .def("check_path", &FieldLookup::check_path, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "field"_a.none(), "origin"_a.noconvert(),
             "spacing"_a, "R_AB"_a.noconvert(), "p_AB"_a.noconvert(), "density"_a.noconvert(), "limits"_a.noconvert());
    nb::class_<Model>(m, "Model")
        .def(nb::init<const std::vector<std::vector<double>>&, const std::vector<std::vector<std::vector<double>>>&,
                      const std::vector<std::vector<double>>&, const std::vector<std::vector<double>>&>(),
             "tubes"_a, "sections"_a, "pairs"_a, "loads"_a)
        .def("zero_clearance", &Model::zero_clearance, "theta_b"_a.noconvert(), "l_b"_a.noconvert())
        .def("solve", &Model::solve, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "phi"_a.noconvert(), "level"_a,
             "refinement"_a)
        .def("bound", &Model::bound, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "level"_a)
        .def("bound_many", &Model::bound_many, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "level"_a, "threads"_a)
        .def("tips", &Model::tips, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "threads"_a)
        .def("field_entries", &Model::field_entries, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "threads"_a)
        .def("field_lookup", &Model::field_lookup, "axes"_a, "values"_a.noconvert(), "margin"_a)
        .def("history", &Model::history, "level"_a, "breakaway"_a, "rotation"_a, "translation"_a, "state_change"_a)
        .def("number_names", &Model::number_names)
        .def("tips_with_friction", &Model::tips_with_friction, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "phi"_a.noconvert(),
             "directions"_a, "level"_a, "threads"_a)
        .def("check_path", &Model::check_path, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "field"_a.none(),
             "origin"_a.noconvert(), "spacing"_a, "R_AB"_a.noconvert(), "p_AB"_a.noconvert(), "density"_a.noconvert(),
             "limits"_a.noconvert(), "level"_a, "bodies"_a)
        .def("body", &Model::body, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "level"_a);
}
