"""What a study is given: scans in several files, meshes in another frame, tours, keys said twice, functions."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import phantoms
import pytest
import SimpleITK
import trimesh
from dicom_series import write_series
from here import Here
from places import ROBOTS, SCENARIOS

import ctrplan
from ctrplan.base.catalogue import code_version
from ctrplan.errors import InputError
from ctrplan.studies.study.study import Study

PAIR, THREE = str(ROBOTS / "table_5_pair.toml"), str(ROBOTS / "three_tube.toml")
TUMOUR_RAS = np.array([-31.0, 17.0, 57.0])
SCENARIO = f"""
robot = '{PAIR}'
frame = "RAS"
start = {{ "rotate outer" = 0, "rotate inner" = 0, "translate inner" = -17 }}
goal.joints = {{ "rotate outer" = 0, "rotate inner" = 20, "translate inner" = -17 }}
"""


def scenario(folder: Path, **part: Any) -> str:
    keys = "\n".join(f"{key} = {value!r}" for key, value in part.items())
    (folder / "s.toml").write_text(f"{SCENARIO}[[anatomy]]\n{keys}\n" if part else SCENARIO, encoding="utf-8")
    return str(folder / "s.toml")


def run(folder: Path, content: dict[str, Any], executor: Any = None) -> ctrplan.StudyTable:
    return Study.of(content, folder, allow_outside=True).run(folder / "out", executor=executor or Here())


@pytest.mark.parametrize("kind", ["dicom", "mhd"])
def test_a_scan_in_several_files_travels_and_counts(kind: str, tmp_path: Path) -> None:
    """Once neither could be found by the tasks, and another scan in their place would have left the old rows."""
    image = phantoms.image(phantoms.hand, phantoms.CENTRE, 18, 2.0, np.eye(3))
    if kind == "dicom":
        (tmp_path / "scan").mkdir()
        write_series(tmp_path / "scan", image, "1.2.3")
        voxels = next((tmp_path / "scan").iterdir())
    else:
        SimpleITK.WriteImage(image, str(tmp_path / "scan.mhd"))
        voxels = tmp_path / "scan.raw"
    name = "scan" if kind == "dicom" else "scan.mhd"
    content = {"scenario": scenario(tmp_path, kind="volume", file=name, label=3), "task": {"kind": "bound"}}
    table, again, changed = run(tmp_path, content), Here(), Here()
    assert table.done.all(), table.columns["reason"]
    run(tmp_path, content, again)
    data = bytearray(voxels.read_bytes())
    data[-1] ^= 1
    voxels.write_bytes(data)
    run(tmp_path, content, changed)
    assert (again.done, changed.done) == (0, 1)


def mesh(path: Path, frame: str | None) -> Path:
    """A ball that is at TUMOUR_RAS, in coordinates of a frame that the file says, or of RAS."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=5)
    ball.apply_translation(TUMOUR_RAS * ((-1, -1, 1) if frame == "LPS" else (1, 1, 1)))
    data = ball.export(file_type="stl")
    head = f"SPACE={frame}" if frame else "made by hand"
    path.write_bytes(head.encode().ljust(80) + data[80:])
    return path


def test_rows_that_other_code_of_ones_own_made_are_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows stayed where a file of an effect or shape of one's own was edited."""
    own = tmp_path / "EXTENSIONS" / "effects" / "drive" / "mine.py"
    own.parent.mkdir(parents=True)
    monkeypatch.setenv("CTRPLAN_EXTENSIONS", str(tmp_path / "EXTENSIONS"))
    content, solved = {"scenario": scenario(tmp_path), "task": {"kind": "bound"}}, list[int]()
    for text in ("x = 1", "x = 1", "x = 2"):
        own.write_text(text, encoding="utf-8")
        code_version.cache_clear()
        here = Here()
        run(tmp_path, content, here)
        solved.append(here.done)
    monkeypatch.undo()
    code_version.cache_clear()
    assert solved == [1, 0, 1]
    assert code_version() == ctrplan.__version__


@pytest.mark.parametrize("frame", ["LPS", "RAS"])
@pytest.mark.parametrize("key", ["within", "on"])
def test_points_of_a_mesh_are_where_its_frame_says(frame: str, key: str, tmp_path: Path) -> None:
    """Once a target of 3D Slicer, in LPS, was looked for on the other side of a patient in RAS."""
    targets = {key: str(mesh(tmp_path / "tumour.stl", frame)), "count": 200}
    content = {"scenario": scenario(tmp_path), "task": {"kind": "ik"}, "targets": targets}
    made = Study.of(content, tmp_path, allow_outside=True)
    points = np.array([list(made.tasks[k].inputs.values()) for k in range(made.count)])
    assert np.linalg.norm(points - TUMOUR_RAS, axis=1).max() < 5.001


