"""Files to begin with, commented and ready to run: a robot from tubes, a scenario for a robot, a mapping for a table.

Texts are made of the numbers given and read again before they are written, so that what `ctrplan init` writes runs.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ctrplan.anatomy.mesh_file import usual_unit
from ctrplan.anatomy.parts import AnatomyPart, exact_clearance_of_many
from ctrplan.anatomy.shape import Role
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.drive.drive import DEFAULT_MOTION
from ctrplan.errors import InputError
from ctrplan.files.scenario_anatomy import anatomy_part
from ctrplan.mechanics.gradients import clearances
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.walk import PathDensity
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import JointSpace, retracted
from ctrplan.storage.csv_table import CsvTable, file_name
from ctrplan.storage.toml_document import Document, TomlTable, toml_value

# What a first file says where nobody measured: austenitic nitinol, and the friction and collars of the paper's robot.
NITINOL_GPA, NITINOL_RATIO, FRICTION = 65.0, 0.3, 0.2
COLLAR_MM = 17.0
DRAWN = 400  # configurations among which the goal of a first scenario is chosen
TOLERANCE_MM = 2.0  # of a first goal, which nearly every robot can keep
MARGIN_MM: dict[Role, float] = {"avoid": 1.0, "inside": 0.5}  # of a first scenario
ROOM_M = 1e-3  # beyond the margin, for what certificates take off
FARTHER = (1.0, 0.7, 0.5, 0.35, 0.2, 0.1)  # shares of the way from the start at which a goal is sought, by turns
LOOKED_AT = 40  # configurations whose room is solved, of those whose tip has it
NO_ROOM = "the robot drawn back does not stand clear of this mesh: say where its base is, in [base]"
INWARD = (1e-3, 1e-2, 0.1)  # of the way to the goal, that a start may be on to keep all limits
WRITTEN_M = 1e-5  # what a start keeps of every limit, so that six digits of it keep them


@dataclass(frozen=True)
class TubeChoice:
    """A tube in mm, from the base: a straight piece, then one bent by a radius; a radius of 0 is straight, too."""

    outer_mm: float
    inner_mm: float
    straight_mm: float
    bent_mm: float
    radius_mm: float

    @property
    def length_mm(self) -> float:
        """From base to tip."""
        return self.straight_mm + self.bent_mm


USUAL = (TubeChoice(2.64, 2.39, 0.0, 150.0, 265.0), TubeChoice(2.305, 1.95, 17.0, 150.0, 265.0),
         TubeChoice(1.825, 1.60, 184.0, 86.4, 55.0))  # fmt: skip


def tube_choice(text: str) -> TubeChoice:
    """A tube from "2.64x2.39,0,150,265": diameters, straight and bent length, radius [mm]. Raises InputError."""
    parts = re.split(r"[x,\s]+", text.strip())
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) != 5 or not all(math.isfinite(x) and x >= 0 for x in numbers):
        rule = "must be OUTERxINNER,STRAIGHT,BENT,RADIUS in mm, such as 2.64x2.39,0,150,265"
        raise InputError(rule, key="--tube", value=text)
    if not (tube := TubeChoice(*numbers)).length_mm:
        raise InputError("has no length: one of STRAIGHT and BENT must be above 0", key="--tube", value=text)
    return tube


def robot_text(tubes: Sequence[TubeChoice] = USUAL, name: str = "my robot") -> str:
    """A robot file of tubes, outermost first, each turned and pushed by a joint of its own."""
    lines = [
        "# Written by `ctrplan init robot`. Every number is yours to change; `ctrplan check` draws what it means.",
        f"name = {toml_value(name)}",
    ]
    for i, tube in enumerate(tubes):
        lines += ["", f"[[tube]]{' ' * 24}# {'outermost' if i == 0 else 'the next one inwards'}"]
        lines += [
            f"outer_diameter_mm = {tube.outer_mm:g}",
            f"inner_diameter_mm = {tube.inner_mm:g}",
            f"youngs_modulus_GPa = {NITINOL_GPA:g}         # of nitinol; or bending_stiffness_Nm2, if you measured it",
            f"poisson_ratio = {NITINOL_RATIO:g}             # or shear_modulus_GPa, torsional_stiffness_Nm2",
        ]
        if i:
            lines.append(
                f"collar_length_mm = {COLLAR_MM:g}           # its base stays this far behind the tube around it"
            )
        if tube.straight_mm:
            lines += ["[[tube.section]]                # from the base: straight", f"length_mm = {tube.straight_mm:g}"]
        if tube.bent_mm:
            after = "then " if tube.straight_mm else "from the base: "
            shape = "bent" if tube.radius_mm else "straight, for want of a radius_mm"
            lines += [f"[[tube.section]]                # {after}{shape}", f"length_mm = {tube.bent_mm:g}"]
            lines += [f"radius_mm = {tube.radius_mm:g}"] if tube.radius_mm else []
    for i in range(len(tubes) - 1):
        lines += ["", f"[[contact]]                     # of tubes {i + 1} and {i + 2}"]
        lines.append(f"friction_coefficient = {FRICTION:g}      # or an interval [0.15, 0.25]")
    bases = _home_mm(tubes)
    lines += [
        "",
        "[home]                          # bases when all joints are 0, behind the plate",
        f"theta_deg = {[0] * len(tubes)}",
        f"l_mm = {bases}",
    ]
    for i, tube in enumerate(tubes, start=1):
        lines += _joint(f"rotate {i}", "theta", i, len(tubes), "deg", "")
        travel = _travel_mm(tubes, i - 1)
        if travel > 0:
            lines += _joint(f"translate {i}", "l", i, len(tubes), "mm", f"min_mm = {-travel:g}\nmax_mm = 0")
        else:
            lines += [f"# tube {i} is not translated: {tube.length_mm:g} mm of it are in front of the plate"]
    lines += [
        "",
        "# [measurement]                 # of your tracker, for ctrplan diagnose",
        "# position_sigma_mm = 0.3",
        "",
    ]
    return "\n".join(lines)


def _home_mm(tubes: Sequence[TubeChoice]) -> list[float]:
    return [round(-COLLAR_MM * i, 3) + 0.0 for i in range(len(tubes))]


def _travel_mm(tubes: Sequence[TubeChoice], i: int) -> float:
    """How far a tube may be drawn back from home with its tip ahead of the one around it, which stays."""
    if i == 0:
        return 0.0
    home = _home_mm(tubes)
    ahead = (home[i] + tubes[i].length_mm) - (home[i - 1] + tubes[i - 1].length_mm)
    return round(max(ahead, 0.0), 3)


def _joint(name: str, kind: str, i: int, n: int, unit: str, limits: str) -> list[str]:
    velocity, acceleration, jerk = DEFAULT_MOTION["rotation" if unit == "deg" else "translation"]
    moves = [int(k == i) for k in range(1, n + 1)]
    return [
        "",
        "[[joint]]",
        f"name = {toml_value(name)}",
        f"moves = {{ {kind} = {moves} }}",
        *(limits.splitlines() if limits else ["# without min_deg and max_deg it turns without end"]),
        f"max_velocity_{unit}_s = {velocity}",
        f"max_acceleration_{unit}_s2 = {acceleration}",
        f"max_jerk_{unit}_s3 = {jerk}",
    ]


@dataclass(frozen=True, eq=False)
class FirstTask:
    """Where a first scenario begins and goes to, and what its mesh is to the robot; fits: whether all that is clear."""

    start: Array  # (m,) rad or m
    goal: Array  # (m,)
    role: Role = "avoid"
    fits: bool = True


def scenario_text(robot: Robot, file: str, mesh: str | None = None, unit: str | None = None, path: str = "") -> str:
    """A scenario in free space, or with a mesh: from the robot drawn back to a tip that it can reach.

    file, mesh: as the scenario at `path` is to name them. A mesh that holds the robot drawn back is a lumen, any other
    one is avoided; start and goal are such as leave room. Raises InputError where nothing is reached.
    """
    drive = robot.drive
    shape = {} if mesh is None else {"kind": "mesh", "file": mesh, "unit": unit or usual_unit(Path(mesh))}
    task = _first_task(robot, shape, path)
    tip = np.round(robot.mechanics.bound(*drive.collars(task.goal)).frictionless.tip_m * MM_PER_M, 1).tolist()
    joints = zip(drive.joints, task.start.tolist(), strict=True)
    lines = [
        "# Written by `ctrplan init scenario`: plan it with `ctrplan plan`, then change it to your task.",
        'name = "my task"',
        f"robot = {toml_value(file)}    # relative to this file",
        "",
        "[start]                         # joint values, in deg and mm: here all tubes drawn back",
        *(f"{toml_value(joint.name)} = {value / joint.si_per_unit + 0.0:.6g}" for joint, value in joints),
        "",
        "[goal]                          # the tip in the frame of the anatomy, millimetres",
        f"tip_mm = {tip}",
        f"tolerance_mm = {TOLERANCE_MM:g}",
        "# direction = [0, 0, 1]         # optional, with direction_tolerance_deg",
        "",
        "# [base]                        # optional: where the front plate is in the frame of the anatomy",
        "# position_mm = [0, 0, 0]",
        "# look_at = [0, 0, 100]",
        "",
    ]
    if mesh is None:
        lines += [
            '# [[anatomy]]                   # what to avoid, or role = "inside": what to stay inside',
            '# kind = "mesh"',
        ]
        lines += ['# file = "organ.stl"', '# unit = "mm"', '# role = "avoid"', "# margin_mm = 1.0"]
        return "\n".join([*lines, ""])
    why = {
        "inside": 'role = "inside"                 # a lumen that the robot stays in, as it holds the robot drawn back',
        "avoid": 'role = "avoid"                  # or "inside": a lumen that the robot stays in',
    }
    if not task.fits:
        lines.append(f"# {NO_ROOM}")
    lines += ["[[anatomy]]", *(f"{key} = {toml_value(value)}" for key, value in shape.items()), why[task.role]]
    return "\n".join([*lines, f"margin_mm = {MARGIN_MM[task.role]:g}", ""])


def _first_task(robot: Robot, mesh: dict[str, str], path: str) -> FirstTask:
    """A start drawn back and a goal of little friction error, clear of the table of a mesh where one is given."""
    space, drive = JointSpace.of_robot(robot), robot.drive
    drawn = space.sample(np.random.default_rng(0), DRAWN * (len(FARTHER) if mesh else 1))
    goal = _surest(robot, drawn[:DRAWN])
    if goal is None:
        raise InputError("no configuration with one stable equilibrium was found to go to", file=robot.path)
    back, inward = retracted(robot), replace(space, nesting_h=space.nesting_h - WRITTEN_M)
    ways = (back + share * (goal - back) * ~drive.is_rotation for share in (0.0, *INWARD))
    start = next((q for q in ways if inward.allowed(q)), back)
    if not mesh:
        return FirstTask(start, goal)
    starts = np.vstack([start, np.where(drive.is_rotation, drawn[:LOOKED_AT], start)])
    roles: tuple[Role, ...] = ("inside", "avoid")
    for role in roles:
        table = mesh | {"role": role, "margin_mm": MARGIN_MM[role]}
        try:
            part = anatomy_part(TomlTable(Document.of({"anatomy": [table]}, "scenario", path or None), ("anatomy", 0)))
        except InputError:  # which `ctrplan check` says
            return FirstTask(start, goal)
        if not _rooms_m(robot, part, starts[:1])[0] >= ROOM_M:  # other turns may bend it clear
            clear = starts[_rooms_m(robot, part, starts) >= ROOM_M]
            if not len(clear):
                continue
            begin = clear[np.argmax(robot.mechanics.bound_many(*drive.collars(clear)).stability)]
        else:
            begin = start
        for share in FARTHER:
            ahead = np.where(drive.is_rotation, drawn, begin + share * (drawn - begin))
            at = robot.mechanics.tips(*drive.collars(ahead))[0]
            near = ahead[exact_clearance_of_many((part,), np.nan_to_num(at)) >= ROOM_M][:LOOKED_AT]
            if len(near) and (found := _surest(robot, near[_rooms_m(robot, part, near) >= ROOM_M])) is not None:
                return FirstTask(begin, found, role)
    return FirstTask(start, goal, fits=False)


def _surest(robot: Robot, q: Array) -> Array | None:
    """(m,) of joint values (K, m) the one whose tip friction moves least, of those with one stable equilibrium."""
    if not len(q):
        return None
    bounds = robot.mechanics.bound_many(*robot.drive.collars(q))
    sound = np.isfinite(bounds.position_m) & (bounds.status == Status.CONVERGED) & (bounds.stability > 0.5)
    return np.asarray(q[np.argmin(np.where(sound, bounds.position_m, np.inf))]) if sound.any() else None


def _rooms_m(robot: Robot, part: AnatomyPart, q: Array) -> Array:
    """(K,) [m] what joint values (K, m) leave beyond the margin of a part, with the base at the origin; or NaN."""
    kept, base = JointSpace.of_robot(robot).allowed_rows(q), (np.eye(3), np.zeros(3))
    spacing_m, parts = PathDensity.point_spacing_m, (part,)
    return clearances(
        robot.mechanics,
        robot.drive.collars(q),
        None,
        base,
        partial(exact_clearance_of_many, parts),
        spacing_m=spacing_m,
        kept=kept,
    ).clearance_m


ANGLE = {"theta", "rot", "rotation", "alpha", "angle", "ang", "phi", "a", "r", "turn", "deg", "degrees", "rad", "turns"}
LENGTH = {"l", "beta", "trans", "translation", "lin", "ext", "ins", "insertion", "d", "t", "mm", "cm", "m"}
AXIS = re.compile(r"(t|tan|tangent|dir|direction|d|n)?(?:tip|pos|position|p)?([xyz])")
TIME, SEQUENCE = r"(?:time|t|stamp|timestamp)", r"(?:sequence|seq|run|s|trial)"
UNIT = r"(?:_?(?:\(|\[)?(rad|deg|degrees|mm|m|s|ms)(?:\)|\])?)?"


def mapping_text(table: str | os.PathLike[str], robot: Robot) -> str:
    """A mapping file for a CSV table whose columns are guessed by their names; what was not found is said in it."""
    name = file_name(table, "a CSV file")
    columns = CsvTable(name, "file of measurements").header
    guessed = _guessed(columns)
    theta, l = (_tubes(guessed[key], robot.n) for key in ("theta", "l"))  # noqa: E741
    position = [guessed["position"].get(axis) for axis in "xyz"]
    lines = [
        f"# Written by `ctrplan init mapping` for {Path(name).name}: columns were guessed, look at each.",
        f"# The columns there are: {' '.join(', '.join(columns).split())}",
        "",
        "[[run]]",
        f"file = {toml_value(Path(name).name)}",
        "# frame = \"unknown\"             # where nobody knows the robot's place in the tracker's frame",
        "",
        "[columns]                       # one for each tube, outermost first",
        f"theta = {_toml_list(theta)}",
        f"l = {_toml_list(l)}",
        f"position = {_toml_list(position)}",
    ]
    tangent = [guessed["tangent"].get(axis) for axis in "xyz"]
    if all(tangent):
        lines.append(f"tangent = {_toml_list(tangent)}")
    for key, pattern in (("time", TIME), ("sequence", SEQUENCE)):
        if column := next((c for c in columns if re.fullmatch(pattern + UNIT, c, re.IGNORECASE)), None):
            lines.append(f"{key} = {toml_value(column)}")
    lines += [
        "",
        "[units]",
        f'theta = "{_unit(theta, {"deg": "deg", "degrees": "deg"}, "rad")}"    # rad, deg or turns',
        f'l = "{_unit(l, {"mm": "mm"}, "m")}"        # m or mm',
        f'position = "{_unit(position, {"mm": "mm"}, "m")}"',
        "",
    ]
    return "\n".join(lines)


def _guessed(columns: Sequence[str]) -> dict[str, dict[str, str]]:
    """Columns of rotations and translations by the number in their names, of places and directions by their axis.

    A name is taken apart into words, numbers and a unit: "base2 angle [deg]", "theta_2_rad" and "rot2" are one thing.
    """
    result: dict[str, dict[str, str]] = {key: {} for key in ("theta", "l", "position", "tangent")}
    for column in columns:
        words = re.findall(r"[a-z]+|\d+", column.lower())
        numbers = [word for word in words if word.isdigit()]
        axes = [match for word in words if (match := AXIS.fullmatch(word))]
        if axes and not numbers:
            is_direction = axes[0][1] or {"t", "tan", "tangent", "dir", "direction", "d", "n"} & set(words)
            result["tangent" if is_direction else "position"].setdefault(axes[0][2], column)
        elif len(numbers) == 1 and (ANGLE | LENGTH) & set(words):
            result["theta" if ANGLE & set(words) else "l"].setdefault(numbers[0], column)
    return result


def _tubes(guessed: dict[str, str], n: int) -> list[str | None]:
    """A column for each tube, whose numbers may begin with 0."""
    first = 0 if "0" in guessed and str(n) not in guessed else 1
    return [guessed.get(str(first + k)) for k in range(n)]


def _toml_list(columns: Sequence[str | None]) -> str:
    return toml_value([column or "COLUMN" for column in columns]) + (
        "   # say those called COLUMN" if None in columns else ""
    )


def _unit(columns: Sequence[str | None], units: dict[str, str], usual: str) -> str:
    named = [re.search(r"(rad|degrees|deg|mm|m)\W*$", column or "", re.IGNORECASE) for column in columns]
    return next((units[match[1].lower()] for match in named if match and match[1].lower() in units), usual)
