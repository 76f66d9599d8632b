"""How long `ctrplan bound` will take, said before it starts."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Literal

from ctrplan.mechanics.core import MOST_TUBES_OF_ALL_CORNERS

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array
    from ctrplan.mechanics.accuracy import Accuracy
    from ctrplan.robot.robot import Robot

LONG_S = 2.0
FEWEST_TUBES = 6  # that may take so long
AT_ONCE = 4  # friction states that the core solves side by side
EXTREME_SHARE = 0.55  # of the states that a search for extreme corners may ask for, those that it does: 6 to 10 tubes
HARD_S = 10  # what the core grants corners that are hard to reach


def states_visited(n: int, corners: Literal["all", "extreme"]) -> float:
    """Friction states that a bound of n tubes solves; for extreme corners in the mean."""
    pairs = n - 1
    if corners == "all":
        return float(2**pairs)
    # each sign of each pair, two dozen candidates and their neighbours in four rounds, the corners chosen
    return EXTREME_SHARE * (2 * pairs + 1 + 24 + 8 * pairs + 16)


def sentence_beforehand(
    robot: Robot, theta_b: Array, l_b: Array, accuracy: Accuracy, corners: Literal["all", "extreme"] | None
) -> str | None:
    """What will be visited and how long that takes, by one solve at the configuration; None where it is soon done."""
    if robot.n < FEWEST_TUBES:
        return None
    chosen = corners or ("all" if robot.n <= MOST_TUBES_OF_ALL_CORNERS else "extreme")
    begun = time.perf_counter()
    robot.solve(theta_b, l_b, accuracy=accuracy)
    expected_s = (time.perf_counter() - begun) * states_visited(robot.n, chosen) / AT_ONCE
    which = f"{2 ** (robot.n - 1)} corners of {robot.n} tubes"
    if chosen == "extreme":
        which = f"the extreme ones of {which}" + ("" if corners else ", all with --corners all")
    if expected_s < LONG_S:
        return None if corners or chosen == "all" else which
    return f"{which}: about {expected_s:.0f} s, up to {HARD_S} s more where corners are hard to reach"
