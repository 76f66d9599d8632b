"""What can be wrong with a planning problem or the place for its results: a sentence, an exit code, no debris."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from places import SCENARIOS

from ctrplan.__main__ import main
from ctrplan.files.scenario_file import scenario_from_dict
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.room import start_trouble
from ctrplan.plans.plan import Plan
from ctrplan.reports.plan_page import plan_report_html
from ctrplan.reports.plan_picture import plan_figure
from ctrplan.reports.plan_scene import plan_scene


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    code = main(list(arguments))
    sentence = capsys.readouterr().err.strip().splitlines()
    lines = [line for line in sentence if "warning" not in line]
    assert len(lines) == 1 and lines[0].startswith("ctrplan: ") and lines[0].endswith((".", "?"))
    return code, lines[0]


@pytest.mark.parametrize(
    ("scenario", "change", "code", "words"),
    [
        ("ribs", "goal.tip_mm=[300, 0, 100]", 1, ["goal.tip_mm = [300.0, 0.0, 100.0]", "out of reach", "mm away at ["]),
        ("ribs", "goal.tip_mm=[0, 10, 75]", 1, ["lies 3.9", "mm inside anatomy.1 (ribs.stl)", "to be avoided"]),
        ("ribs", "goal.tip_mm=[0, 14.4, 75]", 1, ["from the surface of anatomy.1", "nearer than its margin_mm = 1"]),
        ("vessel", "goal.tip_mm=[51, 40, 168]", 1, ["mm outside anatomy.1 (vessel.stl)", "stays within"]),
        ("vessel", "base.position_mm=[60, 0, 0]", 1, ["start", "leaves anatomy.1 (vessel.stl) by", "mm at ["]),
        ("vessel", "anatomy.1.margin_mm=13", 2, ["margin_mm = [13]", "leave no room for the innermost tube"]),
        ("ribs", "anatomy.1.margin_mm=74", 1, ["start", "less than margin_mm = 74", "anatomy.1"]),
        ("ribs", "base.position_mm=[0, 10, -10]", 1, ["start", "cuts", "into anatomy.1 (ribs.stl) at ["]),
        ("ribs", 'anatomy.1.unit="m"', 2, ["anatomy.1.file", "m across", "(millimetres?)"]),
        ("ribs", "margins.max_strain=0.001", 1, ["start", "strain", "above 0.1 %"]),
        (
            "ribs",
            'start={"rotate outer"=0, "rotate middle"=0, "turn inner"=0, "translate inner"=0}',
            2,
            ["start.turn inner"],
        ),
        (
            "ribs",
            'start={"rotate outer"=0, "rotate middle"=0, "rotate inner"=0}',
            2,
            ["start.translate inner", "is missing"],
        ),
        (
            "ribs",
            'robot="robots/table_5_pair.toml"',
            2,
            ["start.rotate middle", "unknown joint, the robot has rotate outer"],
        ),
    ],
)
def test_problem_without_an_answer_says_why(
    scenario: str, change: str, code: int, words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    found, sentence = refusal(
        capsys, "plan", str(SCENARIOS / f"{scenario}.toml"), "-o", str(out), "--time", "0.5", "--set", change
    )
    assert all(word in sentence for word in words), sentence
    assert found == code and not out.exists()


def test_a_body_in_two_lumens_keeps_the_margin_of_one_of_them_at_each_point() -> None:
    """The sentence about an invalid start names the cause that makes it invalid in the model."""
    lumen = {"kind": "capsule", "role": "inside", "radius_mm": 20, "margin_mm": 1}
    anatomy = [
        {**lumen, "from_mm": [0, 0, -10], "to_mm": [10, 0, 110]},
        {**lumen, "from_mm": [10, 0, 90], "to_mm": [65, 0, 192]},
        {"kind": "sphere", "center_mm": [9.8, 8, 99.4], "radius_mm": 4, "margin_mm": 3.5},
    ]
    names = ("rotate outer", "rotate inner", "translate inner")
    content = {"robot": "robots/table_5_pair.toml", "start": dict.fromkeys(names, 0), "goal": {"tip_mm": [0, 0, 150]}}
    free, tight = (
        MotionChecker(scenario_from_dict({**content, "anatomy": parts}, file=str(SCENARIOS / "case.toml")))
        for parts in (anatomy[:2], anatomy)
    )
    assert free.state(free.scenario.start).valid and start_trouble(free) == ""
    assert not tight.state(tight.scenario.start).valid
    assert "from anatomy.3 (sphere)" in start_trouble(tight)


@pytest.mark.parametrize(
    ("said", "key"), [(["--time", "0.01"], "time_s (--time)"), (["--set", "planner.time_s=0.01"], "planner.time_s")]
)
def test_a_search_that_ran_out_of_time_names_what_said_it(
    said: list[str], key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, sentence = refusal(capsys, "plan", str(SCENARIOS / "snap.toml"), *said, "-o", str(tmp_path / "out"))
    assert code == 1 and f"{key} = 0.01 s: no valid path" in sentence and not (tmp_path / "out").exists()


def test_heart_of_80_metres_asks_for_millimetres(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trimesh.creation.icosphere(radius=40.0).export(tmp_path / "heart.stl")
    (tmp_path / "robots").mkdir()
    for file in ("ribs.toml", "robots/three_tube.toml"):
        text = (
            (SCENARIOS / file).read_text().replace("meshes/ribs.stl", "heart.stl").replace('unit = "mm"', 'unit = "m"')
        )
        (tmp_path / file).write_text(text)
    code, sentence = refusal(capsys, "plan", str(tmp_path / "ribs.toml"), "-o", str(tmp_path / "out"))
    assert code == 2 and "is 80 m across" in sentence and "(millimetres or centimetres?)" in sentence


@pytest.fixture(scope="module")
def drawn(plan: Plan) -> Iterator[None]:
    """What is written of the plan is drawn once for all faults; it is written anew for each."""
    scene = plan_scene(plan)
    figure, page = plan_figure(scene), plan_report_html(scene)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ctrplan.reports.plan_page.plan_scene", lambda _: scene)
        patch.setattr("ctrplan.reports.plan_picture.plan_figure", lambda _: figure)
        patch.setattr("ctrplan.reports.plan_page.plan_report_html", lambda _: page)
        yield


@pytest.mark.usefixtures("drawn")
@pytest.mark.parametrize("fault", [errno.ENOSPC, errno.EACCES, errno.EIO])
@pytest.mark.parametrize("at", [1, 3, 5, 6])
def test_trouble_while_writing_leaves_nothing_behind(
    fault: int, at: int, plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The disk fills up, or the folder is taken away, while the file number `at` is written; the sixth are the sums."""
    out, real, count = tmp_path / "out", os.fsync, 0
    out.mkdir()
    (out / "plan.json").write_text("an older plan")

    def fsync(descriptor: int) -> None:
        nonlocal count
        count += 1
        if count == at:
            raise OSError(fault, os.strerror(fault))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr("ctrplan.planning.plan", lambda *_, **__: plan)
    code, sentence = refusal(capsys, "plan", str(SCENARIOS / "pair_free.toml"), "-o", str(out))
    assert code == 1 and os.strerror(fault) in sentence and "Traceback" not in sentence
    assert [path.name for path in out.iterdir()] == ["plan.json"]
    assert (out / "plan.json").read_text() == "an older plan"


