// The core without Python: the friction bound of a tube pair.
//   cmake -S model -B build/core -DCTR_PYTHON=OFF -DCTR_TESTS=ON && cmake --build build/core && build/core/example_bound
#include <cstdio>

#include "ctr/bound.hpp"

int main() {
    // outer radius, inner radius, EI, GJ, collar length; sections: length, curvature x, curvature y (m, N m^2, 1/m)
    ctr::Robot robot;
    robot.tubes = {{1.32e-3, 1.195e-3, 0.0507, 0.039, 0.0, {{0.150, 0, 3.77}}},
                   {1.1525e-3, 0.975e-3, 0.0507, 0.039, 0.017, {{0.017, 0, 0}, {0.150, 0, 3.77}}}};
    // radial clearance, friction coefficient, bore radius of the outer tube, outer radius of the inner one
    robot.pairs = {{4.25e-5, 0.2, 1.195e-3, 1.1525e-3}};
    const ctr::Configuration q{{0.0, 2.0}, {0.0, -0.017}};  // base rotations [rad], base translations [m]
    ctr::validate(robot);
    ctr::validate(robot, q);

    ctr::BoundSolver solver(robot);
    solver.solve(q, ctr::Accuracy::search());
    if (!solver.all_converged()) return 1;
    const ctr::Vec3& tip = solver.backbone.frame.back().p;
    std::printf("tip %.3f %.3f %.3f mm, friction moves it by at most %.3f mm\n", tip[0] * 1e3, tip[1] * 1e3, tip[2] * 1e3,
                solver.position * 1e3);
    return 0;
}
