"""How well surfaces between voxels follow analytic bodies, and what large scans and meshes cost.

    python benchmarks/run.py scans [phantoms] [volume] [mesh]        (default: all)

phantoms: tubes along a line and a circle, askew to the voxels, as label maps and as grey values. volume: a label map of
512 x 512 x 400 voxels to a field of clearances. mesh: 2 million triangles read, thinned, and planned in. Memory is the
largest that the process ever had, so give one word to learn one of them.
"""

import itertools
import os
import resource
import tempfile
import time
from functools import partial
from pathlib import Path

import common
import numpy as np
import phantoms
import tomli_w
from common import ROBOTS, table
from scipy.spatial.transform import Rotation

import ctrplan
from ctrplan.anatomy.clearance_grid import anatomy_field, field_bounds, shared_spacing_m

SPACINGS_MM = [(0.5, 0.5, 0.5), (1.0, 1.0, 1.0), (0.7, 0.7, 1.4), (2.0, 2.0, 2.0)]
RADII_MM = (1.0, 3.0, 5.0, 9.0)
DRAWS = 3
REACH_M = 0.12
ROBOT = ROBOTS / "three_tube_insertion.toml"
START = {"rotate outer": 0, "rotate middle": 180, "rotate inner": 90, "advance all": -149, "translate inner": -86.4}
LUMEN = {"kind": "mesh", "file": "lumen.stl", "unit": "mm", "role": "inside", "margin_mm": 0.3}


def phantom_errors(folder: Path) -> None:
    rows = (
        _row(folder, *of) for of in itertools.product(SPACINGS_MM, RADII_MM, (False, True)) if of[1] >= 0.9 * max(of[0])
    )
    table("phantoms", "voxels (mm) | radius (mm) | of | rms (voxel) | mean | 99 % | largest", rows)


def _row(folder: Path, spacing: tuple[float, ...], radius: float, grey: bool) -> tuple[str, ...]:
    off = np.concatenate([_errors(folder, spacing, radius, grey, seed) for seed in range(DRAWS)])
    numbers = np.sqrt(np.mean(off**2)), np.mean(off), np.quantile(np.abs(off), 0.99), np.abs(off).max()
    size = " x ".join(f"{s:g}" for s in spacing)
    return size, f"{radius:g}", "grey" if grey else "labels", *(f"{x:.3f}" for x in numbers)


def _errors(folder: Path, spacing: tuple[float, ...], radius: float, grey: bool, seed: int) -> phantoms.Array:
    """Errors of the vertices, in widest voxels, on a tube along a line and one along a circle."""
    rng = np.random.default_rng(seed)
    turned, centre = Rotation.random(random_state=seed).as_matrix(), rng.uniform(-1, 1, 3) * max(spacing)
    line = phantoms.capsule(centre - 1.5 * radius * turned[0], centre + 1.5 * radius * turned[0], radius)
    found = []
    for body in (line, phantoms.torus(centre, turned, 2.2 * radius, radius)):
        made = phantoms.image(body, centre, 3.3 * radius + 3 * max(spacing), spacing, grey=grey)
        phantoms.written(made, folder / "a.nrrd")
        chosen = {"above": -500} if grey else {"label": 3}
        part = phantoms.part_of(folder, kind="volume", file="a.nrrd", **chosen)
        found.append(body(part.shape.surface().vertices_m * 1e3) / max(spacing))
    return np.concatenate(found)


def large_volume(folder: Path) -> None:
    """A tree of tubes through the whole of 512 x 512 x 400 voxels, 0.7 x 0.7 x 0.8 mm."""
    size, spacing = (512, 512, 400), (0.7, 0.7, 0.8)
    _write_tree(folder / "tree.nii.gz", size, spacing)
    before = _clock()
    part = phantoms.part_of(folder, kind="volume", file="tree.nii.gz", label=2, role="inside")
    read = _clock()
    base = np.array([0.0, 0.0, -0.5 * size[2] * spacing[2] * 1e-3 + 0.02])
    lower, upper = field_bounds([part], REACH_M, base)
    spacing_m = shared_spacing_m([part], REACH_M)
    field = anatomy_field([part], lower, upper, spacing_m, base_position_m=base, reach_m=REACH_M)
    print(f"field of {' x '.join(map(str, field.values_m.shape))} nodes, {field.spacing_m * 1e3:.2f} mm apart")
    done = _clock()
    shown = " x ".join(map(str, size))
    print(f"{shown} labels read, {len(part.shape.surface().faces)} triangles: {_took(before, read)}")
    print(f"field: {_took(read, done)}; together: {_took(before, done)}")


