"""Planning: search, reordering and certification of motions. The only package that imports OMPL."""

from __future__ import annotations

from ctrplan.planning.objective import BoundObjective
from ctrplan.planning.plan import Certificate, CertificateSamples, Leg, Plan, ReorderReport
from ctrplan.planning.planner import plan
from ctrplan.planning.reorder import reorder

__all__ = ["BoundObjective", "Certificate", "CertificateSamples", "Leg", "Plan", "ReorderReport", "plan", "reorder"]
