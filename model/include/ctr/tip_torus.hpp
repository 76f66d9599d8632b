// Every equilibrium of a robot without clearance and friction. At their ends tubes carry no torsion, so that an equilibrium
// depends on the angles there alone, each tube's against that of the tube around it: a torus. From them
//     GJ_i theta_i'' = sum_j EI_i EI_j / sum(EI) |u_i x u_j|,   u_i = R(theta_i) v_i,
// is integrated towards the plate, and with it the derivatives by the angles at the tips. Every solution of
//     R(psi) = alpha + 2 pi k
// is an equilibrium at relative angles alpha of the collars. Outermost tube first, as in Python.
#pragma once

#include <memory>
#include <vector>

namespace ctr {

// A stretch in front of the plate along which the tubes from number `first` on have precurvatures that vary linearly.
struct TorusStretch {
    double begin, end;                // [m] arc length
    int first;                        // outermost tube that is there
    std::vector<double> u, slope;     // (n, 2) precurvature at `begin` [1/m], and its slope [1/m^2]
};

// What the torus is made of. `behind`: [m] from the plate back to where a tube is held (negative), its shaft's compliance as a
// length of the tube.
struct TorusTubes {
    std::vector<double> EI, GJ, behind;
    std::vector<TorusStretch> stretches;
    int count() const { return static_cast<int>(EI.size()); }
};

struct TorusRoot {
    std::vector<double> psi;    // (n - 1,) relative angles at the tips [rad]
    std::vector<double> twist;  // (n - 1,) of each pair from tip to collar [rad]
    int sign;                   // of the determinant of R's derivatives
    bool is_stable;             // no conjugate point between the tips and the collars
    double energy;              // of bending and torsion [J]
    double tip[3];              // where the outermost collar stands at the angle asked for [m]
};

constexpr int TORUS_MOST_TUBES = 5;

// Angles of every tube along the robot, beyond its ends as there.
struct TorusShapes {
    std::vector<double> s;      // (K,) [m] from behind the plate to the foremost tip
    std::vector<double> theta;  // (G, n, K) [rad]
};

// Where places of the torus lead to: R (Q, n - 1) [rad], and the determinant of its derivatives (Q,), 0 where it has no inverse.
struct TorusMap {
    std::vector<double> R, det;
};

// The torus of a robot whose collars stand at one place; integrations in steps no longer than `step` [m].
class TipTorus {
  public:
    virtual ~TipTorus() = default;
    static std::unique_ptr<TipTorus> of(TorusTubes tubes, double step);

    // On a grid of so many angles along each pair, the last pair's fastest.
    virtual TorusMap map(int count) = 0;

    // Newton's method for R = alpha + 2 pi k from the places of such a grid and from roots for earlier alpha, where the first
    // step is shorter than `reach`, as long as it stays so near; roots closer together than `apart` are one. A list for each of
    // alpha (A, n - 1), with the outermost collar at outermost (A).
    virtual std::vector<std::vector<TorusRoot>> roots(int count, const std::vector<double>& alpha, const std::vector<double>& outermost,
                                                      double reach, double apart) = 0;

    // Where the tips stand at psi (G, n - 1), with the outermost collar at outermost (G).
    virtual TorusShapes shapes(const std::vector<double>& psi, const std::vector<double>& outermost) const = 0;
};

}  // namespace ctr
