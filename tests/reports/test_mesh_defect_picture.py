"""The picture of a refused mesh: it shows the place, in red, from outside."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pytest
import tomli_w
import trimesh
from PIL import Image
from places import ROBOTS

from ctrplan.__main__ import main
from ctrplan.anatomy.mesh_repair import MeshDefect
from ctrplan.base.surface import Surface
from ctrplan.reports import plan_picture as mesh_defect_picture
from ctrplan.reports.plan_picture import mesh_defect_png


def pierced(side: float) -> trimesh.Trimesh:
    """A ball, in mm, with a hole at +x or -x."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=20.0)
    away = np.linalg.norm(ball.triangles_center - (20 * side, 0, 0), axis=1)
    return trimesh.Trimesh(ball.vertices, ball.faces[away > 6], process=False)


@pytest.fixture(autouse=True)
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh_defect_picture, "SAMPLES", 1)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_open_edges_are_seen_whichever_way_they_face(side: float) -> None:
    mesh = pierced(side)
    surface = Surface(np.asarray(mesh.vertices) * 1e-3, np.asarray(mesh.faces))
    defect = MeshDefect(Path("a.stl"), surface, np.array([0.02 * side, 0, 0]))
    seen = np.asarray(Image.open(io.BytesIO(mesh_defect_png(defect))))
    red = (seen[..., 0] > 120) & (seen[..., 1] < 80) & (seen[..., 2] < 80)
    rows, columns = np.nonzero(red)
    height, width = red.shape
    assert len(rows) > 1000
    assert abs(rows.mean() - height / 2) < 0.1 * height and abs(columns.mean() - width / 2) < 0.1 * width


def test_a_command_names_the_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pierced(1.0).export(tmp_path / "ball.stl")
    anatomy = {"kind": "mesh", "file": "ball.stl", "unit": "mm", "repair": "off"}
    joints = {"rotate outer": 0, "rotate inner": 0, "translate inner": -30}
    content = {"robot": str(ROBOTS / "table_5_pair.toml"), "start": joints, "goal": {"joints": joints}}
    (tmp_path / "a.toml").write_text(tomli_w.dumps({**content, "anatomy": [anatomy]}))
    assert main(["plan", str(tmp_path / "a.toml"), "--allow-outside", "-o", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert re.search(r"is not closed: has \d+ open edges, one at \(", told)
    named = re.search(r"a picture of the place: (.*\.png)", told)
    assert named is not None
    assert Image.open(named[1]).size == (900, 700)
    Path(named[1]).unlink()
