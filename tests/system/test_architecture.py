"""The page about the architecture lists the packages of today, and its picture can be drawn from their imports."""

from __future__ import annotations

import importlib
import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest
from places import ROOT

PAGE = ROOT / "docs" / "architecture.md"


@pytest.fixture(scope="module")
def tool() -> Iterator[ModuleType]:
    """The script, which reads the package once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "tools"))
        made = importlib.import_module("draw_architecture")
        patch.setattr(made, "parts", cache(made.parts))
        yield made


def test_page_and_picture_are_those_that_the_script_makes(
    tool: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The table to the letter; in the picture every package, whose sizes change with every edit."""
    page, image = tmp_path / "architecture.md", tmp_path / "architecture.svg"
    shutil.copy(PAGE, page)
    monkeypatch.setattr("sys.argv", ["draw_architecture.py", "--page", str(page), "--image", str(image)])
    tool.main()
    assert page.read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8"), "run tools/draw_architecture.py"
    shipped = (ROOT / "docs" / "images" / "architecture.svg").read_text(encoding="utf-8")
    for name in tool.parts():
        assert all(f">{name}</text>" in picture for picture in (image.read_text(encoding="utf-8"), shipped)), name


def test_every_package_is_in_the_picture(tool: ModuleType) -> None:
    """Each says what it is, imports lead downwards, and there is an arrow or a chain of arrows for each import."""
    found = {entry.stem for entry in (ROOT / "ctrplan").iterdir() if (entry / "__init__.py").exists()}
    parts = tool.parts()
    assert found <= set(parts)
    arrows = tool.arrows(parts)
    for name, entry in parts.items():
        assert entry.sentence, name
        assert all(parts[target].layer > entry.layer for target in entry.imports), name
        assert entry.imports <= reached(name, arrows)
    assert len(arrows) < sum(len(entry.imports) for entry in parts.values()) / 2


def reached(name: str, arrows: list[tuple[str, str]]) -> set[str]:
    """What a chain of arrows leads to."""
    below = {target for start, target in arrows if start == name}
    return below.union(*(reached(target, arrows) for target in below))


def test_a_file_is_one_concept() -> None:
    """What grows beyond 450 lines is two, and what is of one file's use lives in it: the tree has so many files."""
    files = {path: path.read_text(encoding="utf-8").count("\n") for path in (ROOT / "ctrplan").rglob("*.py")}
    assert len(files) <= 320 and max(files.values()) <= 450, max(files, key=lambda path: files[path])
