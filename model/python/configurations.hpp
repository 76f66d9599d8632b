// Joint values that Python gives as rows of base rotations and translations.
#pragma once

#include <string>
#include <vector>

#include "arrays.hpp"
#include "ctr/robot.hpp"

inline ctr::Configuration configuration(const double* theta, const double* l, int n) {
    return {std::vector<double>(theta, theta + n), std::vector<double>(l, l + n)};
}

// Of n tubes, each row as it stands.
inline std::vector<ctr::Configuration> configurations(const Matrix& theta, const Matrix& l, int n) {
    if (theta.shape(0) != l.shape(0) || static_cast<int>(theta.shape(1)) != n || static_cast<int>(l.shape(1)) != n)
        throw ctr::InvalidInput("theta_b and l_b need the same number of rows and one column per tube");
    std::vector<ctr::Configuration> all;
    all.reserve(theta.shape(0));
    for (std::size_t k = 0; k < theta.shape(0); ++k) all.push_back(configuration(theta.data() + k * n, l.data() + k * n, n));
    return all;
}

// Those that the robot can be in; the first that it can't is named by its row.
inline std::vector<ctr::Configuration> valid_configurations(const ctr::Robot& robot, const Matrix& theta, const Matrix& l) {
    std::vector<ctr::Configuration> all = configurations(theta, l, robot.count());
    for (std::size_t k = 0; k < all.size(); ++k) {
        if (k % 4096 == 0 && PyErr_CheckSignals() != 0) throw nb::python_error();
        try {
            ctr::validate(robot, all[k]);
        } catch (const ctr::InvalidInput& reason) {
            throw ctr::InvalidInput("row " + std::to_string(k) + ": " + reason.what());
        }
    }
    return all;
}

inline ctr::Configuration valid_configuration(const ctr::Robot& robot, const Vector& theta, const Vector& l) {
    const ctr::Configuration q{std::vector<double>(theta.data(), theta.data() + theta.shape(0)),
                               std::vector<double>(l.data(), l.data() + l.shape(0))};
    ctr::validate(robot, q);
    return q;
}

// Friction states of a configuration, per pair.
inline std::vector<double> friction_state(const ctr::Robot& robot, const Vector& phi) {
    if (phi.shape(0) != robot.pairs.size()) throw ctr::InvalidInput("phi needs one value per neighbouring pair");
    return std::vector<double>(phi.data(), phi.data() + phi.shape(0));
}
