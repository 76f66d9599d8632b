"""What docs/extending.md shows: files by their names, commands by the section that they stand in."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from places import ROOT

PAGE = ROOT / "docs" / "extending.md"
TEXT = PAGE.read_text(encoding="utf-8")
PLACES = {  # section -> file of the extension
    "An effect": "effects/drive/guide_twist.py",
    "A planner": "planning/search/planners/rrt.py",
    "An obstacle": "anatomy/shapes/turned_box.py",
    "An output format": "files/trajectory_formats/json_lines.py",
}


def section(heading: str) -> str:
    """The page below a heading, up to the next one."""
    return re.split(r"^## ", TEXT.partition(f"\n## {heading}\n")[2], flags=re.MULTILINE)[0]


def block(text: str, language: str, name: str = "") -> str:
    """The block of a language that follows `name` in quotes: all of it, as it stands."""
    start = text.index(f"`{name}`") if name else 0
    found = re.search(rf"^```{language}\n(.*?)^```$", text[start:], re.DOTALL | re.MULTILINE)
    assert found
    return found[1]


def source(heading: str) -> str:
    """The file that a section shows."""
    return block(section(heading), "python", f"EXTENSIONS/{PLACES[heading]}")


def write_inputs(folder: Path) -> None:
    """The robot and the scenarios of the page."""
    for name in ("my_pair.toml", "first.toml", "boxed.toml"):
        (folder / name).write_text(block(TEXT, "toml", name))


def write_extension(folder: Path, place: str, text: str) -> Path:
    """One file of an extension below `folder`, in EXTENSIONS."""
    file = folder / "EXTENSIONS" / place
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    return file


def run(folder: Path, *lines: str) -> subprocess.CompletedProcess[str]:
    """Lines of a shell in `folder`, with the interpreter's own `ctrplan`, after the page's export."""
    export = block(section("A folder of your own"), "sh")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "CTRPLAN_CACHE_DIR": str(folder / "cache")}
    script = "\n".join([export, *lines])
    return subprocess.run(
        ["bash", "-e", "-c", script], cwd=folder, env=environment, capture_output=True, text=True, timeout=120
    )