def test_a_mesh_that_says_no_frame_is_asked_for_it(tmp_path: Path) -> None:
    targets = {"within": str(mesh(tmp_path / "tumour.stl", None)), "count": 3}
    content = {"scenario": scenario(tmp_path), "task": {"kind": "ik"}, "targets": targets}
    with pytest.raises(InputError, match=r"targets\.frame: is missing: tumour\.stl does not say"):
        Study.of(content, tmp_path, allow_outside=True)
    said = content | {"targets": targets | {"frame": "RAS"}}
    assert np.abs(np.array(Study.of(said, tmp_path, allow_outside=True).axes[-1].values) - TUMOUR_RAS).max() < 5
    mesh(tmp_path / "tumour.stl", "LPS")
    with pytest.raises(InputError, match=r"targets\.frame = 'RAS': contradicts tumour\.stl, which says LPS"):
        Study.of(said, tmp_path, allow_outside=True)


def tour(folder: Path, targets: str) -> str:
    text = (SCENARIOS / "pair_free.toml").read_text(encoding="utf-8").replace("robots/", f"{ROBOTS}/")
    before = text.partition("[goal")[0]
    (folder / "tour.toml").write_text(f"{before}\n{targets}\n[planner]\ntime_s = 0.3\n", encoding="utf-8")
    return str(folder / "tour.toml")


def test_a_tour_is_as_bad_as_its_worst_target(tmp_path: Path) -> None:
    """Once only the last target counted, direction tolerances counted for nothing, and intervals twice."""
    robot = ctrplan.load_robot(PAIR)
    start = ctrplan.load_scenario(SCENARIOS / "pair_free.toml").start
    turned = np.array([name == "rotate inner" for name in robot.drive.named(start)])
    targets = []
    for degrees, tolerance_mm in ((40.0, 0.01), (20.0, 80.0)):
        tip_mm = robot.solve(*robot.drive.collars(start + turned * np.radians(degrees))).tip_m * 1e3
        targets.append(f"[[target]]\ntip_mm = {tip_mm.tolist()}\ntolerance_mm = {tolerance_mm}")
    task = {"kind": "plan", "compensate": False}
    table = run(tmp_path, {"scenario": tour(tmp_path, "\n".join(targets)), "task": task})
    plan = ctrplan.plan(ctrplan.load_scenario(tmp_path / "tour.toml", allow_outside=True), compensated=False)
    first, last = plan.certificate.targets
    worst_m = [target.tip_error_m + target.bound_m + target.play_m for target in (first, last)]
    assert table["worst_mm"][0] == max(worst_m) * 1e3 and not table["within_tolerance"][0]
    assert first.arrival is not None and last.arrival is not None
    assert table["arrival_mm"][0] == max(first.arrival.error_m, last.arrival.error_m) * 1e3
    with pytest.raises(InputError, match=r"task\.tip_mm: is missing: the scenario has 2 targets"):
        run(tmp_path, {"scenario": str(tmp_path / "tour.toml"), "task": {"kind": "ik"}})


def test_bases_do_not_turn_loads(tmp_path: Path) -> None:
    """Once tasks with other bases were done as if the world turned with the robot."""
    load = {"key": "robot.effects.tip_load.force_x_N", "values": [0.0, 0.1]}
    content: dict[str, Any] = {"scenario": scenario(tmp_path), "task": {"kind": "bound"}, "vary": [load]}
    bases = {"bases": {"poses": [{"position_mm": [0, 0, 0], "direction": [0, 1, 9]}]}}
    with pytest.raises(InputError, match="effects: has loads, which are stated in the robot's frame"):
        Study.of(content | bases, tmp_path, allow_outside=True).run(tmp_path / "turned", executor=Here())
    assert run(tmp_path, content)["status"].tolist() == ["done", "done"]


def test_a_target_is_kept_where_friction_and_play_leave_tip_and_direction_within_tolerance(tmp_path: Path) -> None:
    """Once friction might turn the tip as far as it liked, and play move it."""
    robot = ctrplan.load_robot(THREE)
    there = robot.solve([0, 1, 2], [0, -0.017, -0.06])
    along = there.tubes[-1].frames[-1][:, 2]
    given: dict[str, Any] = {"kind": "ik", "starts": 40, "tip_mm": (there.tip_m * 1e3).tolist(), "tolerance_mm": 20}
    given |= {"direction": along.tolist(), "direction_tolerance_deg": 25}
    backlash: dict[str, Any] = {"key": "robot.effects.backlash.theta_3_deg", "values": [0, 12]}
    table = run(tmp_path, {"robot": THREE, "task": given, "vary": [backlash]})
    for k, width in enumerate(backlash["values"]):
        own = ctrplan.load_robot(THREE, [f"effects.backlash.theta_3_deg={width}"])
        limits: dict[str, Any] = {"tolerance_m": 0.02, "direction_tolerance_rad": np.radians(25), "starts": 40}
        ways = ctrplan.inverse_kinematics(own, there.tip_m, along, **limits).valid
        kept = [way for way in ways if way.worst_m <= 0.02 and way.worst_rad <= np.radians(25)]
        assert table["within_tolerance"][k] == bool(kept)
        best = min(way.worst_m for way in kept or ways)
        assert table["worst_mm"][k] == pytest.approx(best * 1e3)
    (tmp_path / "turned").mkdir()
    turned = run(tmp_path / "turned", {"robot": THREE, "task": given | {"direction_tolerance_deg": 3}})
    assert turned["status"][0] == "done" and not turned["within_tolerance"][0]


