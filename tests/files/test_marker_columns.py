"""Markers in robot files, in files of measurements under their own columns, and in what a simulation writes."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from measured_data import pair_robot
from scipy.spatial.transform import Rotation

from ctrplan.errors import InputError
from ctrplan.files.measurement_file import load_joint_path, load_measurements
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot
from ctrplan.studies.simulate import poses_csv, simulate

MARKERS: list[dict[str, Any]] = [
    {"name": "nose", "tube": 2, "from_tip_mm": 0},
    {"name": "ring", "tube": 1, "from_base_mm": 50, "position_sigma_mm": 0.3},
]
PATH = "sequence,theta_1_rad,theta_2_rad,l_1_m,l_2_m\n0,0,0,0,-0.02\n0,0,1,0,-0.02\n0,0,2,0,-0.01\n"


def robot(**keys: Any) -> Robot:
    return pair_robot(**({"marker": MARKERS} | keys))


@pytest.fixture
def poses(tmp_path: Path) -> Path:
    """What `simulate` writes of a path."""
    return written(robot(), tmp_path)


def written(of: Robot, folder: Path) -> Path:
    (folder / "path.csv").write_text(PATH)
    (folder / "poses.csv").write_text(poses_csv(simulate(of, load_joint_path(folder / "path.csv", of))))
    return folder / "poses.csv"


def rewritten(path: Path, change: Any) -> Path:
    """The table of `path` after change(list of rows as dicts, column -> text)."""
    with open(path, encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        change(row)
    with open(path.with_name("changed.csv"), "w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path.with_name("changed.csv")


def point(data: Measurements, number: int) -> Any:
    return data.position_m[data.seen_marker == number]


def test_what_simulate_writes_of_markers_is_read_again(poses: Path) -> None:
    data = load_measurements(poses, robot())
    assert data.count == 9 and data.rows.tolist() == [0, 1, 2] * 3 and data.run.max() == 2
    np.testing.assert_array_equal(point(data, 1), point(data, 0))  # at the tip
    assert np.ptp(point(data, 2), axis=0).max() > 1e-4
    np.testing.assert_allclose(data.noise_ratio, np.repeat([1.0, 1.0, 3.0], 3))
    assert not data.given[data.seen_marker > 0, 3:].any() and data.given[:, :3].all()
    assert "ring_x_m" not in data.more


def test_a_tracker_that_stands_elsewhere_sees_markers_there(tmp_path: Path) -> None:
    shifted = robot(effects={"base_misalignment": {"shift_x_mm": 5.0}})
    with open(written(shifted, tmp_path), encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for name in ("", "nose_", "ring_"):
        seen, there = (np.array([float(row[f"{kind}{name}x_m"]) for row in rows]) for kind in ("measured_", ""))
        np.testing.assert_allclose(seen - there, 5e-3, rtol=1e-9)


def test_two_coordinates_and_rows_without_a_marker(poses: Path) -> None:
    def change(row: dict[str, str]) -> None:
        del row["ring_y_m"]
        if row["theta_2_rad"] == "1.0":
            row["ring_x_m"] = row["ring_z_m"] = ""

    data = load_measurements(rewritten(poses, change), robot())
    ring = data.seen_marker == 2
    assert data.rows[ring].tolist() == [0, 2]
    assert data.given[ring].tolist() == [[True, False, True, False, False]] * 2
    assert any("ring_y_m: it is taken for seen along y" in warning for warning in data.warnings)


def test_markers_without_a_tip(poses: Path) -> None:
    def change(row: dict[str, str]) -> None:
        for name in ("x_m", "y_m", "z_m", "tx", "ty", "tz"):
            del row[name]

    data = load_measurements(rewritten(poses, change), robot())
    assert set(data.seen_marker.tolist()) == {1, 2} and not data.has_tangents


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            lambda row: (row.pop("ring_y_m"), row.pop("ring_z_m")),
            "ring_x_m: one coordinate of a marker says too little",
        ),
        (lambda row: row.update(ring_y_m=""), "row 1, ring_y_m: is empty, a marker needs all of ring_x_m, ring_y_m"),
        (
            lambda row: row.update(ring_x_m="9"),
            "row 1, ring_x_m = 9.0: marker is 9.00014 m from the base, beyond the reach",
        ),
        (lambda row: row.update(x_m=""), "row 1, x_m: is empty, a pose needs all of x_m"),
    ],
)
def test_what_says_too_little_is_refused(change: Any, sentence: str, poses: Path) -> None:
    with pytest.raises(InputError) as refusal:
        load_measurements(rewritten(poses, change), robot())
    assert sentence in str(refusal.value)


def test_markers_find_the_place_of_a_tracker_that_nobody_registered(tmp_path: Path) -> None:
    """To where the file has them without clearance and friction: within what these two do."""
    path = "sequence,theta_1_rad,theta_2_rad,l_1_m,l_2_m\n"
    path += "".join(f"0,{0.5 * k},{1.1 * k},0,{-0.02 - 0.001 * k}\n" for k in range(8))
    (tmp_path / "path.csv").write_text(path)
    of = robot(marker=[{"name": "ring", "tube": 2, "from_tip_mm": 20}])
    result = simulate(of, load_joint_path(tmp_path / "path.csv", of))
    truth = result.marker_m[result.waypoints, 0]
    moved = Rotation.from_rotvec([0.3, -0.2, 2.0]).apply(truth) + [0.1, -0.2, 0.05]
    rows = [[*row.split(","), *map(repr, map(float, at))] for row, at in zip(path.splitlines()[1:], moved, strict=True)]
    header = path.splitlines()[0] + ",ring_x_m,ring_y_m,ring_z_m"
    (tmp_path / "log.csv").write_text("\n".join([header, *map(",".join, rows)]) + "\n")
    columns = {"theta": ["theta_1_rad", "theta_2_rad"], "l": ["l_1_m", "l_2_m"], "sequence": "sequence"}
    columns["markers"] = {"ring": ["ring_x_m", "ring_y_m", "ring_z_m"]}  # type: ignore[assignment]
    mapping = {"run": [{"file": "log.csv", "frame": "unknown"}], "columns": columns}
    (tmp_path / "map.toml").write_text(tomli_w.dumps(mapping))
    found = load_measurements(tmp_path / "map.toml", of).position_m
    assert np.sqrt(np.mean(np.sum((found - truth) ** 2, axis=1))) < 0.5e-3


def test_a_mapping_file_names_the_columns_of_markers(poses: Path) -> None:
    mapping = {
        "run": [{"file": "poses.csv", "frame": {"position_mm": [10, 0, 0]}}],
        "columns": {
            "theta": ["theta_1_rad", "theta_2_rad"],
            "l": ["l_1_m", "l_2_m"],
            "markers": {"ring": ["-ring_x_m", "ring_y_m", "ring_z_m"]},
        },
    }

    def load(**changes: Any) -> Measurements:
        content = mapping | {"columns": mapping["columns"] | changes}  # type: ignore[operator]
        (poses.parent / "map.toml").write_text(tomli_w.dumps(content))
        return load_measurements(poses.parent / "map.toml", robot())

    plain = load_measurements(poses, robot())
    np.testing.assert_allclose(load().position_m, point(plain, 2) * [-1, 1, 1] - [10e-3, 0, 0], atol=1e-15)
    with pytest.raises(InputError, match="columns.markers.hoop = .*: must name a marker of the robot: nose, ring"):
        load(markers={"hoop": ["ring_x_m", "ring_y_m", "ring_z_m"]})
    with pytest.raises(InputError, match="columns.position: is missing"):
        load(markers={})
    with pytest.raises(InputError, match="markers of two coordinates exclude each other"):
        load(markers={"ring": ["ring_x_m", "", "ring_z_m"]})


@pytest.mark.parametrize(
    ("marker", "sentence"),
    [
        ({"name": "a", "tube": 3, "from_tip_mm": 1}, "tube = 3: must be one of the 2 tubes"),
        ({"name": "a", "tube": 1}, "must have from_tip_mm or from_base_mm, one of them"),
        ({"name": "a", "tube": 1, "from_tip_mm": 1, "from_base_mm": 1}, "must have from_tip_mm or from_base_mm, one"),
        (
            {"name": "a", "tube": 1, "from_tip_mm": 61},
            "from_tip_mm = 61 mm: must be within the tube, which is 60 mm long",
        ),
        ({"name": "measured", "tube": 1, "from_tip_mm": 1}, "is a word of other columns"),
        ({"name": "ring", "tube": 1, "from_tip_mm": 1}, "is the name of another marker"),
        ({"name": "a b", "tube": 1, "from_tip_mm": 1}, "name"),
    ],
)
def test_a_marker_that_is_nowhere_is_refused(marker: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError) as refusal:
        robot(marker=[*MARKERS, marker])
    assert sentence in str(refusal.value)


def test_noise_of_a_marker_needs_that_of_the_tip_beside_it() -> None:
    content = robot().content
    with pytest.raises(InputError, match="needs the noise of the tip beside it"):
        robot_from_dict({key: value for key, value in content.items() if key != "measurement"})
