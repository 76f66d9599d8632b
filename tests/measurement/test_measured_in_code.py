"""Measurements made in code keep the rules of files: each change that a file would not survive is refused or asked."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from measured_data import measured, pair_robot, waypoints, write_csv

from ctrplan.calibration.calibrate import calibrate
from ctrplan.calibration.reading import MisreadError
from ctrplan.diagnosis import diagnose
from ctrplan.diagnosis.confirmation import confirm
from ctrplan.diagnosis.workflow import decide
from ctrplan.errors import InputError
from ctrplan.files.measurement_file import load_measurements
from ctrplan.measurement.joint_path import JointPath
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.data_rules import require_measured
from ctrplan.studies.follow import follow
from ctrplan.studies.simulate import simulate

ROBOT = pair_robot()
DATA = measured(ROBOT, waypoints(ROBOT, 6))
THETA, L, P, T = DATA.theta_commanded, DATA.l_commanded, DATA.position_m, DATA.tangent
WITH_COLLAR = replace(ROBOT, tubes=(ROBOT.tubes[0], replace(ROBOT.tubes[1], collar_length_m=3e-3)))


class Column(NamedTuple):
    """Holds numbers as a column of pandas does: it is no array, and numpy asks it for one."""

    values: np.ndarray[Any, Any]

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray[Any, Any]:
        return np.array(self.values, dtype)


UNREADABLE: dict[str, tuple[dict[str, Any], str]] = {
    "rows from 1": ({"rows": DATA.rows + 1}, rf"rows.*from 0 to {len(THETA) - 1}"),
    "a row before the first": ({"rows": DATA.rows - 40}, "from 0 to"),
    "too few positions": ({"position_m": P[1:]}, r"position_m: must have shape \(18, 3\), not \(17, 3\)"),
    "two coordinates": ({"position_m": P[:, :2]}, "position_m: must have shape"),
    "another count of tubes": ({"l_commanded": L[:, :1]}, "l_commanded: must have shape"),
    "one waypoint too many": ({"sequence": np.append(DATA.sequence, 99)}, "sequence: must have shape"),
    "a list of one tube": ({"theta_commanded": THETA[:, 0]}, "a row for every waypoint and a column for every tube"),
    "texts": ({"position_m": P.astype(str)}, "position_m: must be numbers, not texts"),
    "rows of unlike length": ({"position_m": [[1.0], [1.0, 2.0]]}, "the same count in every row"),
    "half rows": ({"rows": DATA.rows + 0.5}, r"rows\[0\].*must be a whole number"),
    "no joints": ({"theta_commanded": np.full_like(THETA, np.nan)}, "theta_commanded: must be finite numbers"),
    "no times": ({"time_s": [1.0, 2.0]}, "time_s: must have shape"),
    "none at all": ({"position_m": None}, "position_m: must be numbers"),
    "a short column": ({"more": {"temperature_C": [20.0]}}, "temperature_C: must have shape"),
}


@pytest.mark.parametrize("fault", UNREADABLE)
def test_arrays_that_do_not_go_together_are_refused(fault: str) -> None:
    changes, rule = UNREADABLE[fault]
    with pytest.raises(InputError, match=rule):
        replace(DATA, **changes)


@pytest.mark.parametrize("made", [list, Column, np.ndarray.tolist, np.asfortranarray], ids=lambda made: made.__name__)
def test_whatever_holds_numbers_is_read_to_the_last_digit(made: Callable[[Any], Any]) -> None:
    names = ("sequence", "theta_commanded", "l_commanded", "rows", "position_m", "tangent", "time_s")
    read = replace(DATA, **{name: made(getattr(DATA, name)) for name in names})
    for name in names:
        there = getattr(read, name)
        assert isinstance(there, np.ndarray) and there.dtype == getattr(DATA, name).dtype
        np.testing.assert_array_equal(there, getattr(DATA, name))
    assert replace(DATA).position_m is P  # nothing is copied in a fit


def test_no_tangent_is_none_that_was_measured() -> None:
    plain = replace(DATA, tangent=None)  # type: ignore[arg-type]
    assert not plain.has_tangents and plain.tangent.shape == P.shape
    assert calibrate(ROBOT, plain).training.rms_m < 1e-3


UNBELIEVABLE: dict[str, tuple[dict[str, Any], str]] = {
    "positions in mm": ({"position_m": 1e3 * P}, r"position_m\[0, .\] = .* beyond the reach of 0.2 m, are these mill"),
    "positions in km": ({"position_m": 1e-5 * P}, "position_m: tips are .* from the base, are these metres"),
    "a tip that was not seen": ({"position_m": np.where(np.arange(18)[:, None] == 4, 0, P)}, r"position_m\[4, 0\]"),
    "a coordinate that was not seen": ({"position_m": P * [1, 1, np.nan]}, "must have all coordinates"),
    "translations in mm": ({"l_commanded": 1e3 * L}, r"l_commanded\[0, 1\] = .* in metres .* are these millimetres"),
    "collars at one place": ({"l_commanded": 0 * L}, r"l_commanded\[0\]: the base of tube 2 .* must be at least"),
    "tubes in the other order": ({"l_commanded": L[:, ::-1]}, "are the tubes innermost first"),
    "rotations in thousands": ({"theta_commanded": 1e3 * THETA}, "is more than 50 turns in rad"),
    "tangents of any length": ({"tangent": 3 * T}, r"tangent\[0, 0\] = .* must be a unit vector"),
    "three tubes": (
        {"theta_commanded": THETA[:, [0, 1, 1]], "l_commanded": L[:, [0, 1, 1]]},
        "a column for each of 2 tubes",
    ),
    "a marker that there is not": ({"marker": np.ones(18, int)}, "to 0, the robot's markers"),
    "runs that are resumed": ({"sequence": DATA.sequence % 5}, r"sequence\[.*must stand together"),
    "time backwards": ({"time_s": -np.arange(len(L))}, r"time_s\[1\] = .* time runs backwards"),
}


@pytest.mark.parametrize("fault", UNBELIEVABLE)
def test_what_no_file_may_say_of_the_robot_is_refused_wherever_it_is_given(fault: str) -> None:
    changes, rule = UNBELIEVABLE[fault]
    robot = WITH_COLLAR if "collars" in fault or "order" in fault else ROBOT
    spoilt, diagnosis = replace(DATA, **changes), SimpleNamespace(robot=robot, data=DATA)
    entrances: list[Callable[[], object]] = [
        lambda: calibrate(robot, spoilt),
        lambda: diagnose(robot, spoilt),
        lambda: follow(robot, spoilt),
        lambda: inspect.unwrap(decide)(diagnosis, spoilt),  # type: ignore[arg-type]
        lambda: inspect.unwrap(confirm)(diagnosis, spoilt),  # type: ignore[arg-type]
    ]
    path = JointPath(spoilt.theta_commanded, spoilt.l_commanded, spoilt.sequence, spoilt.time_s)
    if not {"position_m", "tangent", "marker"} & changes.keys():
        entrances.append(lambda: simulate(robot, path))
    for entrance in entrances:
        with pytest.raises(InputError, match=rule):
            entrance()


def test_degrees_are_asked_about_and_not_fitted() -> None:
    with pytest.warns(UserWarning, match="(?s)theta_commanded = .* are these degrees"), pytest.raises(MisreadError):
        calibrate(ROBOT, replace(DATA, theta_commanded=np.degrees(THETA)))


def test_what_a_file_said_is_not_asked_twice_and_what_was_changed_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_csv(tmp_path / "a.csv", DATA)
    read = load_measurements(tmp_path / "a.csv", ROBOT)
    asked = list[Measurements]()
    monkeypatch.setattr("ctrplan.robot.data_rules.check_joints", lambda *_, **__: asked.append(read))
    require_measured(ROBOT, read)
    assert not asked
    for _ in range(2):
        require_measured(pair_robot(), read)
    assert len(asked) == 2
    require_measured(ROBOT, replace(read))
    assert len(asked) == 3


def test_every_array_of_measurements_is_read() -> None:
    wrong = {f.name: "x" for f in fields(Measurements) if "Array" in str(f.type) and f.name != "more"}
    for name, value in wrong.items():
        with pytest.raises(InputError, match=name):
            replace(DATA, **{name: value})
