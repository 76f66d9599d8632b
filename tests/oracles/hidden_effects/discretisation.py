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

FRICTIONS = {"largest of the bank": (0.08, 0.08), "of Table VII": (0.22, 0.12)}


def halving_errors(
    world: World, theta: Array, l_b: Array, phis: list[tuple[float, ...]], mesh: Fineness | None = None
) -> list[float]:
    """Distances [m] of the tips in friction states phi from those with links of half the length."""
    tips, links = [], mesh or Fineness()
    released = corner([0.0] * (world.n - 1))
    rough = System(world.tubes, world.pairs, theta, l_b, world.loads, Fineness.searching())
    places = rough.contact_places(rough.solve(rough.cold(), released))
    for fineness in (links, links.halved()):
        system = System(world.tubes, world.pairs, theta, l_b, world.loads, fineness, places)
        middle = system.solve(system.cold(), released, CORNER_BARRIER)
        tips.append([tip_pose(system, system.solve(middle, corner(phi)))[0] for phi in phis])
    return [float(np.linalg.norm(a - b)) for a, b in zip(*tips, strict=True)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--finest-mm", type=float, default=1e3 * Fineness.finest_m, help="links where forces are")
    given = parser.parse_args()
    count, mesh = given.count, replace(Fineness(), finest_m=1e-3 * given.finest_mm)
    thetas, ls = draw_configurations(believed(), count, np.random.default_rng(3))
    loaded = list(product((1.0, -1.0), repeat=believed().n - 1))
    print(
        f"a quarter of the noise: {250 * POSITION_SIGMA_M:.3f} mm a coordinate, {433 * POSITION_SIGMA_M:.3f} mm in 3-D"
    )
    for name, friction in FRICTIONS.items():
        pairs = tuple(replace(p, friction=mu) for p, mu in zip(believed().pairs, friction, strict=True))
        world = replace(believed(), pairs=pairs)
        found = [
            halving_errors(world, *q, [(0.0,) * (world.n - 1), *loaded], mesh) for q in zip(thetas, ls, strict=True)
        ]
        _print("released", np.array(found)[:, :1])
        _print(f"friction {name}", np.array(found)[:, 1:])


def _print(name: str, errors_m: Array) -> None:
    rms, largest = np.sqrt(np.mean(errors_m**2)), errors_m.max()
    print(f"{name:30} {errors_m.size:4} tips: rms {1e3 * rms:.3f} mm, largest {1e3 * largest:.3f} mm")


if __name__ == "__main__":
    main()
