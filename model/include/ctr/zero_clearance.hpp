// The standard model (2)-(3): all tubes share one centreline. For s <= 0 the backbone is straight and the tubes twist
// freely; in front the common curvature is the stiffness-weighted mean of the rotated precurvatures, so that only the
// material angles theta_i(s) are unknown:
//     E = sum_i int GJ_i/2 theta_i'^2 ds + int 1/2 sum_ij P_ij w_i . w_j ds,   w_i = R(theta_i) v_i,
//     P = diag(EI) - EI EI^T / sum(EI).
// Discretised by cubic Hermite elements for theta, minimised by Newton's method along a continuation of the precurvature.
#pragma once

#include <vector>

#include "ctr/curve.hpp"
#include "ctr/robot.hpp"
#include "ctr/sdf.hpp"

namespace ctr {

class ZeroClearance {
  public:
    // Follows the branch from vanishing precurvature to the robot's own, or from the nearest shape of the robot's guide. Returns
    // false if the residual was not reached.
    bool solve(const Robot& robot, const Configuration& q);

    // Looks for other stable equilibria by restarts with the inner tubes of a pair turned across opposed precurvatures. Makes
    // the attempts from number `from` on; returns the number of the first that found one, left in `other`, or -1.
    int search_other(int from, ZeroClearance& other) const;

    // Angle of tube t (innermost first) at arc length s, anywhere between its base and its tip.
    double theta(int t, double s) const;
    double twist_rate(int t, double s) const;
    Frame tip() const;  // of the innermost tube, twist-free frame
    // Smallest clearance of points on the centreline in front of the plate, no farther apart than `spacing`, less the outer
    // radius of what is there [m]; on the way also the tip, as by tip() but for the steps.
    double clearance(const Robot& robot, const SignedDistanceField& field, double spacing, Frame& tip) const;
    double imbalance() const;                            // residual() evaluated anew
    double residual() const { return residual_; }        // largest torque imbalance over EI * precurvature
    int negative_pivots() const { return negative_; }    // > 0: not a minimum
    bool is_unique() const { return unique_; }           // true where the energy is convex, which leaves one equilibrium
    int iterations() const { return iterations_; }

  private:
    void build(const Robot& robot, const Configuration& q);
    void place_nodes(const Robot& robot, const std::vector<double>& breaks, bool retracted);
    int stiffness_row(int tubes, unsigned ghosts);
    double turn_rate(const Robot& robot, double middle) const;
    void clear_blocks();
    void add_transmissions(bool matrix);
    double assemble(double scale, bool matrix);  // scale multiplies the bending energy; returns the largest imbalance
    double hold_fixed(bool matrix);
    bool is_convex();
    int factorise();
    void solve_system();
    bool correct(double scale, double first_step_limit);
    bool follow_branch();
    bool follow_guide(const Robot& robot, const Configuration& q);
    template <class Shape>
    void begin_from(const Robot& robot, const Configuration& q, const Shape& shape);
    template <class Shape>
    double farthest_from(const Shape& shape) const;
    bool turn_and_correct(const std::vector<double>& twist);
    int locate(double s) const;
    template <class Visit>
    Frame trace(double longest, bool whole, const Visit& visit) const;
    int node_unknowns(int node) const { return 2 * (node == 0 ? n_ : tubes_[node - 1]); }
    bool is_clamped(int t) const;                // at the plate: its angle there is that of its actuator
    double transmission_stiffness(int t) const;  // from the actuator to the plate, N m / rad

    int n_ = 0, nodes_ = 0, ld_ = 0;
    std::vector<double> s_, v_, P_, ei_row_, ei_, gj_, base_theta_, base_l_, end_s_, shaft_, breaks_;
    std::vector<int> tubes_, row_;  // [element] tubes present; row of P and EI, more than the tubes where some are ghosts
    std::vector<double> tip_v_, tip_s_;  // the innermost tube beyond the last node: precurvature and end of its sections
    std::vector<double> x_, best_, r_, A_, U_, step_, tangent_;
    double residual_ = 0, scale_moment_ = 1;
    int negative_ = 0, iterations_ = 0;
    bool unique_ = false;
};

}  // namespace ctr
