"""The algorithm of Ha, Fagogenis, Dupont, IEEE T-RO 35(2), 2019, as printed: an oracle for tests, a baseline for time.

Sections II-E and III with Appendices A and B, in SI units. Equation numbers are the paper's; where its text is damaged
the equation that derivation and finite differences confirm stands here, and the line says so ("erratum"). Two ways to
the solution of the same discretised problem:

- `solve`, the documented default and the paper's own: linearise, climb the dual by projected gradient ascent with the
  Woodbury solve of Appendix A, linearise again. Nothing is added but a unit for lambda (see `Ascent`); the switch
  `momentum`, off by default, is not the paper's.
- `refine`, not the paper's: Newton on the KKT conditions of what that outer loop converges to, with exact derivatives.

Conventions. Tubes are numbered from the outermost; tube i is clamped at its collar on the axis, position (0, 0, l_ib),
frame Rz(theta_ib); u_y > 0 bends towards +x. Behind the plate (s <= 0) tube 1 lies on the axis and may twist; the other
tubes are held there by their collars and by contact alone. A mesh is one list of nodes for all tubes; the curvature of
a tube is constant between nodes. The paper's curvature at the last node of a tube moves nothing and is left out.
OPENBLAS_NUM_THREADS=1 pays: the matrices are small, and on a busy machine a second thread makes it 5-10 times slower.
Indices: element e of a tube lies between its nodes e and e + 1, both counted from its collar.
"""

from paper_oracle.ascent import Ascent, constraint, linearise, minimiser, solve
from paper_oracle.equilibrium import gaps, imbalance, residual, stiffness_matrix
from paper_oracle.newton import refine
from paper_oracle.nodes import mesh
from paper_oracle.problem import Problem
from paper_oracle.solution import Solution
from paper_oracle.zero_clearance_model import zero_clearance

__all__ = [
    "Ascent",
    "Problem",
    "Solution",
    "constraint",
    "gaps",
    "imbalance",
    "linearise",
    "mesh",
    "minimiser",
    "refine",
    "residual",
    "solve",
    "stiffness_matrix",
    "zero_clearance",
]
