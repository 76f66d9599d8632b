"""How accurate is the mechanics core, and how long does an answer take?

    python benchmarks/run.py mechanics [references] [pairs] [order] [meshes] [fineness] [gradients] [speed] [--count N]

All of them if none is named; --count says how many random configurations `meshes` and `fineness` look at. `gradients`
compares derivatives with central differences. References are in tests/reference, each with its own uncertainty. Times
are medians, of one core.
"""

import itertools
import json
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import common
import numpy as np
from bound_calls import nested_robot
from common import ROBOTS, ROOT, SCENARIOS, distance_mm, processors, table, took
from paper_pairs import table_3_joints
from scipy.spatial.transform import Rotation
from table_1_pair import table_1_pair

from ctrplan import MotionChecker, Status, load_robot, load_scenario
from ctrplan.base.arrays import Array
from ctrplan.mechanics.core import kernel_name
from ctrplan.mechanics.shapes import Accuracy
from ctrplan.mechanics.walk import PathDensity

THREE_TUBES = load_robot(ROBOTS / "three_tube.toml")
ACCURACIES: tuple[Accuracy, ...] = ("search", "certificate", "exact")
MESHES: tuple[Accuracy, ...] = ("search", "certificate")
Row = tuple[object, ...]


def read(name: str) -> Any:
    return json.loads((ROOT / "tests" / "reference" / name).read_text())


def references() -> None:
    """Tips of the three-tube robot against the references of tests/reference."""
    points = read("zero_clearance_points.json")["points"]
    both = [(THREE_TUBES.zero_clearance(p["theta_b_rad"], p["l_b_m"]), p) for p in points]
    off_nm = [1e6 * distance_mm(shape.tip_m, p["tip_m"]) for shape, p in both]
    tangents = [float(np.linalg.norm(shape.tip_tangent - p["tip_tangent"])) for shape, p in both]
    table("zero clearance", "points | largest tip error, nm | tangent", [(len(off_nm), max(off_nm), max(tangents))])

    rows: list[Row] = []
    signs, points = ["0,0", *map(",".join, itertools.product("+-", repeat=2))], read("three_tube_points.json")["points"]
    for accuracy in ACCURACIES:
        errors, beyond = [], []
        for p in points:
            bound = THREE_TUBES.bound(np.deg2rad(p["theta_b_deg"]), p["l_b_m"], accuracy=accuracy)
            for key, shape in zip(signs, (bound.frictionless, *bound.corners), strict=True):
                errors.append(distance_mm(shape.tip_m, p["tip_m"][key]))
                beyond.append(errors[-1] - 1e3 * p["uncertainty_m"][key])
        rows.append((accuracy, len(errors), *(f"{x:.3f}" for x in (np.median(errors), max(errors), max(beyond)))))
    head = "accuracy | tips | median, mm | largest, mm | largest beyond their uncertainty, mm"
    table("clearance and friction, three tubes", head, rows)


def pairs() -> None:
    """Tube pairs of Tables I and V against values of an independent exact-geometry solver."""
    data, rows = read("pair_values.json")["table_I_pair"], list[Row]()
    for clearance_m, accuracy in itertools.product((1e-5, 5e-5, 2.5e-4, 1e-3, 3e-3), ACCURACIES):
        lists = {key: given for key, given in data.items() if isinstance(given, list)}
        own = {key: [row for row in given if row["clearance_m"] == clearance_m] for key, given in lists.items()}
        free, stuck, entered = [], [], []
        for row in own["deviation_from_zero_clearance"]:
            shape = table_1_pair(clearance_m, 0).solve(*turned_pair(row["base_angle_deg"]), accuracy=accuracy)
            free.append(distance_mm(shape.tip_m, row["tip_m"]))
        for row in own["friction_at_180_deg"]:
            shape = table_1_pair(clearance_m, row["mu"]).solve(*turned_pair(180), 1, accuracy=accuracy)
            stuck.append((distance_mm(shape.tip_m, row["tip_m"]), 1e3 * row["deviation_m"]))
        for row in own["transmission_at_180_deg"]:
            model, length_m = table_1_pair(clearance_m, 0, row["transmission_m"]), row["transmission_m"]
            tip_m = model.solve(*turned_pair(180, length_m), accuracy=accuracy).tip_m
            entered.append(abs(distance_mm(tip_m, [0, 0, 0.15]) - 1e3 * row["deviation_m"]))
        share = 100 * max(error / deviation for error, deviation in stuck)
        largest = max(free), max(error for error, _ in stuck), max(entered)
        rows.append((f"{1e3 * clearance_m:g}", accuracy, *(f"{x:.4f}" for x in largest), f"{share:.2f}"))
    head = "clearance, mm | accuracy | frictionless, mm | friction, mm | transmission, mm | friction, % of deviation"
    table("Table I pair, largest tip errors", head, rows)

    robot, rows = load_robot(ROBOTS / "table_5_pair.toml"), []
    for accuracy in ACCURACIES:
        free, stuck_mm, angles = [], [], []
        for row in read("pair_values.json")["table_V_pair"]["rows"]:
            bound = robot.bound(*turned_pair(row["base_angle_deg"], 0.0604), accuracy=accuracy)
            free.append(distance_mm(bound.frictionless.tip_m, row["zero"]["tip_m"]))
            for name, shape in zip(("plus", "minus"), bound.corners, strict=True):
                outer, inner = shape.tubes
                stuck_mm.append(distance_mm(shape.tip_m, row[name]["tip_m"]))
                angle = np.rad2deg(np.interp(0.167, inner.s_m, inner.theta_rad) - outer.theta_rad[-1])
                angles.append(abs(angle - row[name]["relative_tip_angle_deg"]))
        rows.append((accuracy, *(f"{max(x):.4f}" for x in (free, stuck_mm, angles))))
    table("Table V pair, largest errors", "accuracy | frictionless, mm | friction, mm | relative tip angle, deg", rows)


