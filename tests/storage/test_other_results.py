"""A folder may hold results of several commands: none takes another's files, and each keeps its sums."""

from __future__ import annotations

from pathlib import Path

import pytest
from checksums import unmatched
from places import ROBOTS, SCENARIOS
from small_scenarios import NEAR

from ctrplan.__main__ import main
from ctrplan.errors import CtrplanError
from ctrplan.files.plan_inputs import changed_files
from ctrplan.storage.output_folder import write_atomically, written_together

PAIR = str(ROBOTS / "table_5_pair.toml")
PLAN = ["plan", str(SCENARIOS / "pair_free.toml"), "--set", "planner.time_s=0.2", "--set", NEAR, "--quiet"]
STUDY = """robot = "pair.toml"
task = {kind = "bound", theta_deg = [0, 90], l_mm = [0, -30]}
[[vary]]
key = "theta_2"
values = [0, 90]
"""


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("planned") / "out"
    assert main([*PLAN, "-o", str(folder)]) == 0
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_what_stands_beside_other_results_keeps_their_sums(planned: Path) -> None:
    command = ["simulate", PAIR, str(planned / "trajectory.csv"), "-o", str(planned)]
    assert main(command) == 0
    assert main(command) == 0  # and again
    assert unmatched(planned) == ()
    page = planned / "report.html"
    kept = page.read_bytes()
    page.write_bytes(kept + b" ")
    assert set(changed_files(planned)) == {"report.html"}
    page.write_bytes(kept)


def test_no_command_takes_a_file_of_another(planned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "study.toml").write_text(STUDY)
    (tmp_path / "pair.toml").write_text(Path(PAIR).read_text())
    before = contents(planned)
    path = str(planned / "poses.csv")
    assert main(["simulate", PAIR, str(planned / "trajectory.csv"), "-o", str(tmp_path / "s")]) == 0
    for command in (
        ["study", str(tmp_path / "study.toml"), "--quiet"],
        ["calibrate", PAIR, path],
        ["diagnose", PAIR, path],
    ):
        capsys.readouterr()
        assert main([*command, "-o", str(planned)]) == 2
        assert "holds report.html without" in capsys.readouterr().err
    assert contents(planned) == before
    other = tmp_path / "studied"
    assert main(["study", str(tmp_path / "study.toml"), "--quiet", "-o", str(other)]) == 0
    before = contents(other)
    for more in ([], ["--no-report"]):
        assert main([*PLAN, *more, "-o", str(other)]) == 2
    assert contents(other) == before
    assert main(["study", str(tmp_path / "study.toml"), "--quiet", "-o", str(other)]) == 0  # its own


def test_a_plan_in_the_place_of_another_keeps_none_of_its_sums(planned: Path) -> None:
    assert main([*PLAN, "--no-report", "-o", str(planned)]) == 0
    assert unmatched(planned) == () and not (planned / "report.html").exists()


def test_what_could_not_be_written_leaves_no_folder_and_is_called_by_its_name(tmp_path: Path) -> None:
    for name in ("new", "there"):
        (tmp_path / "there").mkdir(exist_ok=True)
        with (
            pytest.raises(CtrplanError, match=f"{name}/none/a.txt: could not be written, nothing was changed: No such"),
            written_together(tmp_path / name, ["a.txt"]) as made,
        ):
            write_atomically(made / "none" / "a.txt", "")
    assert [path.name for path in tmp_path.iterdir()] == ["there"] and not list((tmp_path / "there").iterdir())
