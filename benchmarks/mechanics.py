"""How accurate is the mechanics core, and how long does an answer take?

    python benchmarks/mechanics.py [references] [pairs] [table3] [meshes] [fineness] [speed] [--count N]

All of them if none is named; --count says how many random configurations `meshes` and `fineness` look at.

References are in tests/reference, each with its own uncertainty. Times are of one core unless a row says otherwise;
medians, because the machine may be doing other things.
"""

import argparse
import itertools
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.accuracy import Accuracy
from ctrplan.mechanics.core import kernel_name
from ctrplan.mechanics.shapes import Shape, Status
from ctrplan.mechanics.walk import PathDensity

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests" / place) for place in ("oracles", "support")]
from table_1_pair import table_1_pair  # noqa: E402

ROBOTS = ROOT / "scenarios" / "robots"
THREE_TUBES = load_robot(ROBOTS / "three_tube.toml")
ACCURACIES: tuple[Accuracy, ...] = ("search", "certificate")
Row = tuple[object, ...]
JOINTS = [f"{name}.{tube}" for name in ("theta_b", "l_b") for tube in (1, 2, 3)]
NUMBERS = [  # everything of the three-tube robot that its frictionless or frictional shape depends on
    *JOINTS,
    *(f"tube.{tube}.{key}" for tube in (1, 2, 3) for key in ("bending_stiffness_Nm2", "poisson_ratio")),
    *(
        f"tube.{tube}.section.{section}.{key}"
        for tube, sections in ((1, 1), (2, 2), (3, 2))
        for section in range(1, sections + 1)
        for key in ("length_m", "curvature_x_per_m", "curvature_y_per_m")
    ),
    *(f"contact.{pair}.{key}" for pair in (1, 2) for key in ("clearance_m", "friction_coefficient")),
]
TABLE_3 = {  # mean and max position [mm], mean and max tangent [deg]; "exact" is this grid by an exact-geometry solver
    False: {"paper": (1.8, 4.2, 2.7, 5.1), "exact": (1.68, 4.15, 2.64, 5.06)},
    True: {"paper": (6.1, 23.8, 10.7, 45.6), "exact": (5.89, 23.89, 10.20, 45.57)},
}


def read(name: str) -> Any:
    return json.loads((ROOT / "tests" / "reference" / name).read_text())