def turned_pair(angle_deg: float, length_m: float = 0.017) -> tuple[Array, list[float]]:
    """Collars of a pair whose inner tube is turned against the outer one and drawn back."""
    return np.deg2rad([0.0, angle_deg]), [0.0, -length_m]


def order() -> None:
    """Geometric mean of tip errors of eighteen pairs with friction against 16 times shorter elements."""
    refinements, rows = np.array([0.25, 0.5, 1.0, 2.0, 4.0]), list[Row]()
    for accuracy in ACCURACIES[1:]:
        errors = []
        for clearance_m, angle_deg in itertools.product([5e-5, 2.5e-4, 1e-3], [40, 60, 90, 120, 150, 170]):
            model, q = table_1_pair(clearance_m, 0.2), turned_pair(angle_deg)
            tips = [model.solve(*q, 1.0, accuracy=accuracy, refinement=float(r)).tip_m for r in (*refinements, 16.0)]
            errors.append([distance_mm(tip, tips[-1]) for tip in tips[:-1]])
        mean = np.exp(np.log(errors).mean(0))
        slope = -np.polyfit(np.log(refinements), np.log(mean), 1)[0]
        rows.append((accuracy, *(f"{1e6 * error:.0f}" for error in mean), f"{slope:.2f}"))
    table("mean tip error by length of elements, nm", ("accuracy", *(f"1/{r:g}" for r in refinements), "order"), rows)


def meshes(count: int) -> None:
    """Search against certificate mesh on random configurations: the worst of the five tips of each."""
    worst = []
    for joints in zip(*random_joints(count), strict=True):
        coarse, fine = (five_tips(*joints, mesh, 1.0) for mesh in MESHES)
        if coarse is not None and fine is not None:
            worst.append(1e3 * float(np.linalg.norm(coarse - fine, axis=1).max()))
    error = np.array(worst)
    row = (len(error), *map(float, np.quantile(error, (0.5, 0.95, 0.99, 1.0))), f"{100 * np.mean(error > 0.3):.1f} %")
    table("search mesh off the grid, mm", "configurations | median | 95 % | 99 % | max | share > 0.3", [row])


def fineness(count: int) -> None:
    """Both meshes against one 6 times finer than the certificate's: worst of the five tips of each configuration."""
    rows = list[Row]()
    grid = [q for _, q in table_3_joints()]
    for label, of in (("grid of Table III", grid), ("random", list(zip(*random_joints(count), strict=True)))):
        errors: dict[Accuracy, list[float]] = {accuracy: [] for accuracy in MESHES}
        for joints in of:
            fine = five_tips(*joints, "certificate", 6.0)
            if fine is None:
                continue
            for accuracy in MESHES:
                tips = five_tips(*joints, accuracy, 1.0)
                off = np.nan if tips is None else 1e3 * float(np.linalg.norm(tips - fine, axis=1).max())
                errors[accuracy].append(off)
        for accuracy in MESHES:
            known = np.array(errors[accuracy])
            quantiles = map(float, np.nanquantile(known, (0.5, 0.95, 1.0)))
            rows.append((f"{label}, {accuracy}", len(known), int(np.isnan(known).sum()), *quantiles))
    table("discretisation error of tips, mm", " | configurations | failed | median | 95 % | max", rows)


def five_tips(theta_b: Array, l_b: Array, accuracy: Accuracy, refinement: float) -> Array | None:
    """Without friction and at every corner, (5, 3) m; none where one failed or the frictionless shape is unstable."""
    solve = partial(THREE_TUBES.mechanics.solve, theta_b, l_b, accuracy=accuracy, refinement=refinement)
    shapes = [solve(state) for state in [(0.0, 0.0), *itertools.product((1.0, -1.0), repeat=2)]]
    if any(shape.status is Status.FAILED for shape in shapes) or shapes[0].status is Status.UNSTABLE:
        return None
    return np.array([shape.tip_m for shape in shapes])


