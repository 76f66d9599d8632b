"""Sweeps: the same bounds as one by one, tables and pictures that say what they show, refusals in one sentence."""

from __future__ import annotations

import csv
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from places import ROBOTS

from ctrplan.__main__ import main
from ctrplan.errors import InputError
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.mechanics.shapes import Status
from ctrplan.reports.path_pictures import sweep_figure
from ctrplan.storage.toml_document import read_document
from ctrplan.studies.sweep import Sweep, parse_axis, sweep, sweep_csv

PAIR, THREE = str(ROBOTS / "table_5_pair.toml"), str(ROBOTS / "three_tube.toml")
AT = ["--theta-deg", "0", "90", "--l-mm", "0", "-60"]
THREE_AT = ["--theta-deg", "0", "90", "0", "--l-mm", "0", "-17", "-40"]
CLEARANCE, FRICTION = "contact.1.clearance_mm", "contact.1.friction_coefficient"


def swept(*axes: str, overrides: tuple[str, ...] = ()) -> Sweep:
    content = read_document(PAIR, overrides).content
    return sweep(content, [parse_axis(text, 2) for text in axes], np.radians([0, 90]), [0, -0.06])


def rows(path: Path) -> list[dict[str, str]]:
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_one_axis_gives_the_bounds_of_its_configurations(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bound", PAIR, *AT, "--sweep", "l_2=-40:-80:5", "-o", str(tmp_path / "out")]) == 0
    found = capsys.readouterr()
    assert "5 points over l_2" in found.out and "sweep.csv, sweep.png" in found.out and found.err == ""
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"SHA256SUMS", "sweep.csv", "sweep.png"}
    table = rows(tmp_path / "out" / "sweep.csv")
    assert list(table[0]) == ["l_2_mm", "bound_mm", "bound_deg", "stability", "max_strain", "status"]
    assert [float(row["l_2_mm"]) for row in table] == [-40, -50, -60, -70, -80]
    robot = robot_from_dict(read_document(PAIR).content)
    for row in table:
        bound = robot.bound(np.radians([0, 90]), [0, float(row["l_2_mm"]) * 1e-3])
        assert float(row["bound_mm"]) == pytest.approx(bound.position_m * 1e3, rel=1e-9)
        assert float(row["bound_deg"]) == pytest.approx(np.degrees(bound.tangent_rad), rel=1e-9)
        assert row["status"] == bound.frictionless.status.name
    assert (tmp_path / "out" / "sweep.png").read_bytes()[:4] == b"\x89PNG"


def test_axes_may_be_collars_and_keys_in_any_order() -> None:
    one = swept("theta_2=0:120:4", f"{FRICTION}=0:0.4:3")
    other = swept(f"{FRICTION}=0:0.4:3", "theta_2=0:120:4")
    assert one.shape == (4, 3) and other.shape == (3, 4)
    position_m = one.bounds.position_m.reshape(4, 3)
    np.testing.assert_array_equal(position_m, other.bounds.position_m.reshape(3, 4).T)
    assert np.all(position_m[:, 0] < 1e-6) and np.all(np.diff(position_m, axis=1) > 0)  # grows with friction
    robot = robot_from_dict(read_document(PAIR).content, overrides=[f"{FRICTION}=0.2"])
    assert position_m[2, 1] == robot.bound(np.radians([0, 80]), [0, -0.06]).position_m
    with ThreadPoolExecutor(2) as executor:
        axes = one.axes
        again = sweep(read_document(PAIR).content, axes, np.radians([0, 90]), [0, -0.06], executor=executor)
    np.testing.assert_array_equal(again.bounds.position_m, one.bounds.position_m)


def test_heat_map_names_axes_and_units_and_marks_what_is_unstable(tmp_path: Path) -> None:
    content = read_document(THREE).content
    axes = [parse_axis("theta_3=170:190:5", 3), parse_axis("l_3=-120:-90:3", 3)]
    result = sweep(content, axes, [0, 0, 0], [0, -0.017, -0.06])
    assert (result.bounds.status == Status.UNSTABLE).any() and result.usable.any()
    figure = sweep_figure(result)
    ax, bar = figure.axes
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("theta_3 (deg)", "l_3 (mm)")
    assert "(mm)" in bar.get_ylabel()
    assert "unstable" in figure.legends[0].get_texts()[0].get_text()
    assert "UNSTABLE" in sweep_csv(result)
    figure.savefig(tmp_path / "map.png")
    line = sweep_figure(sweep(content, axes[:1], [0, 0, 0], [0, -0.017, -0.12]))
    assert "(mm)" in line.axes[0].get_ylabel() and line.axes[0].patches