def table(title: str, head: tuple[str, ...], rows: Sequence[Row]) -> None:
    """Prints rows; numbers with three significant digits."""
    cells = [head, *(tuple(f"{x:.3g}" if isinstance(x, float) else str(x) for x in row) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    print(f"\n{title}")
    for row in cells:
        print(
            "  ".join(
                cell.ljust(w) if k == 0 else cell.rjust(w) for k, (cell, w) in enumerate(zip(row, widths, strict=True))
            )
        )


def distance(a: Any, b: Any) -> float:
    return float(np.linalg.norm(np.subtract(a, b)))


def references() -> None:
    """Tips of the three-tube robot against the references."""
    points = read("zero_clearance_points.json")["points"]
    shapes = [THREE_TUBES.zero_clearance(p["theta_b_rad"], p["l_b_m"]) for p in points]
    tips = [1e9 * distance(shape.tip_m, p["tip_m"]) for shape, p in zip(shapes, points, strict=True)]
    tangents = [distance(shape.tip_tangent, p["tip_tangent"]) for shape, p in zip(shapes, points, strict=True)]
    table("zero clearance", ("points", "max tip nm", "max tangent rad"), [(len(tips), max(tips), max(tangents))])

    rows: list[Row] = []
    signs = ["0,0", *(",".join(row) for row in itertools.product("+-", repeat=2))]
    for accuracy in ACCURACIES:
        errors, beyond = [], []
        for p in read("three_tube_points.json")["points"]:
            bound = THREE_TUBES.bound(np.deg2rad(p["theta_b_deg"]), p["l_b_m"], accuracy=accuracy)
            for key, shape in zip(signs, (bound.frictionless, *bound.corners), strict=True):
                errors.append(1e3 * distance(shape.tip_m, p["tip_m"][key]))
                beyond.append(errors[-1] - 1e3 * p["uncertainty_m"][key])
        rows.append((accuracy, len(errors), float(np.median(errors)), max(errors), max(beyond)))
    table("clearance and friction", ("mesh", "tips", "median mm", "max mm", "max beyond uncertainty mm"), rows)


def pairs() -> None:
    """Tube pairs of Tables I and V; errors in proportion to the clearance are those of the model's geometry."""
    data = read("pair_values.json")["table_I_pair"]
    rows: list[Row] = []
    for clearance_m, accuracy in itertools.product((1e-5, 5e-5, 2.5e-4, 1e-3, 3e-3), ACCURACIES):
        free, stuck, entered = [], [], []
        for row in data["deviation_from_zero_clearance"]:
            if row["clearance_m"] == clearance_m:
                q = np.deg2rad([0, row["base_angle_deg"]]), [0, -0.017]
                free.append(distance(table_1_pair(clearance_m, 0).solve(*q, accuracy=accuracy).tip_m, row["tip_m"]))
        for row in data["friction_at_180_deg"]:
            if row["clearance_m"] == clearance_m:
                shape = table_1_pair(clearance_m, row["mu"]).solve([0, np.pi], [0, -0.017], 1, accuracy=accuracy)
                stuck.append((distance(shape.tip_m, row["tip_m"]), row["deviation_m"]))
        for row in data["transmission_at_180_deg"]:
            if row["clearance_m"] == clearance_m:
                model = table_1_pair(clearance_m, 0, row["transmission_m"])
                tip_m = model.solve([0, np.pi], [0, -row["transmission_m"]], accuracy=accuracy).tip_m
                entered.append(abs(distance(tip_m, [0, 0, 0.15]) - row["deviation_m"]))
        share = 100 * max(error / deviation for error, deviation in stuck)
        rows.append((f"{1e3 * clearance_m:g}", accuracy, 1e3 * max(free), max(free) / clearance_m,
                     1e3 * max(error for error, _ in stuck), share, 1e3 * max(entered)))  # fmt: skip
    head = (
        "clearance mm",
        "mesh",
        "frictionless mm",
        "over clearance",
        "friction mm",
        "% of deviation",
        "transmission mm",
    )
    table("Table I pair, largest tip errors", head, rows)

    table_5()


def table_5() -> None:
    """Bounding solutions of the path-history pair."""
    robot, rows = load_robot(ROBOTS / "table_5_pair.toml"), list[Row]()
    for accuracy in ACCURACIES:
        free, stuck, turned = [], [], []
        for row in read("pair_values.json")["table_V_pair"]["rows"]:
            bound = robot.bound(np.deg2rad([0, row["base_angle_deg"]]), [0, -0.0604], accuracy=accuracy)
            free.append(1e3 * distance(bound.frictionless.tip_m, row["zero"]["tip_m"]))
            for name, shape in zip(("plus", "minus"), bound.corners, strict=True):
                outer, inner = shape.tubes
                stuck.append(1e3 * distance(shape.tip_m, row[name]["tip_m"]))
                angle = np.rad2deg(np.interp(0.167, inner.s_m, inner.theta_rad) - outer.theta_rad[-1])
                turned.append(abs(angle - row[name]["relative_tip_angle_deg"]))
        rows.append((accuracy, max(free), max(stuck), max(turned)))
    table("Table V pair, largest errors", ("mesh", "frictionless mm", "friction mm", "relative tip angle deg"), rows)


def table3() -> None:
    """Deviations from the zero-clearance model on the 4 x 4 x 4 grid, and what the search mesh adds."""
    deviation: dict[tuple[Accuracy, bool], tuple[list[float], list[float]]] = {}
    mesh_mm, unstable, failed = list[float](), 0, 0
    for q in zip(*table_3_grid(), strict=True):
        zero = THREE_TUBES.zero_clearance(*q)
        coarse, fine = both = [THREE_TUBES.bound(*q, accuracy=accuracy) for accuracy in ACCURACIES]
        for accuracy, bound in zip(ACCURACIES, both, strict=True):
            failed += sum(shape.status is Status.FAILED for shape in bound.corners)
            for friction, shapes in ((False, (bound.frictionless,)), (True, bound.corners)):
                for shape in shapes:
                    if shape.status is not Status.FAILED:
                        record(deviation.setdefault((accuracy, friction), ([], [])), shape, zero)
        if coarse.frictionless.status is Status.UNSTABLE:
            unstable += 1
        else:
            pairs = zip((coarse.frictionless, *coarse.corners), (fine.frictionless, *fine.corners), strict=True)
            mesh_mm.append(1e3 * max(distance(a.tip_m, b.tip_m) for a, b in pairs))
    rows: list[Row] = []
    for friction, given in TABLE_3.items():
        label = "friction" if friction else "clearance"
        rows += [(f"{label}, {name}", *map(float, values)) for name, values in given.items()]
        for accuracy in ACCURACIES:
            position, tangent = map(np.array, deviation[accuracy, friction])
            mine = (position.mean(), position.max(), tangent.mean(), tangent.max())
            worst = max(abs(a / b - 1) for a, b in zip(mine, given["exact"], strict=True))
            rows.append((f"{label}, ours {accuracy} ({100 * worst:.1f} % off)", *map(float, mine)))
    table("Table III", ("", "mean mm", "max mm", "mean deg", "max deg"), rows)
    table(
        "search against certificate on that grid, worst tip of a configuration",
        ("median mm", "max mm", "unstable, left out", "failed corners"),
        [(float(np.median(mesh_mm)), max(mesh_mm), unstable, failed)],
    )


def table_3_grid() -> tuple[Array, Array]:
    """Base angles of tubes 2 and 3 by quarter turns, tube 3 from retracted to extended in four places."""
    quarters = np.deg2rad([0, 90, 180, 270])
    joints = itertools.product(quarters, quarters, np.linspace(-0.1204, -0.034, 4))
    made = [((0, second, second + third), (0, -0.017, l_3)) for second, third, l_3 in joints]
    return np.array([theta_b for theta_b, _ in made], float), np.array([l_b for _, l_b in made], float)


def meshes(count: int) -> None:
    """Search against certificate mesh on random configurations: the worst of the five tips of each."""
    worst = []
    for theta_b, l_b in zip(*random_joints(count), strict=True):
        coarse, fine = THREE_TUBES.bound(theta_b, l_b), THREE_TUBES.bound(theta_b, l_b, accuracy="certificate")
        if np.isfinite(coarse.position_m + fine.position_m) and coarse.frictionless.stability > 0:
            shapes = zip((coarse.frictionless, *coarse.corners), (fine.frictionless, *fine.corners), strict=True)
            worst.append(max(distance(a.tip_m, b.tip_m) * 1e3 for a, b in shapes))
    error = np.array(worst)
    row = (len(error), *map(float, np.quantile(error, (0.5, 0.95, 0.99, 1.0))), float(np.mean(error > 0.3)))
    table("search mesh off the grid, mm", ("configurations", "median", "95 %", "99 %", "max", "share > 0.3"), [row])


def fineness(count: int) -> None:
    """Both meshes against one 6 times finer than the certificate's: worst of the five tips of each configuration."""
    rows = list[Row]()
    for label, q in (("grid of Table III", table_3_grid()), ("random", random_joints(count))):
        errors: dict[Accuracy, list[float]] = {accuracy: [] for accuracy in ACCURACIES}
        for joints in zip(*q, strict=True):
            fine = five_tips(*joints, "certificate", 6.0)
            if fine is None:
                continue
            for accuracy in ACCURACIES:
                tips = five_tips(*joints, accuracy, 1.0)
                errors[accuracy].append(
                    np.nan if tips is None else 1e3 * float(np.linalg.norm(tips - fine, axis=1).max())
                )
        for accuracy in ACCURACIES:
            known = np.array(errors[accuracy])
            quantiles = map(float, np.nanquantile(known, (0.5, 0.95, 1.0)))
            rows.append((f"{label}, {accuracy}", len(known), int(np.isnan(known).sum()), *quantiles))
    table("discretisation error of tips, mm", ("", "configurations", "failed", "median", "95 %", "max"), rows)


def five_tips(theta_b: Array, l_b: Array, accuracy: Accuracy, refinement: float) -> Array | None:
    """Without friction and at every corner, (5, 3) m; none where one failed or the frictionless shape is unstable."""
    shapes = [
        THREE_TUBES.mechanics.solve(theta_b, l_b, state, accuracy=accuracy, refinement=refinement)
        for state in [(0.0, 0.0), *itertools.product((1.0, -1.0), repeat=2)]
    ]
    if any(shape.status is Status.FAILED for shape in shapes) or shapes[0].status is Status.UNSTABLE:
        return None
    return np.array([shape.tip_m for shape in shapes])


def record(into: tuple[list[float], list[float]], shape: Shape, zero: Shape) -> None:
    into[0].append(1e3 * distance(shape.tip_m, zero.tip_m))
    u, v = shape.tip_tangent, zero.tip_tangent
    into[1].append(float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v))))