def random_joints(count: int) -> tuple[Array, Array]:
    """Rotations anywhere, tube 3 between fully retracted and fully extended."""
    rng = np.random.default_rng(0)
    l_b = np.tile([0.0, -0.017, 0.0], (count, 1))
    l_b[:, 2] = rng.uniform(-0.1204, -0.034, count)
    return rng.uniform(-np.pi, np.pi, (count, 3)), l_b


def times_ms(work: Callable[..., object], *arguments: Array) -> Array:
    """Times of one call per row of the arguments."""
    work(*(rows[0] for rows in arguments))
    return np.array([1e3 * took(work, *row)[0] for row in zip(*arguments, strict=True)])


def path_ms(theta_step: float, l_step: float) -> Array:
    """Per sample after the first, of legs with 60 steps through ordinary configurations."""
    density = PathDensity(rotation_rad=np.deg2rad(1) * 1.001, translation_m=0.5005e-3)
    starts, taken = random_joints(40), list[float]()
    for theta_b, l_b in zip(*starts, strict=True):
        l_b[2] = np.clip(l_b[2], -0.12, -0.065)
        ends = [theta_b, theta_b + [0, 0, 60 * theta_step]], [l_b, l_b + [0, 0, 60 * l_step]]
        first = times_ms(lambda a, b: THREE_TUBES.mechanics.check_path([a], [b]), *(np.array(e)[:1] for e in ends))[0]
        start = time.perf_counter()
        samples = THREE_TUBES.mechanics.check_path(*ends, density=density)
        if samples.fraction[-1] == 1 and np.all(samples.status == Status.CONVERGED):
            taken.append((1e3 * (time.perf_counter() - start) - first) / (len(samples.fraction) - 1))
    return np.array(taken)


def zero_clearance_ms(q: tuple[Array, Array]) -> Array:
    """Per configuration, tips of batches on one thread."""
    tips = partial(THREE_TUBES.mechanics.tips, threads=1)
    batches = zip(*(np.split(part, 20) for part in q), strict=True)
    return np.array([1e3 * took(tips, *batch)[0] / len(batch[0]) for batch in batches])


def speed() -> None:
    """Three-tube robot, four corners and the frictionless solution per bound."""
    print(f"\n{processors()}, kernel {kernel_name()}")
    q = random_joints(1000)
    few = q[0][:200], q[1][:200]
    measured = {
        "zero clearance, cold, tips of a batch": zero_clearance_ms(q),
        "zero clearance, Robot.zero_clearance": times_ms(THREE_TUBES.zero_clearance, *q),
        "bound, cold, Robot.bound": times_ms(THREE_TUBES.bound, *q),
        "bound, cold, certificate mesh": times_ms(partial(THREE_TUBES.bound, accuracy="certificate"), *few),
        "bound, cold, exact": times_ms(partial(THREE_TUBES.bound, accuracy="exact"), *(part[:50] for part in few)),
        "along a path, 1 deg a step": path_ms(np.deg2rad(1), 0),
        "along a path, 0.5 mm a step": path_ms(0, 0.5e-3),
    }
    rows = [(name, len(t), float(t.min()), *map(float, np.quantile(t, (0.5, 0.99)))) for name, t in measured.items()]
    table("milliseconds", " | samples | least | median | 99 %", rows)


GRADIENT_STATES = 40  # of each robot
BY_PARAMETERS = {
    "tube.1.bending_stiffness_Nm2": 1e-5,
    "tube.2.poisson_ratio": 1e-4,
    "tube.2.section.2.curvature_y_per_m": 1e-5,
    "contact.1.friction_coefficient": 1e-5,
}  # and steps as shares of their values
Values = Callable[[str, int, float], dict[str, Array]]  # (K, ...) by quantity, at a step along one of the variables


def error_rows(what: str, values: Values, by: dict[str, dict[str, Array]], steps: dict[str, Array]) -> list[Row]:
    """For each quantity and variable the errors of derivatives `by` (K, ..., V), of the largest of each state.

    Left out and counted are states where differences across two steps disagree: the mesh or the active branch changes.
    """
    rows: list[Row] = []
    for variable, lengths in steps.items():
        off: dict[str, list[Array]] = {name: [] for name in by}
        apart: dict[str, list[Array]] = {name: [] for name in by}
        for j, step in enumerate(lengths.tolist()):
            ends = [(values(variable, j, h), values(variable, j, -h)) for h in (step, step / 2)]
            for name in by:
                wide, narrow = (
                    (up[name] - down[name]) / (2 * h) for (up, down), h in zip(ends, (step, step / 2), strict=True)
                )
                for kept, part in ((off, narrow - by[name][variable][..., j]), (apart, wide - narrow)):
                    kept[name].append(np.abs(part).reshape(len(part), -1).max(axis=1))
        for name in by:
            size = np.abs(by[name][variable]).reshape(len(by[name][variable]), -1).max(axis=1)
            if not size.any():
                continue
            share, doubt = (np.max(part[name], axis=0) / np.maximum(size, 1e-300) for part in (off, apart))
            smooth = doubt < 1e-5
            errors = share[smooth]
            rows.append((what, name, variable, f"{np.median(errors):.0e}", f"{errors.max():.0e}", int((~smooth).sum())))
    return rows


