"""The gallery is built from the tree: a part of it, with pictures, numbers and commands, and nothing made twice."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from browser import Browser, chromium
from places import ROOT
from small_scenarios import NEAR

from ctrplan.__main__ import main
from ctrplan.diagnosis import CATALOGUE

FEW = ("joint_scale", "backlash")
QUICK = {
    "plan": ["--set", "planner.time_s=0.2", "--set", NEAR],
    "diagnose": [f"--without={name}" for name in CATALOGUE if name not in FEW],
}


def gallery(folder: Path, *names: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "tools" / "gallery.py"), "-o", str(folder), "--only", *names]
    return subprocess.run(command, capture_output=True, text=True, timeout=600)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan of a short search and way, and a diagnosis of few poses and effects."""
    made = tmp_path_factory.mktemp("gallery")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "tools"))
        tool: Any = importlib.import_module("gallery")
        program = tool.program

        def quick(command: str, *arguments: str, cwd: Path = ROOT) -> None:
            if command == "render":  # a process of its own, as all are where nobody waits for them here
                program(command, *arguments, cwd=cwd)
                return
            with pytest.MonkeyPatch.context() as here:
                here.chdir(cwd)
                assert main([command, *arguments, *QUICK.get(command, [])]) in (0, 3)

        patch.setattr(tool, "program", quick)
        patch.setattr(tool, "CONFIGURATIONS", 16)
        patch.setattr("sys.argv", ["gallery.py", "-o", str(made), "--only", "pair_free", "joint_scale"])
        tool.main()
    return made


def test_cards_have_pictures_numbers_and_commands(folder: Path) -> None:
    page = (folder / "index.html").read_text(encoding="utf-8")
    assert "ctrplan plan scenarios/pair_free.toml" in page and "worst case at the goal" in page
    assert "ctrplan diagnose robot.toml" in page and "named: joint_scale" in page
    for place in ("plans/pair_free/report.html", "diagnoses/joint_scale/diagnosis/report.html"):
        assert f'href="{place}"' in page and (folder / place).is_file()
    assert (folder / "pictures" / "pair_free.png").stat().st_size > 5000


def test_what_is_there_is_not_made_again(folder: Path) -> None:
    plan = folder / "plans" / "pair_free" / "plan.json"
    before = plan.stat().st_mtime_ns
    assert gallery(folder, "pair_free").returncode == 0 and plan.stat().st_mtime_ns == before
    wrong = gallery(folder, "pair_fre")
    assert wrong.returncode == 1 and "nothing is called pair_fre" in wrong.stderr


@pytest.mark.skipif(chromium() is None, reason="no Chromium on this machine")
def test_the_page_fits_a_phone_and_loads_its_pictures(folder: Path, tmp_path: Path) -> None:
    with Browser(tmp_path / "profile") as browser:
        browser.send("Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=1, mobile=True)
        browser.open((folder / "index.html").as_uri())
        browser.wait_for("document.readyState === 'complete'")
        browser.run("document.querySelectorAll('img').forEach((image) => { image.loading = 'eager'; })")
        browser.wait_for("Array.from(document.images).every((image) => image.naturalWidth > 100)")
        assert browser.run("document.documentElement.scrollWidth") == 390 and browser.complaints() == []
