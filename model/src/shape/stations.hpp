// What a shape says of a tube at a station: included inside anonymous namespaces by what makes shapes.

// Material frame and curvature of a tube from its twist-free frame, its angle and its bending in the twist-free frame.
inline void append(TubeShape& tube, double s, const Frame& frame, double theta, double rate, const double* kappa,
            const double* rotated, double radius) {
    const double c = std::cos(theta), n = std::sin(theta);
    std::array<double, 9> R;
    for (int i = 0; i < 3; ++i) {
        R[3 * i] = c * frame.R[3 * i] + n * frame.R[3 * i + 1];
        R[3 * i + 1] = -n * frame.R[3 * i] + c * frame.R[3 * i + 1];
        R[3 * i + 2] = frame.R[3 * i + 2];
    }
    tube.s.push_back(s);
    tube.position.push_back(frame.p);
    tube.frame.push_back(R);
    tube.theta.push_back(theta);
    const double wx = -kappa[1], wy = kappa[0];  // rotation rate
    tube.curvature.push_back({c * wx + n * wy, -n * wx + c * wy, rate});
    tube.strain.push_back(radius * std::hypot(kappa[0] - rotated[0], kappa[1] - rotated[1]));
}

inline double outermost_radius(const Robot& robot, const Configuration& q, double s) {
    for (const Tube& tube : robot.tubes) {
        const double begin = q.l[&tube - robot.tubes.data()];
        if (begin <= s && s <= begin + tube.length() + 1e-12) return tube.outer_radius;
    }
    return robot.tubes.back().outer_radius;
}
