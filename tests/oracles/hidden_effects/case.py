"""A case: seed, hidden effects with their sizes, noise, experiment; and the folder that a laboratory hands over."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hidden_effects import effects, experiment
from hidden_effects.chain import Poses, poses
from hidden_effects.dataset import measurements_csv, robot_toml, write_folder
from hidden_effects.leftover import leftover_over_noise
from hidden_effects.leftovers import Leftover, add_leftover
from hidden_effects.noise import add_noise
from hidden_effects.world import ROBOTS, Ordinary, World, draw_ordinary

SOFTENING = {"nonlinear_elasticity", "shaft_torsion", "ovality"}  # effects that make the robot snap earlier
CALMER = 2.2  # stability of the configurations they are measured in


@dataclass(frozen=True)
class Case:
    """`hidden`: (name, size) pairs; `row`: the line of the table of goals that the case counts for."""

    name: str
    row: str
    seed: int
    hidden: tuple[tuple[str, float], ...] = ()
    noise: str = "gaussian"
    count: int = 15  # configurations, or rows of a continuous motion
    continuous: bool = False
    left_out: str = ""  # an effect that the diagnosis' catalogue has to do without
    robot: str = "three tubes"
    left: Leftover = Leftover()  # smooth errors besides, that nothing explains

    def believed(self) -> World:
        """What the user's robot file says."""
        return ROBOTS[self.robot]()


@dataclass(frozen=True)
class Made:
    """A case with everything that was drawn for it."""

    case: Case
    ordinary: Ordinary
    experiment: experiment.Experiment
    world: World
    parameters: dict[str, Any]
    poses: Poses

    def leftover(self) -> float:
        """What the effects leave after recalibration, over the noise."""
        plain = self.ordinary.of(self.case.believed())
        return leftover_over_noise(plain, self.experiment, self.poses) if self.case.hidden else 0.0


def make(case: Case) -> Made:
    """Draws the robot and the experiment, applies the effects, solves every pose."""
    rng, believed = np.random.default_rng([case.seed, 0]), case.believed()
    ordinary = draw_ordinary(believed.n, rng)
    names = [name for name, _ in case.hidden]
    if case.continuous:
        plan = experiment.continuous_motion(believed, case.count, rng)
    else:
        translate = "translation_release" in names
        least = CALMER if SOFTENING.intersection(names) else experiment.LEAST_STABILITY
        plan = experiment.approaches(believed, case.count, rng, translate_last=translate, least_stability=least)
    world, parameters = ordinary.of(believed), {}
    for i, (name, size) in enumerate(case.hidden):
        draw = effects.Draw(size, np.random.default_rng([case.seed, 1, i]), plan.duration_s)
        world, parameters[name] = effects.apply(name, world, draw)
    return Made(case, ordinary, plan, world, parameters, poses(world, plan))


def write(case: Case, parent: Path) -> None:
    """Makes the case and writes parent/name."""
    made = make(case)
    smooth = np.random.default_rng([case.seed, 3])
    p, tangent = add_leftover(made.poses.p, made.poses.tangent, made.experiment, case.left, smooth)
    p, tangent = add_noise(p, tangent, case.noise, np.random.default_rng([case.seed, 2]))
    truth = {
        "effects": true_names(case),
        "leftover_over_noise": round(made.leftover(), 3),
        "parameters": made.parameters,
        "ordinary": asdict(made.ordinary),
        "case": asdict(case),
    }
    files = {
        "robot.toml": robot_toml(case.believed(), f"{case.robot}, nominal values"),
        "measurements.csv": measurements_csv(made.experiment, p, tangent, made.world.room),
    }
    write_folder(parent / case.name, files, truth)


def true_names(case: Case) -> list[str]:
    """Names for truth.json: a|b where the data can't tell, unknown where no catalogue has the effect."""
    names = {"unknown" if name == case.left_out else effects.truth_name(name) for name, _ in case.hidden}
    if any(name == "translation_release" for name, _ in case.hidden):
        names.add("friction")
    return sorted(names | ({"unknown"} if case.left.size_mm else set()))
