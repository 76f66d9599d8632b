// Interface between the solver (friction_solver.hpp) and the hot kernels, which are compiled once per instruction set.
// Plain arrays only: kernel translation units use no std:: and no Eigen, so that nothing weak compiled with wider
// instructions can be merged into baseline code by the linker.
//
// Inside the kernel tubes are counted from the innermost (t = 0), pairs likewise (p = 0 is the innermost pair): the
// unknowns of a node are then [theta_0, d_0 (x, y), d_0' (x, y), theta_1, d_1, d_1', theta_2, ...] and what is left where
// outer tubes have ended, or have not begun, is a prefix. d_p = y_inner - y_outer is the offset of neighbouring
// centrelines. In front of the outermost collar the mean bending is eliminated point by point (docs/model.md), which
// leaves 5 m - 4 unknowns for m tubes; behind it d_{m-1} is the offset of the outermost tube present from the axis, which
// makes 5 m. At a collar the new tube lies on the axis, so that d_{m-1} simply turns into the offset of a pair.
#pragma once

#include <cstddef>

namespace ctr {

constexpr int kMaxTubes = 12;
constexpr int kLanes = 4;      // friction states solved side by side
constexpr int kMostLanes = 8;  // of those, where there are so many and the CPU has registers for them
constexpr int kAlignment = 64; // bytes, of every lane array

// How a tube bends where it is not linear and round: with k = u - u_hat as a curvature vector along the tube's oval axes and
// q = (1 + e) k_1^2 + (1 - e) k_2^2, the energy per length grows like EI q / 2 up to q = knee^2 and from there on with the
// fraction of the stiffness.
struct BendingLaw {
    double stiffness;              // EI, N m^2
    double ovality, axis;          // e; angle of the first axis in the tube, rad
    double knee, fraction;         // 1/m; tangent stiffness beyond, over EI
};

// Everything the lanes share: the mesh, the tubes on it, the possible contacts.
struct KernelProblem {
    int tubes, nodes, elements, contacts;
    int stride;                   // unknowns per node with all tubes, 5 tubes - 4
    const int* node_unknowns;     // [node] leading unknowns that are free
    const int* element_tubes;     // [element] number of tubes present
    const int* element_unknowns;  // [element] unknowns per node: 5 m - 4, or 5 m behind the outermost collar
    const int* element_regime;    // [element] row of P, C, D; half of it is the row of what is the same behind the plate
    const double* length;         // [element] m
    const double* precurvature;   // [element][Gauss point][tube][2] v = (u_y, -u_x), 1/m
    const double* stiffness;      // P [regime][tube][tube], N m^2
    const double* pair_stiffness; // C [regime][pair][pair]
    const double* mixed_stiffness;// D [regime][pair][tube]
    const double* torsional_stiffness;  // [tube] N m^2
    const double* bending_stiffness;    // [row][tube] N m^2; the first rows are of tubes without ghosts (robot.hpp)
    const double* outer_radius;         // [row][tube] m; 0 of ghosts, which have no strain
    const BendingLaw* law;        // [row][tube], or null where all tubes are linear and round and nothing pulls
    const double* shaft_stiffness;// [tube] between actuator and collar, N m / rad; 0: rigid
    const double* shaft_angle;    // [tube] of the actuator, rad
    const int* shaft_node;        // [tube] where the tube begins
    // Contacts stand element by element, pair by pair. Arrays over them have room for kLanes - 1 values more, so that the
    // kernels may read four from every contact on; likewise those of a single lane's state.
    const int* contact_begin;     // [elements + 1]
    const int* contact_pair;      // [contact]
    const double* contact_shape;  // [contact][4] Hermite values, the slopes' in m
    const double* contact_xi;     // [contact] position in the element, 0 only at a rim
    const double* contact_weight; // [contact] tributary length, m
    const double* half_square_clearance;  // [pair] c^2 / 2
    const double* outer_torque_arm;       // [pair] r_in of the outer tube / c
    const double* inner_torque_arm;       // [pair] r_out of the inner tube / c
    const double* barrier_scale;          // [pair] c: barrier eps = level * c * weight, level in N/m
};

// How friction follows the slip of contact points (history.hpp). The circumferential share of the Coulomb limit is that of
// (phi, psi) = (before + slip / breakaway) projected onto the unit disc.
struct SlipLaw {
    const double* friction;    // [contact] mu
    const double* reference;   // [contact] m: slip = r_out theta_in - r_in theta_out + across . d - reference
    const double* across;      // [contact][2] direction in which the contact slides around the bore
    const double* inner_arm;   // [pair] r_out of the inner tube, m
    const double* outer_arm;   // [pair] r_in of the outer tube, m
    const double* phi;         // [contact] before the step
    const double* psi;         // [contact] axial share, with the axial slip of the step
    double breakaway;          // m
};

// Per lane: values are interleaved, lane fastest. Sizes in units of lanes.
struct KernelState {
    double* unknowns;     // [node][stride] d in m, d' in 1, theta in rad; fixed ones included
    double* multiplier;   // [contact] lambda, N/m
    double* slack;        // [contact] w > 0, m^2; equals (c^2 - |d|^2) / 2 at convergence
    double* phi_mu;       // [contact] signed friction coefficient
    double* step;         // [node][stride] and kLanes values that are finite
    double* multiplier_step;  // [contact]
    double* slack_step;       // [contact]
    double* diagonal;     // [node][stride][block_stride] factored blocks
    double* upper;        // [node][stride][block_stride] A^-1 U
    double* lower;        // [node][stride][block_stride]
    double* rhs;          // [node][stride]
    // [element][Gauss point][tube][2] of the loads beyond on that tube, N m as a curvature vector, then the torque of the tip
    // moment on the innermost tip, N m
    const double* load_moment;
    const SlipLaw* slip;      // null: phi_mu is given; else it follows the slip (single lane)
    const double* anchor; // [node][stride] angles that damping pulls back to; null without damping
    int block_stride;     // row length of blocks: room for stride + 1 entries, for a single lane in whole registers
    const double* shift;  // [contact][2] m, added to the offset of a contact; null without exact geometry (exact_geometry.hpp)
    const double* load;   // [node][stride], where the residual starts instead of at zero; null likewise
};

// One function table per instruction set; the scalar ones treat a single lane.
struct KernelTable {
    // Assembles the primal-dual Newton system at barrier level [N/m] (one per lane), factors it and solves for step.
    // damping [1/m^2], one per lane, adds damping * GJ times the distance of every theta from its anchor to the torques.
    void (*newton)(const KernelProblem&, const KernelState&, const double* level, const double* damping);
    // Largest fraction of the step, per lane, that keeps every slack and multiplier above (1 - keep) of its value, <= 1.
    void (*step_length)(const KernelProblem&, const KernelState&, double keep, double* primal, double* dual);
    // unknowns and slacks += primal * step, multiplier += dual * multiplier_step.
    void (*advance)(const KernelProblem&, const KernelState&, const double* primal, const double* dual);
    // True residual with the multipliers as they are: rhs is filled; moment [N m] is the largest of |force| * element
    // length, |moment|, |torque|; complementarity is max |lambda w - eps| / eps.
    void (*residual)(const KernelProblem&, const KernelState&, const double* level, double* moment, double* complementarity);
    // Solves with the last factors for the right-hand side in rhs, into step (multiplier_step is not touched).
    void (*solve)(const KernelProblem&, const KernelState&);
    // The step of newton() corrected by what contacts add at second order, with the same factors: into the steps of
    // `corrected`, which shares everything else with the state.
    void (*correct)(const KernelProblem&, const KernelState&, const KernelState& corrected);
    // Bending of linear round tubes for unknowns [node][stride]: curvature of the innermost one at the Gauss points, 1/m,
    // into [element][Gauss point][2], and per lane the square of the largest strain of any.
    void (*bending)(const KernelProblem&, const double* unknowns, double* innermost, double* strain_square);
};

const KernelTable& baseline_kernel(int lanes);
const KernelTable& avx2_kernel(int lanes);
const KernelTable& avx512_kernel();    // of kMostLanes
const KernelTable& kernel(int lanes);  // the best this CPU runs; CTRPLAN_KERNEL=baseline or avx2 forces a lesser one
int lanes_for(std::size_t states);     // kLanes, or kMostLanes if that takes fewer batches and this CPU has such a kernel
const char* kernel_name();

}  // namespace ctr
