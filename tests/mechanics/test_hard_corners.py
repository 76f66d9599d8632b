"""Friction states far from the frictionless one: reached from each other, or told why there is none."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from ctrplan.__main__ import main
from ctrplan.base.arrays import Array
from ctrplan.files.robot_file import write_robot
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.tube import Tube, TubeSection

Sections = list[tuple[float, float, float]]


def tube(outer_radius_m: float, stiffness: float, torsional: float, sections: Sections) -> Tube:
    """A tube like those of the random robots of model/tests, its bore 1/1.09 of the outside."""
    bent = tuple(TubeSection(*section) for section in sections)
    return Tube(2 * outer_radius_m, 2 * outer_radius_m / 1.09, stiffness, stiffness / torsional - 1, bent, 1e-3)


class Slow:
    """Four tubes, as robot 100287 of the extreme ones: its corners take long to reach, up to 34 rad of turn."""

    clearance_m = (1.29355e-05, 9.9274e-06, 3.6997e-05)
    friction = (0.380691, 0.23571, 0.441493)
    theta_b = np.array([1.81092, -1.39168, -0.088662, -1.93392])
    l_b = np.array([-0.0430635, -0.0704165, -0.109447, -0.161692])

    @staticmethod
    def tubes(mirror: float = 1.0) -> tuple[Tube, ...]:
        """`mirror` = -1: mirrored at the plane of x and z."""
        sections: list[Sections] = [
            [(0.0573885, 0.0, 0.0), (0.032165, 45.4852, -45.5425)],
            [(0.0261004, 11.4993, 14.2525), (0.0774563, -7.50598, -9.86052), (0.0133597, -41.1104, -9.78697)],
            [(0.0333069, -27.3329, -61.2029), (0.0524051, -9.18959, 12.791), (0.0702451, 0.0, 0.0)],
            [(0.208212, -4.63047, -3.61053)],
        ]
        numbers = [
            (0.00117235, 0.0159842, 0.0235725),
            (0.00097133, 0.00130027, 0.00169693),
            (0.00074696, 0.0057133, 0.00555304),
            (0.000552138, 0.0576983, 0.0913531),
        ]
        turned = [[(length, mirror * x, y) for length, x, y in tube] for tube in sections]
        return tuple(tube(*number, section) for number, section in zip(numbers, turned, strict=True))


class Jammed:
    """Two tubes, as robot 78 of the wide ones: bent by more than the material bears, friction of 1.5."""

    clearance_m, friction = (1.85519e-05,), (1.48193,)
    theta_b, l_b = np.array([0.981273, -1.3746]), np.array([-0.0496836, -0.0709932])
    tubes = (
        tube(0.00161742, 0.101441, 0.113214, [(0.0665092, -10.5579, 21.0595), (0.0568608, -16.724, 14.7084)]),
        tube(
            0.00115671,
            0.41591,
            2.30125,
            [(0.0561449, -32.1363, 21.8473), (0.0575074, 43.4701, 27.2052), (0.0590155, 0.0, 0.0)],
        ),
    )


def slow(mirror: float = 1.0) -> tuple[Mechanics, Array]:
    return Mechanics(Slow.tubes(mirror), Slow.clearance_m, Slow.friction), mirror * Slow.theta_b


def test_corners_beyond_the_first_effort_are_reached() -> None:
    model, theta_b = slow()
    found = model.bound(theta_b, Slow.l_b, accuracy="search")
    assert all(shape.status < Status.FAILED for shape in found.corners)
    assert max(shape.recheck() for shape in found.corners) < 1e-8
    assert math.isfinite(found.position_m)


def test_they_are_those_of_the_mirrored_robot() -> None:
    model, theta_b = slow()
    mirrored, mirrored_theta_b = slow(-1.0)
    bounds = [
        model.bound(theta_b, Slow.l_b, accuracy="search").position_m,
        mirrored.bound(mirrored_theta_b, Slow.l_b, accuracy="search").position_m,
    ]
    assert bounds[0] == pytest.approx(bounds[1], abs=1e-6)


def test_a_robot_that_friction_winds_up_is_told_so() -> None:
    model = Mechanics(Jammed.tubes, Jammed.clearance_m, Jammed.friction)
    found = model.bound(Jammed.theta_b, Jammed.l_b, accuracy="search")
    statuses = {shape.status for shape in found.corners}
    assert Status.OVERTWISTED in statuses
    assert found.frictionless.status < Status.FAILED
    assert math.isnan(found.position_m)


def test_rows_of_such_robots_have_failed() -> None:
    model = Mechanics(Jammed.tubes, Jammed.clearance_m, Jammed.friction)
    rows = model.bound_many(Jammed.theta_b[None], Jammed.l_b[None])
    assert rows.status.tolist() == [Status.FAILED]
    assert np.isnan(rows.position_m).all()


def test_less_friction_leaves_it_a_bound() -> None:
    model = Mechanics(Jammed.tubes, Jammed.clearance_m, (0.2,))
    assert math.isfinite(model.bound(Jammed.theta_b, Jammed.l_b, accuracy="search").position_m)


def test_the_command_says_that_friction_winds_it_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tubes = [
        {
            "outer_diameter_mm": tube.outer_diameter_m * 1e3,
            "inner_diameter_mm": tube.inner_diameter_m * 1e3,
            "bending_stiffness_Nm2": tube.bending_stiffness_Nm2,
            "poisson_ratio": tube.poisson_ratio,
            "collar_length_mm": 1.0,
            "section": [
                {
                    "length_mm": section.length_m * 1e3,
                    "curvature_x_per_m": section.curvature_x_per_m,
                    "curvature_y_per_m": section.curvature_y_per_m,
                }
                for section in tube.sections
            ],
        }
        for tube in Jammed.tubes
    ]
    contact = {"friction_coefficient": Jammed.friction[0], "clearance_mm": Jammed.clearance_m[0] * 1e3}
    write_robot(tmp_path / "jammed.toml", {"tube": tubes, "contact": [contact]})
    angles, places = map(str, np.degrees(Jammed.theta_b)), map(str, Jammed.l_b * 1e3)
    code = main(["bound", str(tmp_path / "jammed.toml"), "--theta-deg", *angles, "--l-mm", *places])
    error = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("ctrplan: warning:")]
    assert code == 1 and len(error) == 1
    assert "wind a tube up" in error[0]
