"""Where simulation and measurement disagree, which effect is missing, what to measure next. Loaded on first use."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ctrplan.diagnosis.diagnose import diagnose as diagnose
    from ctrplan.diagnosis.result import Diagnosis
    from ctrplan.effects.effect import CATALOGUE, Effect, Parameter, register

_HOMES = {
    "CATALOGUE": "effects.effect",
    "Diagnosis": "diagnosis.result",
    "Effect": "effects.effect",
    "Parameter": "effects.effect",
    "diagnose": "diagnosis.diagnose",
    "register": "effects.effect",
}
__all__ = ["CATALOGUE", "Diagnosis", "Effect", "Parameter", "diagnose", "register"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'ctrplan.diagnosis' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"ctrplan.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
