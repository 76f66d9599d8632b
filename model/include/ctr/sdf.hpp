// A signed-distance field sampled on a regular grid: clearance available to a point, in the anatomy's frame.
#pragma once

#include <cmath>

#include "ctr/curve.hpp"

namespace ctr {

struct SignedDistanceField {
    const float* values = nullptr;  // [x][y][z], m; null: free space
    int nx = 0, ny = 0, nz = 0;
    Vec3 origin{0, 0, 0};           // of node (0, 0, 0), m
    double spacing = 1;             // m
    std::array<double, 9> R_AB{1, 0, 0, 0, 1, 0, 0, 0, 1};  // robot base in the anatomy's frame
    Vec3 p_AB{0, 0, 0};

    // Trilinear inside the grid; outside, the value at the nearest grid point less the distance to it, which is a lower
    // bound because distances are 1-Lipschitz. The point is given in the robot's frame.
    double sample(const Vec3& p) const {
        if (!values) return 1e9;
        double index[3], outside = 0;
        const int size[3] = {nx, ny, nz};
        for (int i = 0; i < 3; ++i) {
            const double x = R_AB[3 * i] * p[0] + R_AB[3 * i + 1] * p[1] + R_AB[3 * i + 2] * p[2] + p_AB[i];
            const double u = (x - origin[i]) / spacing, inside = std::fmin(std::fmax(u, 0.0), size[i] - 1.0);
            outside += (u - inside) * (u - inside);
            index[i] = inside;
        }
        int cell[3];
        double f[3];
        for (int i = 0; i < 3; ++i) {
            cell[i] = static_cast<int>(index[i]);
            if (cell[i] > size[i] - 2) cell[i] = size[i] > 1 ? size[i] - 2 : 0;
            f[i] = index[i] - cell[i];
        }
        // to the next node, where there is one: a grid may be a single layer
        const long sz = nz > 1 ? 1 : 0, sy = ny > 1 ? nz : 0, sx = nx > 1 ? static_cast<long>(ny) * nz : 0;
        const float* v = values + (static_cast<long>(cell[0]) * ny + cell[1]) * nz + cell[2];
        const double c00 = v[0] + f[2] * (v[sz] - v[0]), c01 = v[sy] + f[2] * (v[sy + sz] - v[sy]);
        const double c10 = v[sx] + f[2] * (v[sx + sz] - v[sx]), c11 = v[sx + sy] + f[2] * (v[sx + sy + sz] - v[sx + sy]);
        const double c0 = c00 + f[1] * (c01 - c00), c1 = c10 + f[1] * (c11 - c10);
        return c0 + f[0] * (c1 - c0) - spacing * std::sqrt(outside);
    }
};

}  // namespace ctr
