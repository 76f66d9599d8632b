"""What does a plan take with an anatomy of 200,000 triangles? Peak memory and CPU time of `ctrplan plan`.

python benchmarks/plan_memory.py [--triangles 200000] [--scenario vessel]

The scenario's meshes are divided into smaller triangles, whose corners are moved by hundredths of a millimetre so that
nothing can be taken together again, and planned in as a process of its own with empty caches.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import trimesh

SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"
ROUGHNESS_MM = 0.01


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--triangles", type=int, default=200_000)
    parser.add_argument("--scenario", default="vessel")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        triangles = prepare(folder, arguments.scenario, arguments.triangles)
        run = "import sys; from ctrplan.cli import main; sys.exit(main(sys.argv[1:]))"
        command = [sys.executable, "-c", run, "plan", str(folder / "scenario.toml"), "-o", str(folder / "out")]
        began = time.monotonic()
        environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}
        done = subprocess.run([*command, "--set", "planner.time_s=2"], env=environment, capture_output=True, text=True)
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        outcome = "planned and certified" if done.returncode == 0 else f"failed: {done.stderr.strip()}"
        cpu = used.ru_utime + used.ru_stime
        print("| scenario | triangles | outcome | peak memory | CPU time | by the clock |\n|---|---|---|---|---|---|")
        print(f"| {arguments.scenario} | {triangles:,} | {outcome} | {used.ru_maxrss / 1024:.0f} MB | ", end="")
        print(f"{cpu:.0f} s | {time.monotonic() - began:.0f} s |")


def prepare(folder: Path, scenario: str, at_least: int) -> int:
    """Writes the scenario with finer meshes, robots beside it; the number of triangles."""
    text, total = (SCENARIOS / f"{scenario}.toml").read_text(encoding="utf-8"), 0
    (folder / "scenario.toml").write_text(text, encoding="utf-8")
    for kind in ("robots", "meshes"):
        (folder / kind).mkdir()
    for robot in (SCENARIOS / "robots").glob("*.toml"):
        (folder / "robots" / robot.name).write_bytes(robot.read_bytes())
    files = [file for file in sorted((SCENARIOS / "meshes").glob("*.stl")) if f"meshes/{file.name}" in text]
    rng = np.random.default_rng(0)
    for file in files:
        mesh = trimesh.load_mesh(file)
        while len(mesh.faces) * len(files) < at_least:
            mesh = mesh.subdivide()
        mesh.vertices += rng.normal(size=mesh.vertices.shape) * ROUGHNESS_MM
        mesh.export(folder / "meshes" / file.name)
        total += len(mesh.faces)
    return total


if __name__ == "__main__":
    main()
