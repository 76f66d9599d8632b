"""A walk that comes too close to something says to what, and where."""

from __future__ import annotations

import re

import numpy as np
import pytest
from places import SCENARIOS

from ctrplan.certificate.closest import failure_with_place
from ctrplan.certificate.walked_legs import walk_legs
from ctrplan.files.scenario_file import scenario_from_dict

CENTRE_MM, RADIUS_MM, MARGIN_MM = np.array([60.0, 32.0, 165.0]), 18.6, 0.5
START = {"rotate outer": 0, "rotate middle": 60, "rotate inner": 110, "translate inner": -30}
PLACE = re.compile(r"there tube (\d) is at \[(.*), (.*), (.*)\] mm( in RAS)?, nearest to anatomy\.2 \(sphere\)\.$")


@pytest.mark.parametrize("frame", [None, "RAS"])
def test_the_place_of_a_refusal_is_where_a_friction_state_comes_too_close(frame: str | None) -> None:
    sphere = {"kind": "sphere", "center_mm": CENTRE_MM.tolist(), "radius_mm": RADIUS_MM, "margin_mm": MARGIN_MM}
    content = {
        "robot": "robots/three_tube.toml",
        "start": START,
        "goal": {"joints": START},
        "anatomy": [{**sphere, "center_mm": [0, 90, 20], "radius_mm": 5}, sphere],
        **({"frame": frame} if frame else {}),
    }
    scenario = scenario_from_dict(content, file=str(SCENARIOS / "example.toml"))
    walk = walk_legs(scenario, scenario.start[None])
    sentence = failure_with_place(walk)
    assert sentence.startswith(walk.failure.removesuffix("."))
    found = PLACE.search(sentence)
    assert found and bool(found[5]) == (frame is not None), sentence
    radius_mm = scenario.robot.tubes[int(found[1]) - 1].outer_diameter_m * 1e3 / 2
    from_wall = np.linalg.norm(np.array(found.groups()[1:4], float) - CENTRE_MM) - RADIUS_MM - MARGIN_MM - radius_mm
    bodies = scenario.robot.mechanics.friction_bodies(
        *scenario.robot.drive.collars(scenario.start),
        np.array([[a, b] for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)]),
    )
    points_mm = bodies.point_m @ scenario.base_R.T * 1e3 + scenario.base_position_m * 1e3
    each = np.linalg.norm(points_mm - CENTRE_MM, axis=2) - bodies.radius_m * 1e3 - RADIUS_MM - MARGIN_MM
    assert from_wall == pytest.approx(each.min(), abs=0.15)  # places are told to 0.1 mm
    assert each.min() < each[4].min()  # not where the frictionless one is
