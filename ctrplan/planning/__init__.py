"""Planning: search, reordering and certification of motions. The only package that imports OMPL.

For an OMPL set-up of one's own: `state_space`, `Validity`, `MotionValidity` and `BoundObjective` share a
`MotionChecker`; `StateReader` reads and writes states, `l_shaped` expands a path of states into legs.
"""

from __future__ import annotations

from ctrplan.certificate.certificate import Certificate, CertificateSamples
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.planner import plan
from ctrplan.planning.reorder import reorder
from ctrplan.planning.search.ompl_set_up import BoundObjective, MotionValidity, StateReader, Validity, state_space
from ctrplan.plans.plan import Plan
from ctrplan.plans.planned_motion import Leg, ReorderReport
from ctrplan.scenario.joint_space import JointSpace, l_shaped

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
