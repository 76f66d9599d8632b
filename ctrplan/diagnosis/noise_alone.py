"""Whether a set of effects leaves noise alone: errors that go along with something are none, however small they are.

Chi-squares have no memory. A tracker that jumps by 1.6 mm is a drift to them: what a drift leaves of the jump is small
for every pose, and goes up and down with the time. So the poses are asked how probable they are beside an error that is
smooth in the joints or in time, or belongs to the configuration, and beside noise alone.
"""

from __future__ import annotations

from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.smooth_evidence import SmoothEvidence
from ctrplan.diagnosis.workbench import Scored, Workbench

LEAST_ODDS_OF_ERROR = 7.0  # logarithm; true names left up to 5.2 (heavy tails), nulls 2.8, the jump called a drift 9.7
IN_WORDS = {
    "configuration": "belongs to the configuration",
    "joints": "goes along with the joints",
    "time": "goes along with the time",
}


def remaining_error(bench: Workbench, chosen: Scored) -> str:
    """What is more than noise of what a set leaves, as a sentence; empty where noise alone is as probable.

    Priors are as wide as effects are large: an error would stand for what a prior draws in.
    """
    correlated = CorrelatedBench(bench.robot, bench.data, bench.noise, bench.group, bench.fold)
    odds, error = SmoothEvidence(correlated, bench.sized(chosen)).beside_noise_alone()
    if odds < LEAST_ODDS_OF_ERROR:
        return ""
    beside, along = " and ".join(chosen.names), IN_WORDS[error.along]
    return f"What {beside} leaves is no noise: an error that {along} is exp({odds:.0f}) times as probable."
