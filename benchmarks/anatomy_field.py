"""How long does the distance field of a 200,000-triangle organ take, in how much memory, and how far off is it?

    python benchmarks/anatomy_field.py

A lumpy body some 120 mm across in a cube of 200 mm, to be avoided. Each row runs in a process of its own; peak memory
includes the interpreter and its libraries. "over" is what `overestimate_m` finds, "under" the opposite error.
"""

import multiprocessing
import os
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
import trimesh

from ctrplan.anatomy.clearance_grid import SignedDistanceField, build_field
from ctrplan.anatomy.mesh_file import load_mesh
from ctrplan.anatomy.parts import AnatomyPart, exact_clearance
from ctrplan.anatomy.shapes.mesh import Mesh

HALF_M = 0.1
COLUMNS = ["triangles", "load s", "step mm", "Mnodes", "build s", "CPU s", "cached s"]
COLUMNS += ["MB before", "MB peak", "over um", "under um", "us/query"]


def write_organ(path: Path) -> None:
    """A cube subdivided to 196,608 triangles, blown up to a sphere of 60 mm radius with bumps of up to 5 mm."""
    mesh = trimesh.creation.box((1, 1, 1))
    for _ in range(7):
        mesh = mesh.subdivide()
    direction = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1)[:, None]
    bumps = 1 + 0.08 * np.sin(7 * direction[:, :1] + 1) * np.sin(9 * direction[:, 1:2]) * np.sin(8 * direction[:, 2:])
    trimesh.Trimesh(60 * direction * bumps, mesh.faces, process=False).export(path)


def peak_mb() -> float:
    """Largest resident memory of this process so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


def measure(path: Path, spacing_m: float) -> tuple[object, ...]:
    """One row of the table for a grid step [m]."""
    start = time.perf_counter()
    vertices, faces = load_mesh(path, "mm")
    loaded, before = time.perf_counter() - start, peak_mb()
    part = AnatomyPart(Mesh(vertices, faces), "avoid", 1e-3)
    box = ([-HALF_M] * 3, [HALF_M] * 3)
    start, cpu = time.perf_counter(), time.process_time()
    field = build_field([part], *box, spacing_m)  # and stored
    built, cpu = time.perf_counter() - start, time.process_time() - cpu
    peak = peak_mb()
    assert field is not None
    start = time.perf_counter()
    build_field([part], *box, spacing_m)
    cached = time.perf_counter() - start
    over = overestimate_m(field) * 1e6
    nodes = field.values_m.size / 1e6
    return len(faces), loaded, spacing_m * 1e3, nodes, built, cpu, cached, before, peak, over, *shortfall(field)


def overestimate_m(field: SignedDistanceField, band_m: float = 0.01, count: int = 20_000) -> float:
    """Largest overestimate of the clearance [m] at random points that the field calls clear.

    The points lie within a grid step of nodes with a clearance of 0 to band_m [m], where paths are decided.
    """
    rng = np.random.default_rng(0)
    candidates = np.flatnonzero((field.values_m >= 0) & (field.values_m <= band_m))
    node = np.stack(np.unravel_index(rng.choice(candidates, count), field.values_m.shape), axis=1)
    points = field.origin_m + field.spacing_m * (node + rng.uniform(-1, 1, (count, 3)))
    points = np.clip(points, field.origin_m, field.upper_m)
    sampled = field.sample(points)
    clear = sampled >= 0
    return float(np.max(sampled[clear] - exact_clearance(field.parts, points[clear]), initial=0.0))


def shortfall(field: SignedDistanceField) -> tuple[float, float]:
    """Largest underestimate [um] within 10 mm of the surface, and microseconds per exact query, on 50,000 points."""
    points = np.random.default_rng(1).uniform(-HALF_M, HALF_M, (50_000, 3))
    start = time.perf_counter()
    exact = exact_clearance(field.parts, points)
    query = (time.perf_counter() - start) / len(points) * 1e6
    near = np.abs(exact) < 0.01
    return float((exact - field.sample(points))[near].max() * 1e6), query


def main() -> None:
    """Print the table."""
    print(f"{os.cpu_count()} CPUs, cube of {2e3 * HALF_M:.0f} mm")
    print("  ".join(f"{n:>9}" for n in COLUMNS))
    with tempfile.TemporaryDirectory() as cache:
        os.environ["CTRPLAN_CACHE_DIR"] = cache
        path = Path(cache) / "organ.stl"
        write_organ(path)
        for spacing in (2e-3, 1e-3, 0.5e-3):
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                row = pool.apply(measure, (path, spacing))
            print("  ".join(f"{value:9.4g}" if isinstance(value, float) else f"{value:>9}" for value in row))


if __name__ == "__main__":
    main()
