"""The table of goals counts what it says it counts."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hidden_effects.run import diagnose_all
from hidden_effects.score import Trial, draw_power, goals, intervals, pooled_gap, power, read, reliability, wilson


def trial(row: str, true: list[str], verdict: str, named: list[list[str]], leftover: float = 2.0, **more: Any) -> Trial:
    p = more.get("probability", 0.97)
    effects = [
        {"name": n[0], "alternatives": n[1:], "parameters": more.get("found", {}), "probability": p} for n in named
    ]
    posterior = {"unknown": 0.6, "effects": {n[0]: p for n in named}}
    truth = {
        "effects": true,
        "leftover_over_noise": leftover,
        "parameters": more.get("parameters", {}),
        "case": {"row": row, "hidden": [[true[0] if true else "", 1.0]]},
    }
    after = more.get("after", 0.7)
    region = {"before": {"rms_mm": 1.0}, "after": {"rms_mm": after}}
    gap = {
        "before_rms_mm": 2.0,
        "after_rms_mm": after,
        "noise_floor_mm": 0.69,
        "heldout_poses": 20,
        "after": {"rms_ci95_mm": [0.85 * after, 1.15 * after]},
        "regions": {"near": region, "far": region | more.get("far", {})},
    }
    found = {"verdict": verdict, "effects": effects, "gap": gap, "posterior": posterior, "verdict_probability": p}
    return Trial("x", truth, found, more.get("seconds", 10.0))


@pytest.mark.parametrize(
    ("true", "verdict", "named", "outcome"),
    [
        ([], "no_missing_effect", [], "right"),
        ([], "named", [["lag"]], "WRONG"),
        ([], "unexplained", [], "miss"),
        (["lag"], "named", [["lag"]], "right"),
        (["lag"], "ambiguous", [["friction", "lag"]], "right"),
        (["lag"], "named", [["lag"], ["drift"]], "WRONG"),
        (["lag"], "ambiguous", [["drift"]], "miss"),
        (["a|b"], "named", [["b"]], "right"),
        (["unknown"], "unexplained", [], "right"),
        (["unknown"], "named", [["drift"]], "WRONG"),
        (["lag", "unknown"], "unexplained", [["lag"]], "right"),
        (["lag", "unknown"], "unexplained", [], "miss"),
    ],
)
def test_outcomes(true: list[str], verdict: str, named: list[list[str]], outcome: str) -> None:
    assert trial("single", true, verdict, named).outcome == outcome


def test_rows_count_their_own_trials() -> None:
    trials = [
        trial("null", [], "no_missing_effect", []),
        trial("null", [], "named", [["lag"]]),
        trial("single", ["lag"], "named", [["lag"]], seconds=400.0),
        trial("single", ["lag"], "no_missing_effect", [], leftover=0.4),
        trial("single", ["lag"], "named", [["drift"]]),
        trial("single, heavy tails", ["lag"], "named", [["lag"]]),
        trial("look-alike", ["a|b"], "ambiguous", [["a", "b"]], after=0.9),
        trial("look-alike", ["a|b"], "named", [["a"]], after=0.8, far={"after": {"rms_mm": 1.1}}),
        trial("not in the catalogue", ["unknown"], "named", [["drift"]]),
        trial("not in the catalogue", ["unknown"], "unexplained", []),
        trial("null, correlated", ["unknown"], "unexplained", []),
    ]
    counted = [(goal.hits, goal.trials) for goal in goals(trials)]
    singles = [(1, 2), (1, 1), (0, 0)]
    assert counted == [
        (1, 3),
        (0, 1),
        (1, 2),
        (0, 0),
        *singles,
        (3, 11),
        (0, 0),
        (1, 2),
        (0, 2),
        (2, 2),
        (0, 0),
        (0, 0),
        (1, 2),
        (0, 0),
        (2, 4),
        (3, 4),
        (3, 4),
        (10, 11),
    ]
    assert power(trials)["lag"] == [(0.4, False), (2.0, False), (2.0, True)]
    before, after = pooled_gap(trials)
    assert before == pytest.approx(2.0 / 0.69)
    assert after == pytest.approx(np.sqrt(np.mean(np.square([0.7, 0.7, 0.9, 0.8]))) / 0.69)


def test_probabilities_are_compared_with_what_acts() -> None:
    trials = [
        trial("single", ["lag"], "named", [["lag"]], probability=0.995),
        trial("single", ["lag"], "named", [["drift"]], probability=0.995),
        trial("single", ["lag"], "named", [["lag"]], probability=0.9),
        trial("not in the catalogue", ["unknown"], "named", [["drift"]], probability=0.6),
        trial("null", [], "no_missing_effect", [], probability=1.0),
    ]
    counted = {goal.text: (goal.hits, goal.trials) for goal in reliability(trials) if goal.trials}
    assert counted == {
        "effect acts, p 0.5 to 0.8": (0, 1),
        "effect acts, p 0.8 to 0.95": (1, 1),
        "effect acts, p 0.99 to 1": (1, 2),
        "listed effect acts, p 0.5 to 0.8": (0, 1),
        "listed effect acts, p 0.8 to 0.95": (1, 1),
        "listed effect acts, p 0.99 to 1": (1, 2),
        "verdict is right, p 0.5 to 0.8": (0, 1),
        "verdict is right, p 0.8 to 0.95": (1, 1),
        "verdict is right, p 0.99 to 1": (2, 3),
        "something unknown acts, p 0.5 to 0.8": (1, 5),
    }


def test_wilson_interval_against_published_values() -> None:
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)  # Newcombe 1998, table I
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)
    assert wilson(0, 0) == (0.0, 1.0)


def test_intervals_are_compared_where_truth_has_the_parameter() -> None:
    found = {"theta_2_deg": {"value": 3.0, "ci95": [2.5, 3.5]}, "theta_3_deg": {"value": 0.1, "ci95": [0.0, 0.2]}}
    true = {"backlash": {"theta_2_deg": 3.4, "theta_3_deg": 1.0}}
    given = trial("single", ["backlash"], "named", [["backlash"]], found=found, parameters=true)
    assert list(intervals(given)) == [True, False]
    homing = trial(
        "single",
        ["homing_offset"],
        "named",
        [["homing_offset"]],
        found=found,
        parameters={"homing_rotation": {"theta_2_deg": 2.0}},
    )
    assert list(intervals(homing)) == [False, True]  # the other angle is truly zero


def test_runner_keeps_what_it_has_and_scoring_reads_it(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / "bank" / name).mkdir(parents=True)
        truth = {
            "effects": [],
            "leftover_over_noise": 0.0,
            "parameters": {},
            "case": {"row": "null", "left_out": "lag" if name == "two" else ""},
        }
        (tmp_path / "bank" / name / "truth.json").write_text(json.dumps(truth))
    fake = tmp_path / "fake.py"
    fake.write_text(
        "import json, pathlib, sys\n"
        "out = pathlib.Path(sys.argv[sys.argv.index('-o') + 1])\n"
        "if '--without' in sys.argv: sys.exit('no such thing')\n"
        "(out / 'diagnosis.json').write_text(json.dumps({'verdict': 'no_missing_effect', 'effects': []}))\n"
    )
    diagnose_all(tmp_path / "bank", tmp_path / "out", [sys.executable, str(fake)], jobs=2)
    first = {p: p.stat().st_mtime_ns for p in (tmp_path / "out").rglob("run.json")}
    diagnose_all(tmp_path / "bank", tmp_path / "out", [sys.executable, str(fake)])
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "out").rglob("run.json")} == first and len(first) == 2
    trials = read(tmp_path / "bank", tmp_path / "out")
    assert [t.outcome for t in trials] == ["right", "miss"]
    assert "no such thing" in json.loads((tmp_path / "out" / "two" / "run.json").read_text())["message"]


def test_power_figure_is_drawn(tmp_path: Path) -> None:
    draw_power({"lag": [(0.5, False), (2.0, True)]}, tmp_path / "power.png")
    assert (tmp_path / "power.png").stat().st_size > 1000
