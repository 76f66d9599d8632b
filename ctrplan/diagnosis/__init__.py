"""Calibration's companion: where simulation and measurement disagree, which effect is missing, what to measure next."""

from ctrplan.diagnosis.diagnose import diagnose
from ctrplan.diagnosis.effect import CATALOGUE, Effect, Parameter, register
from ctrplan.diagnosis.result import Diagnosis

__all__ = ["CATALOGUE", "Diagnosis", "Effect", "Parameter", "diagnose", "register"]
