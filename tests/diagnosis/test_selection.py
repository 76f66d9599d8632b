"""When an effect is added: its gain is certain over configurations, or it takes what was left to noise."""

from __future__ import annotations

from measured_data import measured, pair_robot, waypoints

from ctrplan.diagnosis import CATALOGUE
from ctrplan.diagnosis.adequacy import noise_floor, remains
from ctrplan.diagnosis.selection import Selector
from ctrplan.diagnosis.workbench import CERTAIN, Workbench, candidates
from ctrplan.pipeline.term import Term, term

ROBOT = pair_robot()


def whole(name: str) -> Term:
    return term(CATALOGUE[name], [p.name for p in CATALOGUE[name].parameters(ROBOT)], ROBOT)


def test_where_noise_was_all_there_was_a_gain_has_to_be_certain_over_configurations() -> None:
    """Beside a joint's scale, that left noise alone, an ovality was named for 28 with a standard error of 15."""
    data = measured(ROBOT, waypoints(ROBOT, 14), {"backlash": {"theta_2_deg": 8.0}})
    bench = Workbench(ROBOT, data, noise_floor(ROBOT, data)[0], data.configuration, data.configuration % 6)
    selector = Selector(bench, candidates(ROBOT, data))
    nothing, play, more = (
        bench.scored([whole(name) for name in names]) for names in ((), ("backlash",), ("backlash", "ovality"))
    )
    assert [remains(bench, one).is_adequate for one in (nothing, play, more)] == [False, True, True]
    vague = 28.0, 28.0 / (0.9 * CERTAIN)
    assert selector._is_certain(nothing, play, *vague)  # a few configurations told all of it
    assert not selector._is_certain(play, more, *vague)
    assert selector._is_certain(play, more, 28.0, 28.0 / (1.1 * CERTAIN))
