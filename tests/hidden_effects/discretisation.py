"""The generator's own error: tips against links of half the length: `python -m hidden_effects.discretisation`."""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from itertools import product

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from hidden_effects.equilibrium import CORNER_BARRIER, System, corner, tip_pose
from hidden_effects.experiment import draw_configurations
from hidden_effects.mesh import Fineness
from hidden_effects.noise import POSITION_SIGMA_M
from hidden_effects.tube import Array
from hidden_effects.world import World, believed

FRICTION = (0.22, 0.12)  # Table VII


def halving_errors(world: World, theta: Array, l_b: Array, phis: list[tuple[float, ...]]) -> list[float]:
    """Distances [m] of the tips in friction states phi from those with links of half the length."""
    tips = []
    for fineness in (Fineness(), Fineness().halved()):
        system = System(world.tubes, world.pairs, theta, l_b, world.loads, fineness)
        middle = system.solve(system.cold(), corner([0.0] * (world.n - 1)), CORNER_BARRIER)
        tips.append([tip_pose(system, system.solve(middle, corner(phi)))[0] for phi in phis])
    return [float(np.linalg.norm(a - b)) for a, b in zip(*tips, strict=True)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10)
    count = parser.parse_args().count
    world = believed()
    pairs = tuple(replace(pair, friction=mu) for pair, mu in zip(world.pairs, FRICTION, strict=True))
    world = replace(world, pairs=pairs)
    loaded = list(product((1.0, -1.0), repeat=world.n - 1))
    found: dict[str, list[float]] = {"released": [], "loaded": []}
    for theta, l_b in zip(*draw_configurations(world, count, np.random.default_rng(3)), strict=True):
        errors = halving_errors(world, theta, l_b, [(0.0,) * (world.n - 1), *loaded])
        found["released"] += errors[:1]
        found["loaded"] += errors[1:]
    for name, errors in found.items():
        values = 1e3 * np.array(errors)
        rms, most = np.sqrt(np.mean(values**2)), values.max()
        print(f"{name:9} {len(values):4} tips: rms {rms:.3f} mm, largest {most:.3f} mm", end="")
        print(
            f"; a quarter of the noise: {250 * POSITION_SIGMA_M:.3f} mm a coordinate, "
            f"{433 * POSITION_SIGMA_M:.3f} mm in 3-D"
        )


if __name__ == "__main__":
    main()