def random_joints(count: int) -> tuple[Array, Array]:
    """Rotations anywhere, tube 3 between fully retracted and fully extended."""
    rng = np.random.default_rng(0)
    l_b = np.tile([0.0, -0.017, 0.0], (count, 1))
    l_b[:, 2] = rng.uniform(-0.1204, -0.034, count)
    return rng.uniform(-np.pi, np.pi, (count, 3)), l_b


def times_ms(work: Callable[..., object], *arguments: Array) -> Array:
    """Of one call per row of the arguments."""
    work(*(rows[0] for rows in arguments))
    taken = []
    for row in zip(*arguments, strict=True):
        start = time.perf_counter()
        work(*row)
        taken.append(1e3 * (time.perf_counter() - start))
    return np.array(taken)


def batches_ms(theta_b: Array, l_b: Array) -> dict[int, Array]:
    """Per configuration, one and two threads in turn, so that both see the same machine."""
    taken: dict[int, list[float]] = {1: [], 2: []}
    for q, threads in itertools.product(zip(np.split(theta_b, 10), np.split(l_b, 10), strict=True), taken):
        start = time.perf_counter()
        THREE_TUBES.bound_many(*q, threads=threads)
        taken[threads].append(1e3 * (time.perf_counter() - start) / len(q[0]))
    return {threads: np.array(times) for threads, times in taken.items()}


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


