#include "ctr/guide.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "ctr/robot.hpp"

namespace ctr {
namespace {

constexpr double kTurns = 1;  // steps that a whole turn counts as: more than to the next shape of the same way
constexpr double kTurn = 6.283185307179586;

}  // namespace

double GivenAngles::at(int tube, double place) const {
    const double* own = theta + static_cast<std::size_t>(tube) * count;
    const std::size_t next = std::upper_bound(s, s + count, place) - s;
    if (next == 0) return own[0];
    if (next == count) return own[count - 1];
    const double share = (place - s[next - 1]) / (s[next] - s[next - 1]);
    return own[next - 1] + share * (own[next] - own[next - 1]);
}

double Guide::steps(const Configuration& a, const Configuration& b) {
    double most = 0;
    for (std::size_t i = 0; i < a.theta.size(); ++i)
        most = std::max({most, std::fabs(b.theta[i] - a.theta[i]) / kRotation, std::fabs(b.l[i] - a.l[i]) / kTranslation});
    return most;
}

std::size_t Guide::nearest(const Configuration& q, Configuration& turned) const {
    std::size_t best = 0;
    double least = std::numeric_limits<double>::infinity();
    Configuration at = q;
    for (std::size_t row = 0; row < rows(); ++row) {
        double turns = 0;
        for (std::size_t i = 0; i < tubes; ++i) {
            const double own = theta[row * tubes + i], whole = std::round((q.theta[i] - own) / kTurn);
            at.theta[i] = own + kTurn * whole;
            at.l[i] = l[row * tubes + i];
            turns += std::fabs(whole);
        }
        const double far = steps(at, q) + kTurns * turns;
        if (far < least) {
            least = far;
            best = row;
            turned = at;
        }
    }
    return best;
}

}  // namespace ctr
