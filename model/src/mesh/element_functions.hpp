// Unknowns, interpolation and Gauss points of an element.
// Included inside anonymous namespaces, by the kernels and by what differentiates or reads them, after ctr/kernel.hpp: no
// std::, no Eigen.

// Positions of the unknowns in a node (kernel.hpp).
constexpr int theta_index(int t) { return 5 * t; }
constexpr int offset_index(int p, int plane) { return 1 + 5 * p + plane; }
constexpr int slope_index(int p, int plane) { return 3 + 5 * p + plane; }

// Offsets of an element: one a pair, and behind the outermost collar that of the outermost tube from the axis.
inline int offsets_of(const KernelProblem& pb, int e) {
    const int tubes = pb.element_tubes[e];
    return pb.element_unknowns[e] == 5 * tubes ? tubes : tubes - 1;
}

// Hermite functions at xi, for an element of length h: values and slopes at its nodes, proximal first.
inline void hermite(double xi, double h, double* b) {
    const double xi2 = xi * xi, xi3 = xi2 * xi;
    b[0] = 1 - 3 * xi2 + 2 * xi3;
    b[1] = h * (xi - 2 * xi2 + xi3);
    b[2] = 3 * xi2 - 2 * xi3;
    b[3] = h * (xi3 - xi2);
}

// Their second derivatives.
inline void hermite_second(double xi, double h, double* b) {
    b[0] = (12 * xi - 6) / (h * h);
    b[1] = (6 * xi - 4) / h;
    b[2] = (6 - 12 * xi) / (h * h);
    b[3] = (6 * xi - 2) / h;
}

constexpr double kGauss[2] = {0.21132486540518711775, 0.78867513459481288225};

// The linear functions of an element at its Gauss points.
constexpr double linear(int node, int gauss) { return node ? kGauss[gauss] : 1 - kGauss[gauss]; }