def _write_tree(path: Path, size: tuple[int, int, int], spacing: tuple[float, float, float]) -> None:
    import SimpleITK

    voxels = np.zeros(size[::-1], np.uint8)
    x, y = (spacing[k] * (np.arange(size[k]) - size[k] / 2) for k in range(2))
    for k in range(size[2]):
        z = spacing[2] * k
        for branch in range(1 + 8 * (k > 80)):
            away = max(z - 64, 0) * (branch > 0)
            cx, cy = (0.45 * away * f(branch * np.pi / 4 + 0.004 * away) for f in (np.cos, np.sin))
            rows, columns = np.abs(y - cy) < 12, np.abs(x - cx) < 12
            disc = (x[columns] - cx) ** 2 + (y[rows, None] - cy) ** 2 < (9.0 if branch == 0 else 5.0) ** 2
            block = np.ix_(rows, columns)
            voxels[k][block] = np.where(disc, 2, voxels[k][block])
    voxels[:4] = voxels[-4:] = 0
    made = SimpleITK.GetImageFromArray(voxels)
    made.SetSpacing(spacing)
    made.SetOrigin([-spacing[0] * size[0] / 2, -spacing[1] * size[1] / 2, -spacing[2] * size[2] / 2])
    SimpleITK.WriteImage(made, str(path), True)


def large_mesh(folder: Path) -> None:
    """A winding lumen of 2.1 million triangles: read, thinned, and planned in."""
    _write_lumen(folder / "lumen.stl")
    content = {"robot": str(ROBOT), "start": START, "goal": {"tip_mm": [12, 3, 95]}, "anatomy": [LUMEN]}
    (folder / "lumen.toml").write_text(tomli_w.dumps(content))
    before = _clock()
    scenario = ctrplan.load_scenario(folder / "lumen.toml", allow_outside=True)
    read = _clock()
    print(f"2.1 million triangles read and thinned: {_took(before, read)}; {' '.join(scenario.anatomy[0].shape.notes)}")
    plan = ctrplan.plan(scenario)
    told = f"certified: {plan.certificate.valid}, clearance {plan.certificate.min_clearance_m * 1e3:.2f} mm"
    print(f"planned: {_took(read, _clock())}; {told}; together: {_took(before, _clock())}")


def _write_lumen(path: Path, rings: int = 2100, around: int = 500) -> None:
    import trimesh

    along = np.linspace(0, 1, rings)[:, None]
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)[None]
    radius = 14 + 0.9 * np.sin(40 * along) * np.cos(3 * angle) + 0.25 * np.sin(200 * along + 5 * angle)
    x, y, z = 6 * np.sin(2.2 * along) + radius * np.cos(angle), radius * np.sin(angle), -15 + 260 * along + 0 * angle
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    ring, side = np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij")
    a, b = ring * around + side, ring * around + (side + 1) % around
    walls = [np.stack([a, b, b + around], -1), np.stack([a, b + around, a + around], -1)]
    ends, k, last = len(vertices) + np.array([[0], [1]]), np.arange(around), (rings - 1) * around
    first = np.stack([np.full(around, ends[0]), (k + 1) % around, k], axis=1)
    final = np.stack([np.full(around, ends[1]), last + k, last + (k + 1) % around], axis=1)
    vertices = np.concatenate([vertices, vertices[:around].mean(axis=0)[None], vertices[-around:].mean(axis=0)[None]])
    faces = np.concatenate([*(wall.reshape(-1, 3) for wall in walls), first, final])
    trimesh.Trimesh(vertices, faces, process=False).export(path)


def _clock() -> tuple[float, float]:
    return time.perf_counter(), time.process_time()


def _took(begin: tuple[float, float], end: tuple[float, float]) -> str:
    """Processor time is told, too: others may be at work on the machine."""
    return f"{end[0] - begin[0]:.1f} s ({end[1] - begin[1]:.1f} s of a processor)"


def main() -> None:
    known = {"phantoms": phantom_errors, "mesh": large_mesh, "volume": large_volume}
    given = common.arguments(__doc__, ("sections*", known))
    with tempfile.TemporaryDirectory() as name:
        os.environ["CTRPLAN_CACHE_DIR"] = name
        common.sections(given.sections, {section: partial(work, Path(name)) for section, work in known.items()})
    print(f"largest memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")
