// The line that touches the world: the centreline of the outermost tube present, in front of the plate.
// Included inside anonymous namespaces by check_path.cpp and body_derivatives.cpp.

// The cubic between two nodes; tangents are unit, so that the element length scales them.
inline Vec3 between(const Vec3& a, const Vec3& ta, const Vec3& b, const Vec3& tb, double h, double x) {
    double shape[4];
    hermite(x, h, shape);
    Vec3 p;
    for (int i = 0; i < 3; ++i) p[i] = shape[0] * a[i] + shape[1] * ta[i] + shape[2] * b[i] + shape[3] * tb[i];
    return p;
}

// Calls visit(element, proximal point, distal point) for every element in front of the plate; the points are on the
// outermost tube present, taken from this side of the distal node.
template <class Visit>
void for_outer_elements(const FrictionSolver& solver, const Backbone& shape, const Visit& visit) {
    const Mesh& mesh = solver.mesh();
    const KernelProblem& pb = mesh.problem();
    for (int e = 0; e < pb.elements; ++e) {
        if (mesh.s()[e + 1] <= 0) continue;
        visit(e, shape.outer_position[e], shape.outer_end[e + 1]);
    }
}

// Calls visit(point, radius) along the outermost tubes of one shape, at points no farther apart than `spacing` where elements
// are so long as those of `lengths`.
template <class Visit>
void for_outer_points(const FrictionSolver& solver, const Backbone& shape, double spacing, const double* lengths, const Visit& visit) {
    const KernelProblem& pb = solver.mesh().problem();
    for_outer_elements(solver, shape, [&](int e, const Vec3& start, const Vec3& end) {
        const double radius = solver.robot().tubes[pb.tubes - pb.element_tubes[e]].outer_radius, h = pb.length[e];
        const int count = std::max(1, static_cast<int>(std::ceil(lengths[e] / spacing - 1e-9)));  // lengths of the same mesh differ in their last digit
        for (int k = 0; k <= count; ++k)
            visit(between(start, shape.frame[e].tangent(), end, shape.frame[e + 1].tangent(), h, static_cast<double>(k) / count), radius);
    });
}

template <class Visit>
void for_outer_points(const FrictionSolver& solver, const Backbone& shape, double spacing, const Visit& visit) {
    for_outer_points(solver, shape, spacing, solver.mesh().problem().length, visit);
}
