"""Steps of a history."""

from __future__ import annotations

from dataclasses import dataclass

from ctrplan.base.arguments import Number, checked


@checked(
    breakaway_m=Number(1e-7, 0.1, "m"),
    rotation_rad=Number(1e-4, 1, "rad"),
    translation_m=Number(1e-6, 0.1, "m"),
    state_change=Number(1e-4, 1),
)
@dataclass(frozen=True)
class HistoryOptions:
    """How a history is stepped; halving the steps moves no tip by more than 0.05 mm (benchmarks/run.py history)."""

    breakaway_m: float = 0.02e-3  # slip over which friction builds up
    rotation_rad: float = 0.05  # longest step of a tube base
    translation_m: float = 0.5e-3
    state_change: float = 0.05  # of phi, mean over the contacts weighted by force, aimed at in a step