def test_units_of_keys() -> None:
    assert parse_axis("tube.2.section.2.curvature_y_per_m=1:2:2", 2).label == "tube.2.section.2.curvature_y_per_m (1/m)"
    assert parse_axis(f"{CLEARANCE}=1:2:2", 2).column == CLEARANCE
    assert parse_axis(f"{FRICTION}=0:1:2", 2).label == FRICTION
    assert parse_axis("theta_2 = 0 : 90 : 3", 2).values.tolist() == [0, 45, 90]


def test_warnings_of_a_sweep_are_a_few_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bound", PAIR, *AT, "--sweep", f"{CLEARANCE}=0.1:0.4:4", "-o", str(tmp_path)]) == 0
    assert 1 <= capsys.readouterr().err.count("\n") <= 2


def test_progress_reaches_the_end_of_every_stage() -> None:
    heard: list[tuple[str, float]] = []
    axes = [parse_axis("theta_2=0:90:7", 2)]
    sweep(read_document(PAIR).content, axes, [0, 0], [0, -0.06], progress=lambda *args: heard.append(args))
    assert heard.count(("check", 1.0)) == heard.count(("bounds", 1.0)) == 1 and heard == sorted(
        heard, key=lambda stage: (stage[0] == "bounds", stage[1])
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["theta_4=0:1:3"], ["theta_4", "no such tube", "1 (outermost) to 3"]),
        (["theta_0=0:1:3"], ["theta_0", "no such tube"]),
        (["theta_3"], ["KEY=FROM:TO:COUNT"]),
        (["theta_3=0:1"], ["KEY=FROM:TO:COUNT"]),
        (["theta_3=0:one:3"], ["0:one:3", "two numbers"]),
        (["theta_3=0:1:2.5"], ["a whole one"]),
        (["theta_3=0:inf:3"], ["from -1e+12 to 1e+12"]),
        (["theta_3=-1e308:1e308:3"], ["from -1e+12 to 1e+12"]),
        (["theta_3=0:1e9:3"], ["theta_b of tube 3"]),
        (["theta_3=0:1:1"], ["COUNT", "at least 2"]),
        (["theta_3=1:1:3"], ["differ"]),
        (["theta_3=0:1:1000001"], ["COUNT", "1,000,000"]),
        (["theta_3=0:1:1001", "theta_2=0:1:1000"], ["1,001,000 points"]),
        (["theta_3=0:1:3", "theta_3=0:1:3"], ["twice", "theta_3"]),
        (["theta_1=0:1:3", "theta_2=0:1:3", "theta_3=0:1:3"], ["one axis or two"]),
        (["contact.1.clearence_mm=0.1:1:3"], ["contact.1.clearence_mm", "did you mean clearance_mm"]),
        (["contact.3.clearance_mm=0.1:1:3"], ["contact.3", "from 1 to 2"]),
        (["contact.1.clearance_mm=0.1:-0.1:3"], ["three_tube.toml", "contact.1.clearance_mm = 0.0 mm", "above 0"]),
        (["contact.1.clearance_mm=0.1:0.2:2", "contact.01.clearance_mm=0.1:0.2:2"], ["same axis twice"]),
        (["name=1:2:2"], ["name = 1.0", "text"]),
        (["l_3=-40:-20:5"], ["l_3 = -30 mm", "17 mm apart"]),
        (["theta_1=0:90:3", "l_3=-40:-140:11"], ["l_3 = -130 mm", "tips in order"]),
        (["tube.1.section.1.length_mm=100:200:11"], ["tube.2", "(at tube.1.section.1.length_mm = 160 mm)"]),
        (["tube.2.collar_length_mm=10:30:5"], ["tube.2.collar_length_mm = 20 mm"]),
    ],
)
def test_refusal_is_one_sentence_and_leaves_nothing(
    arguments: list[str], words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [option for axis in arguments for option in ("--sweep", axis)]
    assert main(["bound", THREE, *THREE_AT, *options, "-o", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert message.startswith("ctrplan: ") and message.count("\n") == 1
    assert all(word in message for word in words), message
    assert not list(tmp_path.rglob("*.*"))


def test_options_that_do_not_go_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bound", PAIR, *AT, "--sweep", "theta_1=0:1:2", "--json", "-o", str(tmp_path / "out")]) == 2
    assert "--json" in capsys.readouterr().err
    assert main(["bound", PAIR, *AT, "-o", str(tmp_path / "out")]) == 2
    assert "--sweep" in capsys.readouterr().err
    (tmp_path / "file").write_text("mine")
    assert main(["bound", PAIR, *AT, "--sweep", "theta_1=0:1:2", "-o", str(tmp_path / "file")]) == 2
    assert "--output" in capsys.readouterr().err and (tmp_path / "file").read_text() == "mine"


def test_bases_that_do_not_nest_are_refused_whatever_is_turned() -> None:
    axes = [parse_axis("theta_2=0:1:2", 2)]
    with pytest.raises(InputError, match="apart"):
        sweep(read_document(PAIR).content, axes, [0, 0], [0, -0.01])
