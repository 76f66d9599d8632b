"""Structures that move, and bodies at the robot's base: the worst of all phases counts, and nothing is swallowed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from phantoms import distance_mm, part_of
from scipy.spatial.transform import Rotation

import ctrplan
from ctrplan.anatomy.fixture import WITHIN_M, Fixture
from ctrplan.anatomy.parts import AnatomyPart, Phases, exact_clearance
from ctrplan.anatomy.shapes.capsule import Capsule
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.anatomy.shapes.sphere import Sphere
from ctrplan.errors import InputError, NoAnswerError

SHIFTS = (0.0, 3.0, 5.0)


def written(folder: Path) -> list[str]:
    for shift in SHIFTS:
        trimesh.creation.box((10, 8, 6)).apply_translation((shift, 0, 0)).export(folder / f"at{shift:g}.stl")
    return [f"at{shift:g}.stl" for shift in SHIFTS]


def moving(folder: Path, **keys: Any) -> AnatomyPart:
    entry = {"kind": "mesh", "unit": "mm", "files": written(folder), "motion_margin_mm": 1.5} | keys
    return part_of(folder, None, **{key: value for key, value in entry.items() if value is not None})


def test_what_moves_is_avoided_in_every_phase_and_stayed_inside_of_in_all(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(-9, 14, (500, 3)) * (1, 0.6, 0.6)
    still = [distance_mm(part_of(tmp_path, None, kind="mesh", file=f, unit="mm"), points) for f in written(tmp_path)]
    avoided, lumen = moving(tmp_path, margin_mm=0.5), moving(tmp_path, role="inside")
    np.testing.assert_array_equal(distance_mm(avoided, points), np.min(still, axis=0))
    np.testing.assert_array_equal(distance_mm(lumen, points), np.max(still, axis=0))
    assert avoided.margin_m == pytest.approx(2e-3) and lumen.margin_m == pytest.approx(1.5e-3)
    assert not moving(tmp_path, motion_margin_mm=2.5).shape.notes
    note, _ = moving(tmp_path, motion_margin_mm=1.0).shape.notes
    assert "moves up to 3 mm from phase to phase, halfway 1.5 mm away from both" in note


def test_the_way_between_phases_is_that_of_the_vertex_that_moves_farthest(tmp_path: Path) -> None:
    """A bump of a few vertices among 10,000: a sample of them said less than half of it."""
    still = trimesh.creation.icosphere(subdivisions=5, radius=30)
    bumped, top = still.copy(), still.vertices[5001]
    near = np.linalg.norm(still.vertices - top, axis=1) < 1.5
    bumped.vertices[near] *= 1.2
    still.export(tmp_path / "still.stl")
    bumped.export(tmp_path / "bumped.stl")
    part = moving(tmp_path, files=["still.stl", "bumped.stl"])
    assert isinstance(part.shape, Phases)
    assert part.shape.apart_m() == pytest.approx(np.abs(part.shape.shapes[0].distance(bumped.vertices / 1e3)).max())
    assert part.shape.apart_m() == pytest.approx(6e-3, rel=0.01)


def test_a_beat_that_goes_on_from_its_last_phase_is_told_and_can_be_said(tmp_path: Path) -> None:
    files = written(tmp_path)
    (note,) = moving(tmp_path, files=files).shape.notes  # 5 mm back, of which 1.5 mm are kept
    assert note.endswith("as in a beat, name the first again as the last") and "5 mm away" in note
    (note,) = moving(tmp_path, files=[*files, files[0]]).shape.notes
    assert "moves up to 5 mm from phase to phase" in note
    assert not moving(tmp_path, files=files, motion_margin_mm=2.5).shape.notes


@pytest.mark.parametrize(
    ("keys", "phrase"),
    [
        ({"motion_margin_mm": None}, "anatomy.1.motion_margin_mm: is missing"),
        ({"files": ["at0.stl"]}, "anatomy.1.files = ['at0.stl']: must be a list of 2 to 50 files"),
        ({"file": "at0.stl"}, "anatomy.1.file = 'at0.stl': and files exclude each other"),
        ({"files": ["at0.stl", "gone.stl"]}, "anatomy.1.file = 'gone.stl': is not a file that exists"),
        ({"motion_margin_mm": "1"}, "anatomy.1.motion_margin_mm = '1': must be a number"),
        ({"files": None, "file": "at0.stl"}, "anatomy.1.motion_margin_mm = 1.5 mm: goes with files"),
    ],
)
def test_what_is_no_motion_is_refused(keys: dict[str, Any], phrase: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        moving(tmp_path, **keys)
    assert phrase in str(caught.value)


def box(size_m: Any, centre_m: Any) -> Mesh:
    mesh = trimesh.creation.box(size_m).apply_translation(centre_m)
    return Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces))


@pytest.mark.parametrize("shape", ["capsule", "sphere", "mesh"])
def test_the_clearance_of_a_fixture_is_that_of_its_surface(shape: str) -> None:
    """Against points all over it; never more than there is, and hardly less."""
    bodies = {
        "capsule": Capsule(np.array([0, 0, -0.08]), np.array([0, 0.01, -0.01]), 0.006),
        "sphere": Sphere(np.array([0, 0.01, -0.03]), 0.012),
        "mesh": box((0.03, 0.05, 0.02), (0, 0, -0.03)),
    }
    R, position = Rotation.from_euler("xyz", [30, 50, -20], degrees=True).as_matrix(), np.array([0.01, -0.02, 0.03])
    parts = [
        AnatomyPart(Sphere(np.array([0.05, 0.04, 0.0]), 0.02), "avoid", 1e-3),
        AnatomyPart(box((0.02,) * 3, (0, 0.1, 0))),
    ]
    found, place = Fixture("a", bodies[shape], 0.5e-3).clearance(parts, position, R)
    surface = bodies[shape].surface()
    rng = np.random.default_rng(0)
    corners, shares = (
        surface.vertices_m[surface.faces],
        rng.dirichlet((1, 1, 1), (len(surface.faces), 4000 // len(surface.faces) + 40)),
    )
    points = np.einsum("fsk,fkx->fsx", shares, corners).reshape(-1, 3) @ R.T + position
    sampled = exact_clearance(parts, points).min() - 0.5e-3
    assert found <= sampled + 1e-9 and found >= sampled - WITHIN_M - 0.7e-3
    assert exact_clearance(parts, place[None])[0] < 0.1


def test_a_structure_within_a_fixture_and_a_lumen_around_one_are_seen() -> None:
    unit = Fixture("drive", box((0.1, 0.1, 0.1), (0, 0, -0.05)))
    swallowed = AnatomyPart(Sphere(np.array([0, 0, -0.05]), 0.01))
    assert unit.clearance([swallowed], np.zeros(3), np.eye(3))[0] < -0.03
    lumen = AnatomyPart(Capsule(np.array([0, 0, -0.1]), np.array([0, 0, 0.1]), 0.02), "inside")
    assert unit.clearance([lumen], np.zeros(3), np.eye(3))[0] == np.inf
    sheath = Capsule(np.array([0, 0, -0.05]), np.array([0, 0, 0]), 0.015)
    assert Fixture("sheath", sheath, 0.0, True).clearance([lumen], np.zeros(3), np.eye(3))[0] == pytest.approx(
        0.005, abs=6e-5
    )


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("a", Sphere(np.zeros(3), 0.1), np.nan), "margin_m = nan m: must be a number"),
        (("a", Sphere(np.zeros(3), 0.1), -1e-3), "margin_m = -0.001 m: must be a number"),
        (("a", 3), "shape = 3: must be"),
        ((3, Sphere(np.zeros(3), 0.1)), "name = 3: must be"),
    ],
)
def test_what_is_no_fixture_is_refused(given: Any, said: str) -> None:
    """A sheath was "nan mm nearer to the anatomy than margins allow"."""
    with pytest.raises(InputError, match=said):
        Fixture(*given)


SCENARIO = """
robot = "robots/table_5_pair.toml"
[base]
position_mm = [0, 0, 10]
[start]
"rotate outer" = 0
"rotate inner" = 0
"translate inner" = -17
[goal.joints]
"rotate outer" = 0
"rotate inner" = 20
"translate inner" = -17
[[anatomy]]
kind = "sphere"
center_mm = [{at}, 0, -40]
radius_mm = 10
[[fixture]]
kind = "capsule"
name = "sheath"
from_mm = [0, 0, -80]
to_mm = [0, 0, -2]
radius_mm = 5
margin_mm = 1
"""


def test_a_plan_is_refused_where_the_sheath_touches(tmp_path: Path) -> None:
    from places import SCENARIOS

    (tmp_path / "robots").symlink_to(SCENARIOS / "robots")
    (tmp_path / "a.toml").write_text(SCENARIO.format(at=12))
    scenario = ctrplan.load_scenario(tmp_path / "a.toml", allow_outside=True)
    with pytest.raises(
        NoAnswerError, match=r"fixture.1 \(sheath\): is 4.\d+ mm nearer to the anatomy than margins allow, at \["
    ):
        ctrplan.plan(scenario, time_s=0.5)
    (tmp_path / "a.toml").write_text(SCENARIO.format(at=60))
    free = ctrplan.load_scenario(tmp_path / "a.toml", allow_outside=True)
    assert free.fixtures[0].clearance(free.anatomy, free.base_position_m, free.base_R)[0] > 0
    (tmp_path / "a.toml").write_text(SCENARIO.format(at=60) + 'role = "avoid"\n')
    with pytest.raises(InputError, match=r"fixture.1.role = 'avoid': goes with \[\[anatomy\]\]"):
        ctrplan.load_scenario(tmp_path / "a.toml", allow_outside=True)
