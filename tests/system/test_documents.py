"""The documents: links lead somewhere, commands are understood, code and files shown there work."""

from __future__ import annotations

import importlib
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

from ctrplan.certificate.friction_states import CERTIFICATE_MESH_M, SEARCH_MESH_M
from ctrplan.commands.program import parser
from ctrplan.files.robot_file import load_robot
from ctrplan.files.scenario_file import load_scenario
from ctrplan.planning import plan

PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").rglob("*.md")])
SUMMARY = "<!-- summary -->\n", "<!-- end of summary -->\n"
TREES = ("benchmarks", "ctrplan", "docs", "examples", "model", "scenarios", "tests", "tools")


def blocks(page: Path, language: str) -> list[str]:
    """Fenced blocks of a language, "" for those without one."""
    return re.findall(
        rf"^ *```{language}(?: title=[^\n]*)?\n(.*?)^ *```$", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )


def name_of(page: Path) -> str:
    """Path of a page in the tree."""
    return page.relative_to(ROOT).as_posix()


def between(page: Path, begin: str, end: str) -> str:
    """What stands between two markers of a page."""
    return page.read_text(encoding="utf-8").split(begin)[1].split(end)[0]


def anchors(page: Path) -> set[str]:
    """What a link into the page may end with, as GitHub makes it from headings."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def commands() -> list[str]:
    """Every line of a block that calls ctrplan, continued lines joined."""
    lines = [
        line.strip()
        for page in PAGES
        for block in blocks(page, "") + blocks(page, "sh")
        for line in block.replace("\\\n", "").splitlines()
    ]
    return [line for line in lines if line.startswith("ctrplan ")]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if re.match(r"https?://", target):
            continue
        name, _, anchor = target.partition("#")
        file = page.parent / name if name else page
        assert file.exists(), target
        assert not anchor or anchor in anchors(file), target


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_files_of_the_tree_that_are_named_exist(page: Path) -> None:
    named = re.findall(rf"(?<![\w/.])((?:{'|'.join(TREES)})/[\w./-]*\w)", page.read_text(encoding="utf-8"))
    missing = [name for name in named if not (ROOT / name).exists()]
    assert not missing


def test_every_page_is_in_the_navigation_of_the_site() -> None:
    named = re.findall(r"[\w/]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")}
    assert sorted(named) == sorted([*pages, "index.md"])  # the first page is the README


def test_pages_tell_guides_from_logs() -> None:
    """What was measured of the planner, of performance and of the diagnosis has a page of its own."""
    for name in ("planning", "performance", "diagnosis"):
        reference = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
        assert f"](log/{name}.md" in reference
        assert f"](../{name}.md" in (ROOT / "docs" / "log" / f"{name}.md").read_text(encoding="utf-8")


def test_numbers_of_the_readme_are_those_of_the_results() -> None:
    readme, results = (between(page, *SUMMARY) for page in (ROOT / "README.md", ROOT / "docs" / "results.md"))
    assert readme == results
    assert len(readme.strip().splitlines()) <= 2 + 8


def test_bound_in_the_figure_of_the_readme(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is the largest distance of the corners that the figure's program draws."""
    for folder in ("benchmarks", "benchmarks/mechanics"):
        monkeypatch.syspath_prepend(str(ROOT / folder))
    figure = importlib.import_module("corner_shapes")
    bound = load_robot(figure.ROBOT).bound(figure.THETA_RAD, figure.L_M, accuracy="certificate")
    distances = [np.linalg.norm(corner.tip_m - bound.frictionless.tip_m) for corner in bound.corners]
    (shown,) = re.findall(r"the bound of ([\d.]+) mm", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert max(distances) * 1e3 == pytest.approx(float(shown), abs=0.05)


def test_largest_mesh_error_is_below_what_the_certificate_takes_off() -> None:
    """The page of results has it, and the allowance in the code is larger."""
    page = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    rows = [row for row in page.splitlines() if "at most" in row and row.startswith("| ")]
    allowances = {"search": CERTIFICATE_MESH_M + SEARCH_MESH_M, "certificate": CERTIFICATE_MESH_M}
    for mesh, allowance_m in allowances.items():
        found = [re.findall(r"at most ([\d.]+) mm", row) for row in rows if row.startswith(f"| {mesh}")]
        assert found and max(float(x) for numbers in found for x in numbers) < allowance_m * 1e3


def test_readme_shows_commands() -> None:
    assert {line.split()[1] for line in commands()} >= {"plan", "view", "ik", "bound", "simulate"}


@pytest.mark.parametrize("command", commands())
def test_commands_are_understood(command: str) -> None:
    arguments = shlex.split(command, comments=True)[1:]
    parsed = parser().parse_args(arguments)
    for name in arguments:
        if name.startswith("scenarios/"):
            assert (ROOT / name).exists()
    assert callable(parsed.run)


def test_python_in_the_readme_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a smaller scenario and a shorter search, in order to be quick."""
    monkeypatch.chdir(ROOT)
    (code,) = blocks(ROOT / "README.md", "python")
    assert "scenarios/ribs.toml" in code
    quick = code.replace("ribs", "pair_free").replace("seed=0)", "seed=0, time_s=0.3)")
    assert "time_s" in quick
    exec(compile(quick, "README.md", "exec"), {"__name__": "readme"})


@pytest.mark.parametrize("number", range(3))
def test_python_on_the_page_about_extending_runs(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    found = [code for code in blocks(ROOT / "docs" / "extending.md", "python") if "@register" not in code]
    assert len(found) == 3  # files of an extension: tests/extensions
    exec(compile(found[number], "extending.md", "exec"), {"__name__": "extending"})


def test_robot_and_scenario_on_the_page_about_extending_are_planned(tmp_path: Path) -> None:
    robot, scenario, _ = blocks(ROOT / "docs" / "extending.md", "toml")
    (tmp_path / "my_pair.toml").write_text(robot)
    (tmp_path / "first.toml").write_text(scenario)
    assert load_robot(tmp_path / "my_pair.toml").n == 2
    found = plan(load_scenario(tmp_path / "first.toml", ["planner.time_s=0.3"]))
    assert found.certificate.valid


def test_robot_and_scenario_files_as_described_are_read(tmp_path: Path) -> None:
    """Every key that files.md shows; the scenario with a start for each joint of its robot."""
    robot, scenario = blocks(ROOT / "docs" / "files.md", "toml")
    (tmp_path / "pair.toml").write_text(robot)
    assert load_robot(tmp_path / "pair.toml").n == 2
    names = load_scenario(ROOT / "scenarios" / "ribs.toml").robot.drive.names
    starts = "\n".join(f'"{name}" = {-80 if name.startswith("translate") else 0}' for name in names)
    shutil.copytree(ROOT / "scenarios", tmp_path / "scenarios")
    described = tmp_path / "scenarios" / "described.toml"
    scenario = scenario.replace('"rotate inner" = 0\n', starts + "\n")
    described.write_text(
        scenario.replace("direction = [0, 0, 1]", "direction_tolerance_deg = 5\ndirection = [0, 0, 1]")
    )
    assert load_scenario(described).goal.direction is not None
