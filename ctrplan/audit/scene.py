"""A counter-example as a scene: files that `ctrplan view` and `ctrplan simulate` read, and the commands to do so."""

from __future__ import annotations

import copy
import io
import json
import shlex
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
import trimesh
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.audit.allowed_robots import AllowedRobots
from ctrplan.audit.audited_plan import AuditedPlan, WorstFigure
from ctrplan.audit.verify import Verification
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.effects.effect import ANYWHERE
from ctrplan.effects.learned.learned import effect_of
from ctrplan.errors import InputError
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.measurement.measurements import joint_columns
from ctrplan.robot.robot import Robot, file_key
from ctrplan.scenario.scenario import Scenario
from ctrplan.storage.output_folder import write_results

FILES = ("counterexample.json", "scenario.toml", "robot.toml", "joints.csv")


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
        "counterexample.json": json.dumps(_content(figure, commands), indent=2) + "\n",
        "scenario.toml": tomli_w.dumps(_scenario(verification, figure, entries)),
        "robot.toml": tomli_w.dumps(_robot(scenario.robot, figure)),
        "joints.csv": _joints(verification, figure),
        **meshes,
    }
    write_results(folder, results)
    return commands


def _commands(folder: Path, figure: WorstFigure) -> list[str]:
    mesh = "search" if figure.accuracy == "search" else "certificate"
    start = ",".join(f"{phi:+.17g}" for phi in figure.phi) if any(figure.phi) else "released"
    names = (folder / name for name in ("scenario.toml", "robot.toml", "joints.csv", "replay"))
    scenario, robot, joints, replay = (shlex.quote(str(name)) for name in names)
    return [
        f"ctrplan view {scenario}",
        f"ctrplan simulate {robot} {joints} -o {replay} --start={start} --accuracy {mesh}",
    ]


def _scenario(verification: Verification, figure: WorstFigure, anatomy: list[dict[str, Any]]) -> dict[str, Any]:
    """The robot where the claim breaks, its base where it is then; the goal is to stay there."""
    scenario = verification.plan.scenario
    drive = scenario.robot.drive
    commanded = np.concatenate(_commanded(verification, figure)) - np.concatenate(
        [drive.home_theta_rad, drive.home_l_m]
    )
    joints = np.linalg.lstsq(np.vstack([drive.matrix_theta, drive.matrix_l]), commanded, rcond=None)[0]
    here = drive.named(joints)
    turned = Rotation.from_rotvec(figure.base.turn_rad).as_matrix() @ scenario.base_R
    x, y, z, w = Rotation.from_matrix(turned).as_quat().tolist()
    return {
        "name": f"{scenario.name}: {figure.claim} broken",
        "robot": "robot.toml",
        "base": {
            "position_mm": _mm(scenario.base_position_m + figure.base.shift_m),
            "quaternion_wxyz": [w, x, y, z],
        },
        "start": here,
        "goal": {"joints": here},
        "margins": asdict(scenario.margins),
        "anatomy": anatomy,
    }


def _commanded(verification: Verification, figure: WorstFigure) -> tuple[Array, Array]:
    """(n,) [rad], (n,) [m] where the drive is told to be, as late as it follows."""
    way = AuditedPlan.of(verification.plan, figure.accuracy).way
    axes = np.array(figure.axes) if figure.axes else np.zeros(way.robots.count)
    return way.commanded_at(figure.place, axes)


def _robot(robot: Robot, figure: WorstFigure) -> dict[str, Any]:
    """The content of the robot's file, with the parameters of the finding."""
    content: dict[str, Any] = copy.deepcopy(dict(robot.content))
    if not figure.axes:
        return content
    robots = AllowedRobots.of(robot)
    units = dict(zip(robots.parameters.names, robots.parameters.si, strict=True))
    for name, value in _named(robots, np.array(figure.axes), content).items():
        path, in_file = (name, value / units[name]) if name.startswith("effects.") else file_key(name, value)
        *steps, key = path.split(".")
        table: Any = content
        for step in steps:
            table = table[int(step) - 1] if step.isdecimal() else table[step]
        if key == "curvature_per_m" and key not in table:
            given = {each: float(table.get(each) or 0.0) for each in ("curvature_x_per_m", "curvature_y_per_m")}
            table |= {
                each: part * in_file / float(np.linalg.norm(list(given.values()))) for each, part in given.items()
            }
        else:
            table[key] = in_file
    return content


def _named(robots: AllowedRobots, axes: Array, content: dict[str, Any]) -> dict[str, float]:
    """Values [SI] of what differs from the file's; in the place of an effect that differs from pose to pose tubes as it
    makes them then.
    """
    values, robot = robots.values(axes), robots.at(axes) or robots.robot
    for name in [name for name in values if name.endswith(ANYWHERE)]:
        table, (_, effect, key) = content["effects"], name.split(".")
        amount, own = {key: values.pop(name)}, effect_of(effect, robots.robot.effects[effect], robot.n)
        table.pop(effect, None)
        values |= own.mechanics(amount, robot.ideal or robot)
    return values


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
    plan, n = verification.plan, verification.plan.scenario.robot.n
    theta, l = (np.atleast_2d(column) for column in _commanded(verification, figure))  # noqa: E741 (as in the equations)
    if figure.before is not None:
        way = AuditedPlan.of(plan, figure.accuracy).way.until(figure.place)
        before = plan.scenario.robot.drive.commanded(figure.before)
        theta, l = np.vstack([before[0], way[:, :n]]), np.vstack([before[1], way[:, n:]])  # noqa: E741
    if figure.axes:
        theta, l = _told(AuditedPlan.of(plan, figure.accuracy), figure)  # noqa: E741
    header = [name for names in joint_columns(n) for name in names]
    lines = [",".join(header), *(",".join(map(repr, row)) for row in np.hstack([theta, l]).tolist())]
    return "\n".join(lines) + "\n"


def _told(case: AuditedPlan, figure: WorstFigure) -> tuple[Array, Array]:
    """(1, n) [rad], (1, n) [m] to which the drive of the scene's robot is told to go, so that in the middle of its play
    it stands where the finding has it.
    """
    held, n = np.hstack(case.collars(figure.place, np.array(figure.axes))), case.robot.n
    drive = robot_from_dict(_robot(case.robot, figure), file=case.robot.path).drive
    told = root(lambda x: np.hstack(drive.reached(x[:n], x[n:])) - held, held).x
    return told[None, :n], told[None, n:]


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
        "parameters": figure.parameters,
        "base": {"turn_rad": list(figure.base.turn_rad), "shift_m": list(figure.base.shift_m)},
        "accuracy": figure.accuracy,
        "commands": commands,
    }


def _mm(value: Array | float) -> Any:
    return np.multiply(value, MM_PER_M).tolist()


def outputs(scenario: Scenario) -> Iterator[str]:
    """Names of the files of a scene."""
    yield from FILES
    yield from (f"part_{k}.stl" for k, part in enumerate(scenario.anatomy, start=1) if isinstance(part.shape, Mesh))
