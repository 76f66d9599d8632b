"""A counter-example as a scene: files that `ctrplan view` and `ctrplan simulate` read, and the commands to do so."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
import trimesh
from scipy.spatial.transform import Rotation

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.audit.audited_plan import AuditedPlan, WorstFigure
from ctrplan.audit.verify import Verification
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.errors import InputError
from ctrplan.files.joint_path_file import joint_columns
from ctrplan.scenario.scenario import Scenario
from ctrplan.storage.output_folder import write_results

FILES = ("scenario.toml", "robot.toml", "joints.csv", "counterexample.json")


def write_scene(folder: Path, verification: Verification, figure: WorstFigure) -> list[str]:
    """Writes the scene of a finding into a folder, with the robot and the meshes; returns the commands that show it.

    Raises InputError for anatomy of a kind that no file here describes, CtrplanError where the system refuses.
    """
    scenario = verification.plan.scenario
    entries: list[dict[str, Any]] = []
    meshes: dict[str, bytes] = {}
    for number, part in enumerate(scenario.anatomy, start=1):
        entry, mesh = _part(part, f"part_{number}.stl")
        entries.append(entry)
        meshes |= mesh
    commands = _commands(folder, figure)
    results: dict[str, str | bytes] = {
        "scenario.toml": tomli_w.dumps(_scenario(scenario, figure, entries)),
        "robot.toml": tomli_w.dumps(dict(scenario.robot.content)),
        "joints.csv": _joints(verification, figure),
        "counterexample.json": json.dumps(_content(figure, commands), indent=2) + "\n",
        **meshes,
    }
    write_results(folder, results)
    return commands


def _commands(folder: Path, figure: WorstFigure) -> list[str]:
    mesh = "search" if figure.accuracy == "search" else "certificate"
    start = ",".join(f"{phi:+.17g}" for phi in figure.phi) if any(figure.phi) else "released"
    replay = f"-o {folder / 'replay'} --start={start} --accuracy {mesh}"
    return [
        f"ctrplan view {folder / 'scenario.toml'}",
        f"ctrplan simulate {folder / 'robot.toml'} {folder / 'joints.csv'} {replay}",
    ]


def _scenario(scenario: Scenario, figure: WorstFigure, anatomy: list[dict[str, Any]]) -> dict[str, Any]:
    """The robot where the claim breaks; the goal is to stay there."""
    here = scenario.robot.drive.named(figure.joints)
    x, y, z, w = Rotation.from_matrix(scenario.base_R).as_quat().tolist()
    return {
        "name": f"{scenario.name}: {figure.claim} broken",
        "robot": "robot.toml",
        "base": {"position_mm": _mm(scenario.base_position_m), "quaternion_wxyz": [w, x, y, z]},
        "start": here,
        "goal": {"joints": here},
        "margins": asdict(scenario.margins),
        "anatomy": anatomy,
    }


def _part(part: AnatomyPart, mesh_file: str) -> tuple[dict[str, Any], dict[str, bytes]]:
    shape, given = part.shape, vars(part.shape)
    kind = "mesh" if shape.kind == "volume" else shape.kind
    entry: dict[str, Any] = {"kind": kind, "role": part.role, "margin_mm": part.margin_m * MM_PER_M}
    if isinstance(shape, Mesh):
        stream = io.BytesIO()
        trimesh.Trimesh(given["vertices_m"], given["faces"], process=False).export(stream, file_type="stl")
        return {**entry, "file": mesh_file, "unit": "m"}, {mesh_file: stream.getvalue()}
    if shape.kind not in ("sphere", "capsule"):
        raise InputError("is a kind of anatomy that a scene can't be written with", key="kind", value=shape.kind)
    lengths = {name[:-2] + "_mm": _mm(value) for name, value in given.items()}
    return entry | lengths, {}


def _joints(verification: Verification, figure: WorstFigure) -> str:
    """What the tubes are commanded to: before the start, then along the way until the claim breaks."""
    plan, drive = verification.plan, verification.plan.scenario.robot.drive
    rows = figure.joints[None]
    if figure.before is not None:
        way = AuditedPlan.of(plan, figure.accuracy).way
        rows = np.vstack([figure.before, way.until(figure.place)])
    theta, l = drive.commanded(rows)  # noqa: E741 (as in the equations)
    if figure.play and drive.play is not None:
        n = plan.scenario.robot.n
        theta, l = theta + drive.play[0] * figure.play[:n], l + drive.play[1] * figure.play[n:]  # noqa: E741
    header = [name for names in joint_columns(plan.scenario.robot.n) for name in names]
    lines = [",".join(header), *(",".join(map(repr, row)) for row in np.hstack([theta, l]).tolist())]
    return "\n".join(lines) + "\n"


def _content(figure: WorstFigure, commands: list[str]) -> dict[str, Any]:
    return {
        "claim": figure.claim,
        "stated": None if np.isnan(figure.stated) else figure.stated,
        "found": figure.value,
        "leg": figure.leg,
        "time_s": figure.time_s,
        "joints": figure.joints.tolist(),
        "point_mm": _mm(figure.point_m),
        "tube": figure.tube,
        "friction_state": list(figure.phi),
        "joints_before": None if figure.before is None else figure.before.tolist(),
        "play": list(figure.play),
        "accuracy": figure.accuracy,
        "commands": commands,
    }


def _mm(value: Array | float) -> Any:
    return np.multiply(value, MM_PER_M).tolist()


def outputs(scenario: Scenario) -> Iterator[str]:
    """Names of the files of a scene."""
    yield from FILES
    yield from (f"part_{k}.stl" for k, part in enumerate(scenario.anatomy, start=1) if isinstance(part.shape, Mesh))
