"""Where simulation and measurement disagree, which effect is missing, what to measure next. Loaded on first use."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ctrplan.diagnosis.diagnose import diagnose as diagnose
    from ctrplan.diagnosis.effect import CATALOGUE, Effect, Parameter, register
    from ctrplan.diagnosis.result import Diagnosis

_HOMES = {
    "CATALOGUE": "candidates",  # where it is full
    "Diagnosis": "result",
    "Effect": "effect",
    "Parameter": "effect",
    "diagnose": "diagnose",
    "register": "effect",
}
__all__ = ["CATALOGUE", "Diagnosis", "Effect", "Parameter", "diagnose", "register"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'ctrplan.diagnosis' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"ctrplan.diagnosis.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
