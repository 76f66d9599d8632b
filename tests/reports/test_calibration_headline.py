"""A calibration that has not helped is not told in green."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from ctrplan.reports.calibration_page import headline


@pytest.mark.parametrize(
    ("fitted", "kept_aside", "said"),
    [(0.5e-3, None, ""), (1.2e-3, 1.55e-3, "no better than the robot of the file"), (0.5e-3, 0.6e-3, "")],
)
def test_the_headline_says_where_poses_kept_aside_are_no_better(
    fitted: float, kept_aside: float | None, said: str
) -> None:
    errors: Any = SimpleNamespace(
        nominal=SimpleNamespace(rms_m=1.31e-3),
        training=SimpleNamespace(rms_m=fitted),
        held_out=None if kept_aside is None else SimpleNamespace(rms_m=kept_aside),
    )
    assert headline(errors).endswith(said) and ("no better" in headline(errors)) == bool(said)
