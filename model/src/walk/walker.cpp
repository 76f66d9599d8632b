#include "ctr/walker.hpp"

#include <algorithm>
#include <cmath>

#include "ctr/bound.hpp"
#include "model/answers.hpp"

namespace ctr {
namespace {

constexpr double kRotation = 0.1;      // rad, longest step of a joint
constexpr double kTranslation = 3e-3;  // m
constexpr int kMostSteps = 1000;       // of one way; a longer one is begun afresh

double steps(const Configuration& a, const Configuration& b) {
    double most = 0;
    for (std::size_t i = 0; i < a.theta.size(); ++i)
        most = std::max({most, std::fabs(b.theta[i] - a.theta[i]) / kRotation, std::fabs(b.l[i] - a.l[i]) / kTranslation});
    return most;
}

}  // namespace

Walker::Walker(const Robot& robot, const Accuracy& accuracy) : solver_(std::make_unique<BoundSolver>(robot)), robot_(robot), accuracy_(accuracy) {
    require_all_corners(robot);
}

Walker::~Walker() = default;

BoundRows Walker::step(const Configuration& q) {
    const bool was_begun = begun_;
    begun_ = false;  // until it is there: the work may be called off
    solves_ = 0;
    const Configuration from = solver_->configuration();
    const double way = was_begun ? steps(from, q) : 0;
    cold_ = !was_begun || way > kMostSteps;
    if (cold_) {
        solver_->solve(q, accuracy_);
        ++solves_;
    } else {
        const int count = std::max(1, static_cast<int>(std::ceil(way - 1e-9)));
        for (int k = 1; k <= count; ++k) {
            Configuration at = q;
            const double share = static_cast<double>(k) / count;
            for (std::size_t i = 0; k < count && i < q.l.size(); ++i) {
                at.theta[i] = from.theta[i] + share * (q.theta[i] - from.theta[i]);
                at.l[i] = from.l[i] + share * (q.l[i] - from.l[i]);
            }
            solver_->follow(at, accuracy_);
            cold_ = cold_ || solver_->started_cold();
            ++solves_;
        }
    }
    begun_ = true;
    BoundRows row(1);
    fill_bound(*solver_, 0, row);
    return row;
}

std::vector<PathSample> Walker::check_path(const std::vector<Configuration>& corners, const SignedDistanceField& field,
                                           const PathDensity& density, const PathLimits& limits, bool keep_shapes) {
    begun_ = false;  // until it is there
    std::vector<PathSample> samples = ctr::check_path(*solver_, corners, accuracy_, field, density, limits, keep_shapes, true);
    begun_ = !samples.empty() && samples.back().status != Status::failed;
    return samples;
}

BoundShapes Walker::shapes() const {
    if (!begun_) throw InvalidInput("a walker stands nowhere before its first step");
    return bound_shapes(*solver_);
}

}  // namespace ctr
