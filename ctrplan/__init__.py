"""Motion planning for concentric tube robots with certified bounds on friction-induced error.

Names are loaded on first use, so that `import ctrplan` costs nothing that a script does not need.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from ctrplan import planning
    from ctrplan.calibration import Calibration, calibrate
    from ctrplan.diagnosis.diagnose import diagnose as diagnose
    from ctrplan.diagnosis.result import Diagnosis
    from ctrplan.errors import CtrplanError, InputError, NoAnswerError
    from ctrplan.history import History, HistoryStep
    from ctrplan.measurement_file import load_measurements
    from ctrplan.measurements import Measurements
    from ctrplan.mechanics import Bound, Bounds, Shape, Status
    from ctrplan.planning.plan import Plan
    from ctrplan.planning.planner import plan as plan
    from ctrplan.planning.reorder import reorder as reorder
    from ctrplan.robot import Robot, load_robot
    from ctrplan.scenario import Scenario, load_scenario

_HOMES = {
    "Calibration": "calibration",
    "Diagnosis": "diagnosis.result",
    "calibrate": "calibration",
    "Measurements": "measurements",
    "diagnose": "diagnosis.diagnose",
    "load_measurements": "measurement_file",
    "Bound": "mechanics",
    "Bounds": "mechanics",
    "Shape": "mechanics",
    "Status": "mechanics",
    "History": "history",
    "HistoryStep": "history",
    "CtrplanError": "errors",
    "InputError": "errors",
    "NoAnswerError": "errors",
    "Robot": "robot",
    "load_robot": "robot",
    "Scenario": "scenario",
    "load_scenario": "scenario",
    "Plan": "planning",
    "plan": "planning",
    "reorder": "planning",
}
__all__ = [
    "Bound",
    "Bounds",
    "Calibration",
    "CtrplanError",
    "Diagnosis",
    "History",
    "HistoryStep",
    "InputError",
    "Measurements",
    "NoAnswerError",
    "Plan",
    "Robot",
    "Scenario",
    "Shape",
    "Status",
    "calibrate",
    "diagnose",
    "load_measurements",
    "load_robot",
    "load_scenario",
    "plan",
    "planning",
    "reorder",
]


def __getattr__(name: str) -> Any:
    if name == "planning":
        return importlib.import_module("ctrplan.planning")
    if name not in _HOMES:
        raise AttributeError(f"module 'ctrplan' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"ctrplan.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
