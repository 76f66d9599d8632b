"""Pages of calibrate, ik and field: they stand alone, say what the command says, and fit a phone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import tomli_w
from browser import Browser, chromium
from measured_data import measured, pair_robot, waypoints, write_csv
from packed_page import library
from places import SCENARIOS

from ctrplan.__main__ import main

ROBOT = pair_robot()
PAIR = str(SCENARIOS / "robots" / "table_1_pair.toml")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of both commands, a folder each."""
    folder = tmp_path_factory.mktemp("pages")
    (folder / "robot.toml").write_text(tomli_w.dumps(dict(ROBOT.content)))
    write_csv(folder / "data.csv", measured(ROBOT, waypoints(ROBOT, 12)))
    wanted = ["--parameters", "tube.2.poisson_ratio"]
    data = [str(folder / "robot.toml"), str(folder / "data.csv")]
    assert main(["calibrate", *data, "-o", str(folder / "calibrate"), *wanted]) == 0
    point = ["--tip-mm", "51", "2", "168", "--tolerance-mm", "1", "--starts", "60"]
    assert main(["ik", str(SCENARIOS / "vessel.toml"), *point, "-o", str(folder / "ik"), "--json"]) == 0
    return folder


PAGES = {"calibrate": "report.html", "ik": "ik.html"}


@pytest.mark.parametrize("command", PAGES)
def test_page_stands_alone(folder: Path, command: str) -> None:
    content = (folder / command / PAGES[command]).read_text()
    assert "* plotly.js v" in library(content) and "default-src 'none'" in content
    assert "What the words mean" in content and "<abbr title=" in content and "SHA-256 of the robot" in content
    assert PAGES[command] in (folder / command / "SHA256SUMS").read_text()


def test_calibration_page_says_what_the_file_says(folder: Path) -> None:
    content, found = (folder / "calibrate" / "report.html").read_text(), folder / "calibrate" / "calibration.json"
    held_out = json.loads(found.read_text())["held_out"]
    assert f"{held_out['rms_m'] * 1e3:.2f} mm" in content and "tube.2.poisson_ratio" in content


def test_nothing_is_written_where_the_point_is_out_of_reach(tmp_path: Path) -> None:
    assert main(["ik", PAIR, "--tip-mm", "0", "0", "5000", "--starts", "20", "-o", str(tmp_path / "out")]) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(chromium() is None, reason="no Chromium on this machine")
@pytest.mark.parametrize("command", PAGES)
def test_page_fits_a_phone(folder: Path, command: str, tmp_path: Path) -> None:
    with Browser(tmp_path / "profile") as browser:
        browser.send("Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=1, mobile=True)
        browser.open((folder / command / PAGES[command]).as_uri())
        browser.wait_for("document.readyState === 'complete' && document.querySelector('.plotly .main-svg')")
        assert browser.run("document.documentElement.scrollWidth") == 390
        assert browser.complaints() == []
