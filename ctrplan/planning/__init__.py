"""Planning: search, reordering and certification of motions. The only package that imports OMPL.

For an OMPL set-up of one's own: `state_space`, `Validity`, `MotionValidity` and `BoundObjective` share a
`MotionChecker`; `StateReader` reads and writes states, `l_shaped` expands a path of states into legs.
"""

from __future__ import annotations

from ctrplan.planning.certified import Certificate, CertificateSamples
from ctrplan.planning.finish.reorder import reorder
from ctrplan.planning.joint_space import JointSpace, l_shaped
from ctrplan.planning.motion import MotionChecker
from ctrplan.planning.plan import Plan
from ctrplan.planning.planned_motion import Leg, ReorderReport
from ctrplan.planning.planner import plan
from ctrplan.planning.search.objective import BoundObjective
from ctrplan.planning.search.ompl_space import StateReader, state_space
from ctrplan.planning.search.validity import MotionValidity, Validity

__all__ = [
    "BoundObjective",
    "Certificate",
    "CertificateSamples",
    "JointSpace",
    "Leg",
    "MotionChecker",
    "MotionValidity",
    "Plan",
    "ReorderReport",
    "StateReader",
    "Validity",
    "l_shaped",
    "plan",
    "reorder",
    "state_space",
]
