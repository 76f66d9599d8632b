// The robot as the mechanics sees it: tubes with sections, neighbouring pairs with clearance and friction.
// Tubes are numbered from the outermost (0 here, 1 in the paper) to the innermost (n - 1); SI units throughout.
#pragma once

#include <stdexcept>
#include <string>
#include <vector>

namespace ctr {

struct Section {
    double length;                    // m
    double curvature_x, curvature_y;  // precurvature u_hat as a rotation rate, 1/m
};

struct Tube {
    double outer_radius, inner_radius;  // m
    double bending_stiffness;           // EI, N m^2
    double torsional_stiffness;         // GJ = EI / (1 + nu), the paper's k_z
    double collar_length;               // m
    std::vector<Section> sections;      // from base to tip
    double length() const {
        double sum = 0;
        for (const Section& section : sections) sum += section.length;
        return sum;
    }
};

// The section at a distance from the tube's base; the last one beyond the tip.
const Section& section_at(const Tube& tube, double from_base);

// Pair (i, i + 1); the contact radii are those of (41).
struct Pair {
    double clearance;           // c, radial, m
    double friction;            // mu
    double outer_inner_radius;  // r_in of the outer tube, m
    double inner_outer_radius;  // r_out of the inner tube, m
};

struct Robot {
    std::vector<Tube> tubes;
    std::vector<Pair> pairs;
    int count() const { return static_cast<int>(tubes.size()); }
};

// One joint-space point: base rotations [rad] and base translations [m], outermost first.
struct Configuration {
    std::vector<double> theta, l;
};

// A value handed in breaks a rule; the Python layer turns it into ctrplan.errors.InputError.
struct InvalidInput : std::runtime_error {
    using std::runtime_error::runtime_error;
};

// Throws InvalidInput unless sizes fit, values are finite, and bases and tips are nested.
void validate(const Robot& robot);
void validate(const Robot& robot, const Configuration& q);

}  // namespace ctr