def test_folder_nobody_may_write_into_is_refused_before_planning(capsys: pytest.CaptureFixture[str]) -> None:
    code, sentence = refusal(capsys, "plan", str(SCENARIOS / "pair_free.toml"), "-o", "/proc/out")  # root neither
    assert code == 2 and "is not writable" in sentence


def test_nearest_point_is_where_the_sentence_says() -> None:
    """Beyond the longest robot straight ahead: nothing is nearer than what is reported, by brute force."""
    from ctrplan.files.scenario_file import load_robot_or_scenario
    from ctrplan.planning.reach import reach
    from ctrplan.scenario.tip_solver import TipTarget

    scenario = load_robot_or_scenario(SCENARIOS / "robots" / "three_tube.toml")
    checker, target = MotionChecker(scenario), np.array([0.06, 0.02, 0.27])
    found = reach(checker, TipTarget(target), 1e-3, np.random.default_rng(0))
    q = checker.space.sample(np.random.default_rng(1), 4000)
    tips, _, _ = checker.mechanics.tips(*scenario.robot.drive.collars(q))
    nearest = np.linalg.norm(tips - target, axis=1).min()
    assert not found.configurations and found.nearest.tip_error_m <= nearest + 0.5e-3
    assert np.linalg.norm(found.nearest.tip_m - target) == pytest.approx(found.nearest.tip_error_m)
