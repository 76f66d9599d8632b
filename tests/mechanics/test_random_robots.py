"""No silent wrong answers: solutions of random robots checked by statics, from nothing but the shapes returned."""

from __future__ import annotations

import numpy as np
import pytest

from ctrplan.base.arrays import Array
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.shapes import Shape, Status
from ctrplan.mechanics.tube import Tube, TubeSection

ROBOTS = 200


class RandomRobot:
    """2 to 4 tubes bent anyhow, one in five retracted; clearances from 0.01 mm to 3 mm or 2 % of the radius."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        n = 2 + seed % 3
        gap_m, step_m = (0.006, 0.002) if rng.random() < 0.2 else (0.04, 0.04)
        base_m, tip_m = np.zeros(n), np.zeros(n)
        base_m[0], tip_m[0] = -rng.uniform(0, 0.02), rng.uniform(0.05, 0.12)
        for i in range(1, n):
            base_m[i] = base_m[i - 1] - rng.uniform(0.005, gap_m)
            tip_m[i] = tip_m[i - 1] + rng.uniform(0, step_m)
        bend = np.stack([rng.uniform(-1, 1, n), rng.uniform(-15, 15, n)], axis=1)
        most_m = np.minimum(3e-3, 0.02 / np.maximum(*(np.linalg.norm(bend, axis=1)[k : n - 1 + k] for k in (0, 1))))
        self.clearance_m = 1e-5 * (most_m / 1e-5) ** rng.random(n - 1)
        self.friction = rng.uniform(0, 0.5, n - 1)
        self.theta_b, self.l_b = rng.uniform(-np.pi, np.pi, n), base_m
        self.phi = rng.choice([-1.0, 0.0, 1.0, 0.5], n - 1)
        tubes: list[Tube] = []
        bore_m = 1e-3
        for i in reversed(range(n)):
            outside_m = bore_m + rng.uniform(2e-4, 4e-4)
            curved_m = rng.uniform(0.3, 0.9) * tip_m[i]
            sections = (
                TubeSection(tip_m[i] - base_m[i] - curved_m, 0.0, 0.0),
                TubeSection(curved_m, *bend[i].tolist()),
            )
            tubes.insert(0, Tube(outside_m, bore_m, 10 ** rng.uniform(-3, -1), rng.uniform(-0.3, 0.5), sections, 0.004))
            bore_m = outside_m + 2 * self.clearance_m[i - 1]
        self.tubes = tuple(tubes)

    def solve(self) -> Shape:
        model = Mechanics(self.tubes, self.clearance_m, self.friction)
        return model.solve(self.theta_b, self.l_b, self.phi, accuracy="certificate")


def worst_imbalance(robot: RandomRobot, shape: Shape) -> tuple[float, float]:
    """What forces beyond a station miss of its bending moment, and torques of its torque, over the largest EI u_hat.

    Root mean squares over stations, of the worst tube.
    """
    scale = max(tube.bending_stiffness_Nm2 * tube.sections[-1].curvature_per_m for tube in robot.tubes)
    bending, torsion = 0.0, 0.0
    for i, (tube, line) in enumerate(zip(robot.tubes, shape.tubes, strict=True)):
        c, s = np.cos(line.theta_rad), np.sin(line.theta_rad)
        turned = lambda a, b, c=c, s=s: np.stack([c * a - s * b, s * a + c * b], axis=1)  # noqa: E731
        rate = turned(line.curvature_per_m[:, 0], line.curvature_per_m[:, 1])
        kappa = np.stack([rate[:, 1], -rate[:, 0]], axis=1)
        joint = robot.l_b[i] + tube.sections[0].length_m
        curved = line.s_m > joint + 1e-9
        w = turned(
            *(np.where(curved, v, 0) for v in (tube.sections[1].curvature_y_per_m, -tube.sections[1].curvature_x_per_m))
        )
        moment = tube.bending_stiffness_Nm2 * (kappa - w)
        density = moment[:, 1] * w[:, 0] - moment[:, 0] * w[:, 1]
        torque = np.append(np.cumsum((0.5 * (density[1:] + density[:-1]) * np.diff(line.s_m))[::-1])[::-1], 0)
        expected = np.zeros_like(moment)
        for pair, sign, arm_m in ((i, 1, tube.inner_diameter_m / 2), (i - 1, -1, tube.outer_diameter_m / 2)):
            if 0 <= pair < len(robot.tubes) - 1:
                force, friction = pushes(robot, shape, pair)
                at_m = shape.contact_s_m[pair]
                expected += sign * np.maximum(at_m - line.s_m[:, None], 0) @ force
                torque += sign * arm_m * (at_m > line.s_m[:, None] + 1e-12) @ friction
        inside = (line.s_m > 1e-3) & (np.abs(line.s_m - joint) > 1e-9)
        bending = max(bending, rms(np.linalg.norm(moment - expected, axis=1)[inside]) / scale)
        twist = tube.bending_stiffness_Nm2 / (1 + tube.poisson_ratio) * line.curvature_per_m[1:, 2]
        torsion = max(torsion, rms(twist - 0.5 * (torque[1:] + torque[:-1])) / scale)
    return bending, torsion


def pushes(robot: RandomRobot, shape: Shape, pair: int) -> tuple[Array, Array]:
    """Force (M, 2) on the outer tube and circumferential share (M,) of the contacts of a pair, (38)."""
    force, angle, share = (
        shape.contact_force_N[pair],
        shape.contact_angle_rad[pair],
        robot.friction[pair] * robot.phi[pair],
    )
    leaning, across = (
        np.stack([np.cos(angle), np.sin(angle)], axis=1),
        np.stack([-np.sin(angle), np.cos(angle)], axis=1),
    )
    return force[:, None] * (leaning + share * across), share * force


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module")
def imbalances() -> Array:
    robots = [RandomRobot(seed) for seed in range(ROBOTS)]
    shapes = [robot.solve() for robot in robots]
    assert all(shape.status is not Status.FAILED and shape.residual < 1e-8 for shape in shapes)
    return np.array([worst_imbalance(robot, shape) for robot, shape in zip(robots, shapes, strict=True)])


def test_forces_carry_the_bending_of_every_tube(imbalances: Array) -> None:
    assert imbalances[:, 0].max() <= 0.006


def test_friction_carries_the_twist_of_every_tube(imbalances: Array) -> None:
    assert imbalances[:, 1].max() <= 0.006
