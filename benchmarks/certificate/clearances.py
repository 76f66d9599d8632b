"""Are certified clearances true, and the same on both meshes?

    python benchmarks/run.py clearances claims [--robots 60] [--seed 0]
    python benchmarks/run.py clearances meshes [SCENARIO ...]

claims: random configurations of the three-tube robot at rest beside a sphere of 1 mm, which stands beside a random body
of a grid of 17 x 17 friction states, solved with exact geometry, at four distances from its centreline: from just
hit to a millimetre off. A claim is above the truth where the certificate states more clearance than the nearest body of
the grid has. meshes: the clearances of a plan of each scenario, certified on both meshes.
"""

import itertools
from collections.abc import Iterator

import common
import numpy as np
from common import ROBOTS, SCENARIOS, SHIPPED, table

import ctrplan
from ctrplan import Scenario, scenario_from_dict
from ctrplan.base.arrays import Array
from ctrplan.certificate.certify import certify
from ctrplan.certificate.walked_legs import walk_legs

ROBOT = ctrplan.load_robot(ROBOTS / "three_tube.toml")
STATES = np.array(list(itertools.product(np.linspace(-1, 1, 17), repeat=2)))
RADIUS_M = 1e-3
AWAY_M = (2.2e-3, 2.6e-3, 3.0e-3, 3.5e-3)  # of the sphere's centre from a centreline


def beside(joints: Array, center_m: Array) -> Scenario:
    """A scenario that rests at joints (m,) beside a sphere."""
    names = {joint.name: q / joint.si_per_unit for joint, q in zip(ROBOT.drive.joints, joints.tolist(), strict=True)}
    sphere = {"kind": "sphere", "center_mm": (center_m * 1e3).tolist(), "radius_mm": RADIUS_M * 1e3}
    content = {"robot": "three_tube.toml", "start": names, "goal": {"joints": names}, "anatomy": [sphere]}
    return scenario_from_dict(content, file=str(ROBOTS / "made_up.toml"))


def claims(rng: np.random.Generator) -> Iterator[tuple[float, float, bool]]:
    """Clearances stated and true [m], and whether certified, at a random configuration whose states are all solved."""
    joints = np.array([*np.radians(rng.uniform(-180, 180, 3)), rng.uniform(-60e-3, -5e-3)])
    bodies = ROBOT.mechanics.friction_bodies(*ROBOT.drive.collars(joints), STATES, accuracy="exact")
    if not bodies.solved.all():
        return
    for away_m in AWAY_M:
        side = rng.standard_normal(3)
        beside_m = bodies.point_m[rng.integers(len(STATES)), -1 - rng.integers(40)]
        center_m = beside_m + away_m * side / np.linalg.norm(side)
        walk = walk_legs(beside(joints, center_m), joints[None])
        true = (np.linalg.norm(bodies.point_m - center_m, axis=2) - RADIUS_M - bodies.radius_m).min()
        yield float(walk.samples.clearance_m.min()), float(true), not walk.problems


def print_claims(robots: int, seed: int) -> None:
    rngs = (np.random.default_rng([seed, number]) for number in range(robots))
    found = [claim for rng in rngs for claim in claims(rng)]
    valid = [(stated_m, true_m) for stated_m, true_m, is_valid in found if is_valid]
    above = [stated_m - true_m for stated_m, true_m in valid if stated_m > true_m]
    free = [is_valid for _, true_m, is_valid in found if true_m > 1e-3]
    print(f"{len(found)} scenes, {len(valid)} certified, {sum(true_m < 0 for _, true_m in valid)} of them hit")
    print(f"claims above the truth: {len(above)}, by {1e3 * max(above, default=0.0):.2f} mm at most")
    print(f"certified of those with more than 1 mm left: {sum(free)} of {len(free)}")


NAMES = ["airway", "heart_chamber", "ribs", "sinus", "ventricle", "vessel"]


def meshes(names: list[str]) -> Iterator[tuple[str, ...]]:
    """Clearances of the frictionless robot, of the worst friction state, and what is certified."""
    for name in names or NAMES:
        plan = ctrplan.plan(ctrplan.load_scenario(SCENARIOS / f"{name}.toml"))
        both = [certify(plan.scenario, plan.waypoints, accuracy=on) for on in ("search", "certificate")]
        lengths = zip(*((c.nominal.clearance_m, c.closest.clearance_m, c.min_clearance_m) for c in both), strict=True)
        yield name, *(f"{1e3 * coarse:.2f}, {1e3 * fine:.2f}" for coarse, fine in lengths)


def main() -> None:
    given = common.arguments(__doc__, ("section", ("claims", "meshes")), ("scenarios*", SHIPPED), robots=60, seed=0)
    if given.section == "claims":
        print_claims(given.robots, given.seed)
    else:
        head = "scenario | frictionless, mm: coarse, fine | any friction state | certified"
        table("clearances on both meshes", head, meshes(given.scenarios))
