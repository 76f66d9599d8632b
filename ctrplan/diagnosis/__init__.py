"""Where simulation and measurement disagree, which effect is missing, what to measure next. Loaded on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ctrplan.base.package import lazy_names

if TYPE_CHECKING:
    from ctrplan.diagnosis.result import Diagnosis
    from ctrplan.diagnosis.workflow import decide as decide
    from ctrplan.diagnosis.workflow import diagnose as diagnose
    from ctrplan.effects.effect import CATALOGUE, Effect, Parameter, register

_HOMES = {
    "CATALOGUE": "effects.effect",
    "Diagnosis": "diagnosis.result",
    "Effect": "effects.effect",
    "Parameter": "effects.effect",
    "decide": "diagnosis.workflow",
    "diagnose": "diagnosis.workflow",
    "register": "effects.effect",
}
__all__ = ["CATALOGUE", "Diagnosis", "Effect", "Parameter", "decide", "diagnose", "register"]
__getattr__ = lazy_names(__name__, _HOMES)
