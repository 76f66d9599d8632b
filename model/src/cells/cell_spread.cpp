// How far the bodies of a cell's friction states lie from one another.
#include <algorithm>
#include <cmath>

#include "ctr/friction_cells.hpp"

namespace ctr {
namespace {

double apart(const double* a, const double* b) {
    const double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
    return std::sqrt(x * x + y * y + z * z);
}

}  // namespace

CellSpread cell_spread(const CellBodies& bodies, std::size_t beyond) {
    CellSpread found{std::vector<double>(bodies.cells * bodies.points), std::vector<double>(bodies.cells * bodies.points)};
    std::vector<double> most(bodies.points);
    for (std::size_t cell = 0; cell < bodies.cells; ++cell) {
        double* off = found.off.data() + cell * bodies.points;
        double* reach = found.reach.data() + cell * bodies.points;
        double largest = 0;
        for (std::size_t k = 0; k < bodies.points; ++k) {
            const double* middle = bodies.point(cell, bodies.corners, k);
            double mean[3] = {0, 0, 0};
            reach[k] = -HUGE_VAL;
            for (int corner = 0; corner < bodies.corners; ++corner) {
                const double* at = bodies.point(cell, corner, k);
                for (int i = 0; i < 3; ++i) mean[i] += at[i] / bodies.corners;
                reach[k] = std::max(reach[k], apart(at, middle) + at[3] - middle[3]);
            }
            largest = std::max(largest, apart(mean, middle));
            most[k] = largest;
        }
        for (std::size_t k = 0; k < bodies.points; ++k) off[k] = most[std::min(k + beyond, bodies.points - 1)];
    }
    return found;
}

}  // namespace ctr
