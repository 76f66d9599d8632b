// Unknowns, interpolation and Gauss points of an element.
// Included inside anonymous namespaces, by the kernels and by what differentiates or reads them: no std::, no Eigen.

// Positions of the unknowns in a node (kernel.hpp).
constexpr int theta_index(int t) { return 5 * t; }
constexpr int offset_index(int p, int plane) { return 1 + 5 * p + plane; }
constexpr int slope_index(int p, int plane) { return 3 + 5 * p + plane; }

// Second derivatives of the Hermite functions at xi, for an element of length h.
inline void hermite_second(double xi, double h, double* b) {
    b[0] = (12 * xi - 6) / (h * h);
    b[1] = (6 * xi - 4) / h;
    b[2] = (6 - 12 * xi) / (h * h);
    b[3] = (6 * xi - 2) / h;
}

constexpr double kGauss[2] = {0.21132486540518711775, 0.78867513459481288225};

// The linear functions of an element at its Gauss points.
constexpr double linear(int node, int gauss) { return node ? kGauss[gauss] : 1 - kGauss[gauss]; }