def gradients() -> None:
    """Prints errors of derivatives of bounds and tips of nested robots, and of clearances of shipped scenarios."""
    rows: list[Row] = []
    for n in (2, 3, 4):
        robot, random = nested_robot(n), np.random.default_rng(n)
        apart = random.uniform(5.5e-3, 10e-3, (GRADIENT_STATES, n))
        place = {"rotations": random.uniform(-np.pi, np.pi, (GRADIENT_STATES, n)), "translations": -np.cumsum(apart, 1)}

        def quantities(robot: Any, where: Any) -> Any:
            return robot.bounds(*where.values(), gradient=True, parameters=list(BY_PARAMETERS)).gradient

        def values(variable: str, j: int, step: float, robot: Any = robot, place: Any = place) -> dict[str, Array]:
            moved = dict(place)
            if variable == "parameters":
                name = list(BY_PARAMETERS)[j]
                robot = robot.with_(f"{name}={value_in(robot.content, name) + step!r}")
            else:
                moved[variable] = place[variable] + step * np.eye(place[variable].shape[1])[j]
            found = quantities(robot, moved)
            return {name: getattr(found, name).value for name in KNOWN}

        here = quantities(robot, place)
        keys = {"rotations": "theta_b", "translations": "l_b", "parameters": "parameters"}
        by = {name: {kind: getattr(getattr(here, name), key) for kind, key in keys.items()} for name in KNOWN}
        shares = [share * value_in(robot.content, name) for name, share in BY_PARAMETERS.items()]
        steps = {"rotations": np.full(n, 2e-5), "translations": np.full(n, 1e-6), "parameters": np.array(shares)}
        rows += error_rows(f"{n} tubes", values, by, steps)
    for scenario in ("vessel", "sinus", "heart_chamber"):
        rows += clearance_rows(scenario)
    table("gradients", f"robot | quantity | by | median error | worst | not smooth, of {GRADIENT_STATES}", rows)


KNOWN = ("position_m", "tangent_rad", "stability", "tip_m")


def value_in(content: Any, name: str) -> float:
    """What a robot file says of a number."""
    for part in name.split("."):
        content = content[int(part) - 1] if part.isdecimal() else content[part]
    return float(content)


def clearance_rows(name: str) -> list[Row]:
    """By joints and by the base pose."""
    scenario = load_scenario(SCENARIOS / f"{name}.toml")
    checker = MotionChecker(scenario)
    q = checker.space.sample(np.random.default_rng(0), GRADIENT_STATES)
    turns, here = checker.space.drive.is_rotation, checker.clearance(q, gradient=True)
    kinds = {"rotations": np.flatnonzero(turns), "translations": np.flatnonzero(~turns)}

    def values(variable: str, j: int, step: float) -> dict[str, Array]:
        unit, own, moved = step * np.eye(3)[min(j, 2)], checker, q
        if variable in kinds:
            moved = q + step * np.eye(q.shape[1])[kinds[variable][j]]
        else:
            R = Rotation.from_rotvec(unit * (variable == "base rotation")).as_matrix() @ scenario.base_R
            place = scenario.base_position_m + unit * (variable == "base position")
            own = MotionChecker(replace(scenario, base_R=R, base_position_m=place))
        return {"clearance_m": own.clearance(moved, gradient=True).clearance_m}

    by = {kind: here.by_joints[:, columns] for kind, columns in kinds.items()}
    by |= {"base position": here.by_base_position, "base rotation": here.by_base_rotation}
    steps = {"rotations": 2e-5, "translations": 1e-6, "base position": 1e-6, "base rotation": 1e-5}
    lengths = {kind: np.full(by[kind].shape[1], step) for kind, step in steps.items()}
    return error_rows(name, values, {"clearance_m": by}, lengths)


def main() -> None:
    known = {"references": references, "pairs": pairs, "order": order, "gradients": gradients, "speed": speed}
    counted = {"meshes": lambda: meshes(given.count), "fineness": lambda: fineness(given.count)}
    given = common.arguments(__doc__, ("sections*", [*known, *counted]), count=1000)
    common.sections(given.sections, {**known, **counted})