@pytest.mark.parametrize(
    ("key", "beside", "said"),
    [
        ("goal.tip_mm", {"points_mm": [[18, 0, 80]]}, "targets"),
        ("goal", {"points_mm": [[18, 0, 80]]}, "targets"),
        ("target.1.tolerance_mm", {"points_mm": [[18, 0, 80]]}, "targets"),
        ("goal.tolerance_mm", {"points_mm": [[18, 0, 80]], "tolerance_mm": 2}, "targets"),
        ("base.look_at", {"poses": [{"position_mm": [0, 0, 0], "direction": [0, 0, 1]}]}, "bases"),
    ],
)
def test_a_key_that_two_tables_say_is_refused(key: str, beside: dict[str, Any], said: str) -> None:
    content = {"scenario": str(SCENARIOS / "ventricle.toml"), "task": {"kind": "plan"}, said: beside}
    with pytest.raises(InputError, match=rf"vary\.1\.key = '{key}': is said by \[{said}\] already"):
        Study.of(content | {"vary": [{"key": key, "values": [[1, 2, 3]]}]})


def test_a_tolerance_that_is_varied_holds_for_the_targets_of_a_study() -> None:
    """Once [targets] took the whole goal's place, and the column of the table stood for nothing."""
    content = {
        "scenario": str(SCENARIOS / "ventricle.toml"),
        "task": {"kind": "plan"},
        "targets": {"points_mm": [[18, 0, 80]]},
        "vary": [{"key": "goal.tolerance_mm", "values": [1.5, 2.5]}],
    }
    made = Study.of(content)
    tolerances = [
        ctrplan.load_scenario(content["scenario"], made.tasks[k].overrides).goal.tolerance_m for k in range(2)
    ]
    assert tolerances == pytest.approx([1.5e-3, 2.5e-3])
    with pytest.raises(InputError, match=r"is said by \[targets\] already"):  # an ik task has task.tolerance_mm
        Study.of(content | {"task": {"kind": "ik"}})


FUNCTIONS = """
import asyncio
from fractions import Fraction

VALUES = [2**70, Fraction(1, 4), "half \\ud800", 3]

def f(scenario, inputs, seed):
    return VALUES[seed] if seed < 3 else {"seed": 1.0}

def g(scenario, inputs, seed):
    raise [MemoryError("of mine"), ModuleNotFoundError("No module named 'nothing'"), asyncio.CancelledError()][seed]
"""


def test_functions_that_return_oddly_leave_a_row_and_a_table(tmp_path: Path) -> None:
    (tmp_path / "odd.py").write_text(FUNCTIONS, encoding="utf-8")
    content = {
        "robot": PAIR,
        "task": {"kind": "function", "function": "odd:f"},
        "vary": [{"key": "seed", "values": [0, 1, 2, 3]}],
    }
    table = run(tmp_path, content)
    assert table.columns["status"] == ["done", "done", "refused", "refused"]
    assert table["value"][:2].tolist() == [2.0**70, 0.25]
    assert "half " in table.columns["reason"][2] and "other names than 'seed'" in table.columns["reason"][3]
    assert (tmp_path / "out" / "results.parquet").is_file() and table.columns["seed"] == [0, 1, 2, 3]


def test_what_the_machine_lacked_is_tried_again(tmp_path: Path) -> None:
    """Memory, and a module that was installed since: rows that said so stayed for ever."""
    (tmp_path / "odd.py").write_text(FUNCTIONS, encoding="utf-8")
    content = {
        "robot": PAIR,
        "task": {"kind": "function", "function": "odd:g"},
        "vary": [{"key": "seed", "values": [0, 1, 2]}],
    }
    table = run(tmp_path, content)
    assert table.columns["status"] == ["lost", "lost", "failed"]
    assert "MemoryError: of mine" in table.columns["reason"][0] and "'nothing'" in table.columns["reason"][1]
    again = Here()
    run(tmp_path, content, again)
    assert again.done == 2


def test_more_base_poses_than_could_be_looked_at_are_refused() -> None:
    patch = {"center_mm": [0, 0, 0], "normal": [0, 0, 1], "radius_mm": 5000, "step_mm": 0.01}
    content = {"scenario": str(SCENARIOS / "ventricle.toml"), "task": {"kind": "bound"}, "bases": {"patch": patch}}
    with pytest.raises(InputError, match=r"bases\.patch\.step_mm = 0\.01 mm: makes 1,000,002,000,001 positions"):
        Study.of(content)


LEAVES = """
from ctrplan.studies.study.study import Study
made = Study.of({"scenario": SCENARIO, "task": {"kind": "ik"}, "targets": {"within": "anatomy", "step_mm": 25}})
print([abs(value) for k in range(made.count) for value in made.tasks[k].inputs.values() if str(value) == "-0.0"])
"""


def test_a_study_of_an_anatomy_ends_without_a_word() -> None:
    """Trees that outlived the interpreter were told of in nine lines by their library; zeros had signs."""
    script = LEAVES.replace("SCENARIO", repr(str(SCENARIOS / "ventricle.toml")))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("[]\n", "")
