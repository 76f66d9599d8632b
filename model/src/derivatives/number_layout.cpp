// What a discretised robot is made of, as a row of numbers.
#include <vector>

#include "derivatives/number_layout.hpp"

namespace ctr {

NumberLayout::NumberLayout(int n, int e) : tubes(n), elements(e) {
    int next = 0;
    auto take = [&](int& place, int size) {
        place = next;
        next += size;
    };
    take(start, 1);
    take(base, n);
    take(length, e);
    take(precurvature, 4 * n * e);
    for (int* place : {&bending, &ovality, &axis, &knee, &fraction, &torsional, &shaft_stiffness, &shaft_angle}) take(*place, n);
    for (int* place : {&half_square, &outer_arm, &inner_arm, &scale, &friction}) take(*place, n);
    take(load, 4 * n * e + 1);
    count = next;
}

void read_numbers(const Mesh& mesh, const Robot& robot, const Configuration& q, std::vector<double>& row) {
    const KernelProblem& pb = mesh.problem();
    const int n = pb.tubes;
    row.clear();
    row.push_back(q.l[n - 1]);
    for (int t = 0; t < n; ++t) row.push_back(q.theta[n - 1 - t]);
    auto append = [&](const double* values, int count) { row.insert(row.end(), values, values + count); };
    append(pb.length, pb.elements);
    append(pb.precurvature, 4 * n * pb.elements);
    for (double BendingLaw::*number : {&BendingLaw::stiffness, &BendingLaw::ovality, &BendingLaw::axis, &BendingLaw::knee, &BendingLaw::fraction})
        for (int t = 0; t < n; ++t) row.push_back(mesh.laws()[t].*number);
    for (const double* values : {pb.torsional_stiffness, pb.shaft_stiffness, pb.shaft_angle, pb.half_square_clearance, pb.outer_torque_arm,
                                 pb.inner_torque_arm, pb.barrier_scale})
        append(values, n);
    for (int p = 0; p < n; ++p) row.push_back(p < n - 1 ? robot.pairs[n - 2 - p].friction : 0.0);
}

}  // namespace ctr
