// The robot as the mechanics sees it: tubes with sections, neighbouring pairs with clearance and friction.
// Tubes are numbered from the outermost (0 here, 1 in the paper) to the innermost (n - 1); SI units throughout.
#pragma once

#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "ctr/guide.hpp"

namespace ctr {

struct Section {
    double length;                    // m
    double curvature_x, curvature_y;  // precurvature u_hat as a rotation rate, mean over the section, 1/m
    double gradient = 0;              // relative change along it: (1 + gradient (2 x / length - 1)) times the mean
};

constexpr double kNeverSoft = 1e300;

struct Tube {
    double outer_radius, inner_radius;  // m
    double bending_stiffness;           // EI, N m^2
    double torsional_stiffness;         // GJ = EI / (1 + nu), the paper's k_z
    double collar_length;               // m
    std::vector<Section> sections;      // from base to tip
    // Beyond the paper; these values leave its tube.
    double ovality = 0, ovality_axis = 0;     // EI (1 + e) for bending along an axis at this angle [rad] in the tube, EI (1 - e) across
    double softening_strain = kNeverSoft;     // of r_out |u - u_hat|, where the stiffness drops
    double softening_fraction = 1;            // tangent stiffness beyond it over EI
    double shaft_compliance = 0;              // between actuator and collar, rad / (N m)
    double mass_per_length = 0;               // kg/m
    bool retractable = false;                 // its tip may be drawn back behind that of the tube around it
    double length() const {
        double sum = 0;
        for (const Section& section : sections) sum += section.length;
        return sum;
    }
};

// Where a retractable tube has ended inside another one a ghost of it goes on: straight, and so soft that it only follows.
// The tubes present stay a prefix, counted from the innermost, and the unknowns of the kernels with them.
constexpr double kGhostShare = 1e-5;  // of the bending stiffness
inline bool is_ghost(const Tube& tube, double from_base) { return tube.retractable && from_base > tube.length(); }

// The section at a distance from the tube's base; the last one beyond the tip. `begin` is where it begins.
const Section& section_at(const Tube& tube, double from_base);
const Section& section_at(const Tube& tube, double from_base, double& begin);

// Its precurvature there as a curvature vector v = (u_y, -u_x), 1/m; sections are told apart at `inside`, a point between
// joints, so that a point on a joint may be asked from either side.
void precurvature_at(const Tube& tube, double from_base, double inside, double* v);

// Pair (i, i + 1); the contact radii are those of (41).
struct Pair {
    double clearance;           // c, radial, m
    double friction;            // mu
    double outer_inner_radius;  // r_in of the outer tube, m
    double inner_outer_radius;  // r_out of the inner tube, m
};

// Dead loads in the world frame: on the innermost tip, and the acceleration that gives every tube its weight. The plate
// bears what reaches tube 1 behind it.
struct Loads {
    double tip_force[3] = {0, 0, 0};   // N
    double tip_moment[3] = {0, 0, 0};  // N m
    double gravity[3] = {0, 0, 0};     // m/s^2
};

struct Robot {
    std::vector<Tube> tubes;
    std::vector<Pair> pairs;
    Loads loads;
    std::shared_ptr<const Guide> guide = nullptr;  // null: on the branch that begins without precurvature
    int count() const { return static_cast<int>(tubes.size()); }
    bool loaded() const;        // whether any load acts
    bool softens() const;       // whether the stiffness of any tube drops somewhere
    bool linear_round() const;  // whether all tubes bend linearly and alike in every direction
};

// One joint-space point: base rotations [rad] and base translations [m], outermost first.
struct Configuration {
    std::vector<double> theta, l;
};

// Where the foremost tube ends: the robot's tip. m from the plate.
double tip_s(const Robot& robot, const Configuration& q);
// Whether a tube ends inside another one.
bool is_retracted(const Robot& robot, const Configuration& q);

// A value handed in breaks a rule; the Python layer turns it into ctrplan.errors.InputError.
struct InvalidInput : std::runtime_error {
    using std::runtime_error::runtime_error;
};

// Throws InvalidInput unless sizes fit, values are finite, and bases and tips are nested.
void validate(const Robot& robot);
void validate(const Robot& robot, const Configuration& q);

}  // namespace ctr