def tips_ms(q: tuple[Array, Array], parameters: Sequence[str] = ()) -> Array:
    """Per configuration, tips of the frictionless state and the four corners on one thread."""
    states = np.array([(0, 0), *itertools.product((1, -1), repeat=2)])

    def tips(theta_b: Array, l_b: Array) -> object:
        rows = np.tile(theta_b, (len(states), 1)), np.tile(l_b, (len(states), 1))
        return THREE_TUBES.mechanics.tips_with_friction(*rows, states, parameters=parameters, threads=1)

    return times_ms(tips, *q)


def zero_clearance_ms(q: tuple[Array, Array]) -> Array:
    """Per configuration, tips of batches on one thread."""
    taken = []
    for theta_b, l_b in zip(np.split(q[0], 20), np.split(q[1], 20), strict=True):
        start = time.perf_counter()
        THREE_TUBES.mechanics.tips(theta_b, l_b, threads=1)
        taken.append(1e3 * (time.perf_counter() - start) / len(theta_b))
    return np.array(taken)


def import_ms(count: int = 5) -> Array:
    """Of ctrplan in a fresh interpreter, numpy being there already."""
    code = "import time, numpy; a = time.perf_counter(); import ctrplan; print(time.perf_counter() - a)"
    run = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True) for _ in range(count)
    ]
    return 1e3 * np.array([float(done.stdout) for done in run])


def speed() -> None:
    """Three-tube robot, four corners and the frictionless solution per bound."""
    print(f"\n{os.cpu_count()} CPUs, load {os.getloadavg()[0]:.1f}, kernel {kernel_name()}")
    q = random_joints(1000)
    few = q[0][:200], q[1][:200]
    batches = batches_ms(*q)
    plain, derived, by_all = tips_ms(few), tips_ms(few, JOINTS), tips_ms(few, NUMBERS)
    measured = {
        "zero clearance, cold, tips of a batch": zero_clearance_ms(q),
        "zero clearance, Robot.zero_clearance": times_ms(THREE_TUBES.zero_clearance, *q),
        "bound, cold, Robot.bound": times_ms(THREE_TUBES.bound, *q),
        "bound, cold, certificate mesh": times_ms(lambda *p: THREE_TUBES.bound(*p, accuracy="certificate"), *few),
        "bound_many, 1 thread": batches[1],
        f"bound_many, 2 threads (at best {batches[1].min() / batches[2].min():.2f} x)": batches[2],
        "along a path, 1 deg a step": path_ms(np.deg2rad(1), 0),
        "along a path, 0.5 mm a step": path_ms(0, 0.5e-3),
        "tips of the five states": plain,
        f"the same by all joints ({np.median(derived) / np.median(plain):.2f} x)": derived,
        f"the same by {len(NUMBERS)} numbers ({np.median(by_all) / np.median(plain):.2f} x)": by_all,
        "import ctrplan": import_ms(),
    }
    rows = [(name, len(t), float(t.min()), *map(float, np.quantile(t, (0.5, 0.99)))) for name, t in measured.items()]
    table("milliseconds", ("", "samples", "least", "median", "99 %"), rows)
    nodes()


def nodes() -> None:
    """Cost against the number of nodes: both meshes, time per node."""
    q, rows = random_joints(100), list[Row]()
    for accuracy in ACCURACIES:
        count = np.mean(
            [len(THREE_TUBES.bound(*p, accuracy=accuracy).frictionless.tubes[-1].s_m) for p in zip(*q, strict=True)]
        )
        taken = [time_of(lambda a=accuracy: THREE_TUBES.bound_many(*q, accuracy=a, threads=1)) for _ in range(3)]
        rows.append((accuracy, float(count), 1e3 * min(taken) / len(q[0]), 1e6 * min(taken) / len(q[0]) / float(count)))
    table("cost against nodes, bound_many on one thread", ("mesh", "nodes", "ms", "us a node"), rows)


def time_of(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Accuracy and speed of the mechanics core.")
    parser.add_argument("section", nargs="*", help="references, pairs, table3, meshes, fineness, speed (default: all)")
    help_count = "random configurations of meshes and fineness (default: %(default)s)"
    parser.add_argument("--count", type=int, default=1000, help=help_count)
    given = parser.parse_args()
    sections: dict[str, Callable[[], None]] = {
        "references": references,
        "pairs": pairs,
        "table3": table3,
        "meshes": lambda: meshes(given.count),
        "fineness": lambda: fineness(given.count),
        "speed": speed,
    }
    if unknown := set(given.section) - set(sections):
        parser.error(f"no section {', '.join(sorted(unknown))}")
    for name in given.section or sections:
        sections[name]()
