"""Planning: search, reordering and certification of motions. The only package that imports OMPL.

For an OMPL set-up of one's own: `state_space`, `Validity`, `MotionValidity` and `BoundObjective` share a
`MotionChecker`; `StateReader` reads and writes states, `l_shaped` expands a path of states into legs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ctrplan.base.package import homes_in, lazy_names

if TYPE_CHECKING:
    from ctrplan.certificate.certificate import Certificate as Certificate
    from ctrplan.certificate.certificate import CertificateSamples as CertificateSamples
    from ctrplan.motion.checker import MotionChecker as MotionChecker
    from ctrplan.planning.given_path import reorder as reorder
    from ctrplan.planning.planner import plan as plan
    from ctrplan.planning.search.ompl_set_up import BoundObjective as BoundObjective
    from ctrplan.planning.search.ompl_set_up import MotionValidity as MotionValidity
    from ctrplan.planning.search.ompl_set_up import StateReader as StateReader
    from ctrplan.planning.search.ompl_set_up import Validity as Validity
    from ctrplan.planning.search.ompl_set_up import state_space as state_space
    from ctrplan.plans.plan import Plan as Plan
    from ctrplan.plans.planned_motion import Leg as Leg
    from ctrplan.plans.planned_motion import ReorderReport as ReorderReport
    from ctrplan.scenario.joint_space import JointSpace as JointSpace
    from ctrplan.scenario.joint_space import l_shaped as l_shaped

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
__getattr__ = lazy_names(__name__, homes_in(__file__))
