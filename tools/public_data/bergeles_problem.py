"""The 13 targets in a ventricle of Bergeles et al. (IEEE T-RO 31(1), 2015) as a scenario and a design file.

Their data are public under the GPL (github.com/RViMLab/TRO2015-computational-robot-design) and none of them is here:
FOLDER is data/ventriclesHC of a copy of yours, with anatomy.mat, base.mat, R.mat and targets_all.mat, all in metres.

    python tools/public_data/bergeles_problem.py FOLDER OUT               # writes OUT/design.toml, ...
    ctrplan design OUT/design.toml -o OUT/designs                             # the search
    python tools/public_data/bergeles_problem.py FOLDER OUT --trials 40    # both, and the shipped tubes

The lumen is their surface with a hole at the base, which is the middle of their box of base positions and looks along
their entry vector. No margin is asked for: some targets are 0.3 mm from the wall. Tubes, ranges and objectives are
those of scenarios/studies/design_ventricle.toml.
"""

from __future__ import annotations

import argparse
import os
import shutil
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import scipy.io
import tomli_w
import trimesh

import ctrplan
from ctrplan.base.long_work import one_core
from ctrplan.scenario.scenario import Goal
from ctrplan.storage.toml_document import read_document
from ctrplan.studies.target_set import Search, SetValue, set_value

ROOT = Path(__file__).resolve().parents[2]
SCENARIOS = ROOT / "scenarios"
TOLERANCE_MM = 2.0
HOLE_MM, HOLE_RADIUS_MM = (-12.0, 8.0), 4.0  # of the way in, along the base's axis


def read(folder: Path, name: str, key: str) -> Any:
    """A variable of one of their files."""
    return scipy.io.loadmat(folder / f"{name}.mat", squeeze_me=True, struct_as_record=False)[key]


def convert(folder: Path, out: Path) -> Path:
    """Writes mesh, robot, scenario and design file; returns the latter."""
    out.mkdir(parents=True, exist_ok=True)
    surface, base = read(folder, "anatomy", "FV"), read(folder, "base", "base")
    mesh = trimesh.Trimesh(np.asarray(surface.vertices) * 1e3, np.asarray(surface.faces).astype(int) - 1)
    mesh.fix_normals()
    mesh.export(out / "ventricle.stl")
    print(f"mesh of {len(mesh.faces)} triangles, {'closed' if mesh.is_watertight else 'NOT closed'}")
    shutil.copy(SCENARIOS / "robots" / "three_tube_insertion.toml", out / "robot.toml")
    targets_mm = (np.asarray(read(folder, "targets_all", "targets")) * 1e3).round(6)
    scenario = dict(read_document(SCENARIOS / "ventricle.toml").content)
    scenario |= {"name": "13 targets in a ventricle", "robot": "robot.toml"}
    scenario["base"] = {
        "position_mm": (np.asarray(base.workspace).mean(axis=0) * 1e3).round(6).tolist(),
        "direction": np.asarray(read(folder, "R", "R"))[:, 2].tolist(),
    }
    scenario["goal"] = {"tip_mm": targets_mm[0].tolist(), "tolerance_mm": TOLERANCE_MM}
    scenario["anatomy"] = [
        {**scenario["anatomy"][0], "file": "ventricle.stl", "margin_mm": 0.0},
        way_in(scenario["base"]),
    ]
    (out / "scenario.toml").write_text(tomli_w.dumps(scenario), encoding="utf-8")
    design = dict(read_document(SCENARIOS / "studies" / "design_ventricle.toml").content)
    design |= {"name": "tubes for 13 targets", "scenario": "scenario.toml"}
    design["targets"] = {"points_mm": targets_mm.tolist(), "tolerance_mm": TOLERANCE_MM}
    (out / "design.toml").write_text(tomli_w.dumps(design), encoding="utf-8")
    return out / "design.toml"


def way_in(base: dict[str, Any]) -> dict[str, Any]:
    """A hole through the wall, at which their base stands, so that tubes may pass there."""
    along = np.array(base["direction"]) / np.linalg.norm(base["direction"])
    ends = [(np.array(base["position_mm"]) + mm * along).round(6).tolist() for mm in HOLE_MM]
    return {"kind": "capsule", "from_mm": ends[0], "to_mm": ends[1], "radius_mm": HOLE_RADIUS_MM, "role": "inside"}


def print_worth(name: str, worth: SetValue) -> None:
    within = np.mean(worth.errors_mm <= TOLERANCE_MM)
    print(
        f"{name}: {len(worth.reached)} of {len(worth.targets)} reached, {within:.0%} within {TOLERANCE_MM:g} mm, "
        f"{worth.error_mm:.2f} mm at worst in the mean, stability {worth.stability:.2f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--trials", type=int, default=0)
    asked = parser.parse_args()
    search = ctrplan.TubeDesign.read(convert(asked.folder, asked.out), [f"trials={max(asked.trials, 1)}"])
    if not asked.trials:
        return
    goals = [Goal(None, point * 1e-3, TOLERANCE_MM * 1e-3) for point in search.points_mm]
    with one_core():
        shipped = ctrplan.load_scenario(asked.out / "scenario.toml")
        print_worth("shipped tubes", set_value(shipped, goals, Search(starts=search.entry.starts)))
    found = search.run(asked.out / "designs", workers=1)
    for looked in found.front[:3]:
        shown = {
            key: round(looked.numbers[key], 3) for key in ("robust_mm", "error_mm", "reach", "within", "stability")
        }
        print(f"  design: {shown}")


if __name__ == "__main__":
    main()
