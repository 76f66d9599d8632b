// One configuration at a time.
#include "ctr/model.hpp"

#include <algorithm>
#include <string>

#include "bound/extreme_corners.hpp"
#include "ctr/zero_clearance.hpp"
#include "model/answers.hpp"
#include "model/solver_pool.hpp"

namespace ctr {
namespace {

std::shared_ptr<const Setting> setting(const BoundSolver& solver) {
    return std::make_shared<Setting>(Setting{solver.solver().robot(), solver.configuration(), solver.accuracy(), solver.solver().mesh()});
}

// Its end alone, the rest when somebody looks at it; the moments of loads, which bend a shape, are not kept.
Shape shape_of(const BoundSolver& solver, const LaneState& state, int lane, const Backbone& backbone) {
    if (solver.solver().robot().loaded()) return make_shape(solver.solver(), state, lane, solver.configuration());
    Shape shape;
    shape.end_at(backbone.tip);
    return shape;
}

Shape frictionless_shape(const BoundSolver& solver, const std::shared_ptr<const Setting>& setting, Shape shape) {
    shape.status = solver.status();
    shape.stability = solver.stability();
    shape.residual = solver.frictionless().residual;
    shape.equilibrium = std::make_shared<ContactEquilibrium>(setting, solver.frictionless_state(), 0);
    return shape;
}

Shape corner_shape(const BoundSolver& solver, const std::shared_ptr<const Setting>& setting, int corner) {
    Shape shape = shape_of(solver, solver.corner_state(corner), solver.corner_lane(corner), solver.corner_backbones[corner]);
    shape.status = solver.corner_status(corner);
    shape.stability = solver.stability();
    shape.residual = solver.corner(corner).residual;
    shape.equilibrium = std::make_shared<ContactEquilibrium>(setting, solver.corner_state(corner), solver.corner_lane(corner));
    return shape;
}

}  // namespace

void require_all_corners(const Robot& robot) {
    if (robot.count() > BoundSolver::kMostTubesOfAllCorners)
        throw InvalidInput("bounds over all corners are for robots of at most 10 tubes, this one has " + std::to_string(robot.count()) +
                           " and 2^" + std::to_string(robot.count() - 1) + " corners: bound one configuration at a time by its extreme corners");
}

BoundShapes bound_shapes(const BoundSolver& solver) {
    const std::shared_ptr<const Setting> shared = setting(solver);
    BoundShapes found{solver.position, solver.tangent, frictionless_shape(solver, shared, shape_of(solver, solver.frictionless_state(), 0, solver.backbone)), {}, {}, solver.envelope, solver.worst_corner};
    for (int k = 0; k < solver.corners(); ++k) {
        found.corners.push_back(corner_shape(solver, shared, k));
        for (int pair = 0; pair + 1 < solver.solver().robot().count(); ++pair) found.phi.push_back(solver.sign(k, pair));
    }
    return found;
}

Model::Model(const Robot& robot) : robot_(robot), solvers_(std::make_unique<SolverPool>(robot_)) {
    validate(robot_);
    if (robot_.count() > kMaxTubes) throw InvalidInput("at most 12 tubes are supported");
}

Model::~Model() = default;

Shape Model::zero_clearance(const Configuration& q) const {
    ZeroClearance solution, other;
    const bool done = solution.solve(robot_, q);
    Shape shape;
    shape.end_at(end_of(robot_, solution, q));
    shape.residual = solution.residual();
    if (!done) shape.status = Status::failed;
    else if (solution.negative_pivots()) shape.status = Status::unstable;
    else shape.status = solution.search_other(0, other) >= 0 ? Status::multiple : Status::converged;
    shape.equilibrium = std::make_shared<ZeroClearanceEquilibrium>(robot_, q, std::move(solution));
    return shape;
}

Shape Model::solve(const Configuration& q, const Accuracy& accuracy, const std::vector<double>& phi) {
    SolverPool::Loan solver(*solvers_);
    solver->solve_single(q, accuracy, phi);
    return frictionless_shape(*solver, setting(*solver), make_shape(solver->solver(), solver->frictionless_state(), 0, q));
}

BoundShapes Model::bound(const Configuration& q, const Accuracy& accuracy, bool extremes_only) {
    SolverPool::Loan solver(*solvers_);
    if (extremes_only) solver->visit_corners(extreme_corners(*solver, q, accuracy));
    else require_all_corners(robot_);
    solver->solve(q, accuracy);
    solver->search_others();
    BoundShapes found = bound_shapes(*solver);
    if (extremes_only) solver->visit_all_corners();
    return found;
}

Body Model::body(const Configuration& q, const Accuracy& accuracy) {
    require_all_corners(robot_);
    SolverPool::Loan solver(*solvers_);
    solver->solve(q, accuracy);
    const Mesh& mesh = solver->solver().mesh();
    const KernelProblem& pb = mesh.problem();
    Body body;
    auto add = [&](const Backbone& shape) {
        for (int k = 0; k < pb.nodes; ++k) {
            if (mesh.s()[k] < 0) continue;
            body.point.push_back(shape.outer_position[k]);
            if (body.shapes == 0) body.radius.push_back(robot_.tubes[pb.tubes - pb.element_tubes[std::min(k, pb.elements - 1)]].outer_radius);
        }
        ++body.shapes;
    };
    add(solver->backbone);
    for (const Backbone& shape : solver->corner_backbones) add(shape);
    return body;
}

FrictionlessStart Model::begin_states(const Configuration& q, const Accuracy& accuracy) {
    SolverPool::Loan solver(*solvers_);
    return solver->begin_states(q, accuracy);
}

FrictionBodies Model::friction_bodies(const FrictionlessStart& start, const FrictionStates& states, double spacing) {
    SolverPool::Loan solver(*solvers_);
    FrictionBodies found;
    solver->solve_states(start, states, [&](std::size_t, const FrictionShape& shape) {
        collect_points(*solver, shape.backbone, spacing, found.point);
        found.status.push_back(shape.convergence.converged ? Status::converged : Status::failed);
        found.max_strain.push_back(shape.backbone.max_strain);
        found.stability.push_back(shape.stability);
    });
    return found;
}

BranchRows Model::solve_from(const Configuration& q, const Accuracy& accuracy, const GivenShapes& given) {
    SolverPool::Loan solver(*solvers_);
    BranchRows found(given.rows);
    std::size_t row = 0;
    solver->solve_from(q, accuracy, given, [&](const FrictionShape& shape, std::vector<double>&& theta) {
        found.tip[row] = shape.backbone.tip.p;
        found.tangent[row] = shape.backbone.tip.tangent();
        const bool is_solved = shape.convergence.converged;
        found.status[row++] = !is_solved ? Status::failed : shape.stability > 0 ? Status::converged : Status::unstable;
        found.stability.push_back(shape.stability);
        found.theta.insert(found.theta.end(), theta.begin(), theta.end());
    });
    return found;
}

std::vector<double> Model::corners_apart(const Configuration& q, const Accuracy& accuracy) {
    require_all_corners(robot_);
    SolverPool::Loan solver(*solvers_);
    return solver->corners_apart(q, accuracy);
}

std::vector<PathSample> Model::check_path(const std::vector<Configuration>& corners, const Accuracy& accuracy, const SignedDistanceField& field,
                                          const PathDensity& density, const PathLimits& limits, bool keep_shapes) {
    require_all_corners(robot_);
    SolverPool::Loan solver(*solvers_);
    return ctr::check_path(*solver, corners, accuracy, field, density, limits, keep_shapes);
}

}  // namespace ctr
