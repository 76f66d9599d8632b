"""Numbers of robots and measurements in another unit are named by what they would mean."""

from __future__ import annotations

import re
import warnings
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_up_input import FUZZ
from measured_data import measured, pair_robot, waypoints, write_csv
from places import ROBOTS

import ctrplan
from ctrplan.__main__ import main
from ctrplan.base.arrays import are_degrees, are_radians, in_radians
from ctrplan.errors import InputError
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.robot_file import load_robot
from ctrplan.robot.magnitudes import likely_units
from ctrplan.scenario.joint_space import bare_scenario

THREE = ROBOTS / "three_tube.toml"
IN_NO_DOUBT = "youngs_modulus_GPa=60,poisson_ratio=0.3"


@pytest.mark.parametrize(
    ("said", "phrase"),
    [
        ("tube.1.section.1.curvature_y_per_m=0.00377", r"0.032 deg over its length: is its curvature in 1/mm\?"),
        ("tube.1.section.1.curvature_y_per_m=265", r"is 265 its radius in mm \(radius_mm\)\?"),
        ("tube.3.section.2.curvature_y_per_m=55", r"272 deg over its length: is 55 its radius in mm"),
        ("tube.1.bending_stiffness_Nm2=50700", r"Young's modulus would be 6.5e\+16 Pa: is it in N mm\^2\?"),
        ("joint.1.max_deg=3.1416;joint.1.min_deg=-3.1416", "are its limits in radians"),
        ("joint.4.min_mm=-0.0864", "travels 0.0864 mm: are its limits in metres"),
        ("measurement={position_sigma_mm=0.0004}", "is no noise of a tracker: is it in metres"),
        ("tube.1.density_kg_m3=6.45", r"is no density of a tube: is it in g/cm\^3\?"),
        ("tube.1.section.1.curvature_y_per_m=0.0377", r"is its curvature in 1/cm or its curvature in 1/in\?"),
        ("tube.3.section.2.curvature_y_per_m=0.1818", r"0.9 deg over its length: is its curvature in 1/cm"),
        ("tube.1.section.1.curvature_y_per_m=26.5", r"228 deg over its length: is 26.5 its radius in centimetres"),
        ("tube.1.bending_stiffness_Nm2=17.67", r"is it in N cm\^2 or lb in\^2\?"),
        ("tube.1.poisson_ratio=30", r"poisson_ratio = 30: .* 62 times less than Young's: is it in %\?"),
        (
            "tube.3.section.2.length_mm=8.64",
            r"9 deg over its length: is its radius in mm \(radius_mm\) or its length in centimetres\?",
        ),
        ("tube.1.max_strain=0.8", r"no material of 65 GPa bears 80 % and comes back: is it in %\?"),
        ("model_error_mm=500", r"is more than a tenth of the robot's 270 mm: is it in micrometres\?"),
        ("home.theta_deg=[0, 3.14159, 20]", r"home.theta_deg = .*: are they in radians\?"),
        ("home.theta_deg=[0, 3.14159, 1.5708]", r"home.theta_deg = .*: are they in radians\?"),
        ("joint.1.min_deg=-1.5708;joint.1.max_deg=1.5708", "are its limits in radians"),
        ("joint.4.moves={l=[0,0,1000]}", r"moves a tube by 86.4 m within its limits, .*: are these m per m\?"),
        ("model_error_mm=0", ""),
        ("model_error_mm=0.0005", r"model_error_mm = 0.0005 mm: is finer than .*: is it in metres\?"),
        ("tube.3.bending_stiffness_Nm2=5e-5", r"Young's modulus would be .* Pa, 1?[0-9.e+]+ times less than another"),
        (
            "tube.1.outer_diameter_mm=1.32;tube.1.inner_diameter_mm=1.195;tube.2.outer_diameter_mm=1.155;"
            "tube.2.inner_diameter_mm=0.975;tube.3.outer_diameter_mm=0.91;tube.3.inner_diameter_mm=0.8",
            r"outer_diameter_mm = 1.32 mm: makes Young's moduli of 1.04e\+12, 1.18e\+12, .* Pa.*: are these radii\?",
        ),
        (
            "contact.1.clearance_mm=0.085",
            r"clearance_mm = 0.085 mm: is twice the 0.0425 mm .*: is it the difference of",
        ),
        ("contact.1.clearance_mm=42.5", r"0.0425 mm that the diameters leave on every side: is it in micrometres\?"),
        ("contact.2.clearance_mm=0.0000625", r"0.0625 mm that the diameters leave on every side: is it in metres\?"),
        ("contact.1.friction_coefficient=2", r"friction_coefficient = 2: .*dry metal on metal.*: is it in %\?"),
        ("contact.1.friction_coefficient=[0.1, 1.5]", r"friction_coefficient = .*: .*dry metal on metal"),
        ("tube.2.collar_length_mm=0.017", r"collar_length_mm = 0.017 mm: is shorter than .*: is it in metres\?"),
        (
            "tube.3.section.2.length_mm=0.0864",
            r"tube.3.section.2.length_mm = 0.0864 mm: is shorter .*: is it in metres\?",
        ),
        ("joint.4.max_velocity_mm_s=0.01", r"max_velocity_mm_s = 0.01 mm/s: takes 2.7e\+04 s for .*: is it in m/s\?"),
        ("joint.4.max_velocity_mm_s=600", r"max_velocity_mm_s = 600 mm/s: takes 0.451 s .*: is it in mm/min\?"),
        ("joint.4.max_velocity_mm_s=300", r"max_velocity_mm_s = 300 mm/s: is reached after 6 s: is it in mm/min\?"),
        ("joint.1.max_velocity_deg_s=1.0472", r"max_velocity_deg_s = 1.0472 deg/s: takes 344 s .*: is it in rad/s\?"),
        ("joint.1.max_velocity_deg_s=2.0944", r"max_velocity_deg_s = 2.0944 deg/s: takes 172 s .*: is it in rad/s\?"),
        ("joint.1.max_velocity_deg_s=3600", r"takes 0.1 s for a turn: is it in deg/min\?"),
        (
            "joint.4.max_acceleration_mm_s2=0.05",
            r"max_acceleration_mm_s2 = 0.05 mm/s\^2: .* after 200 s: is it in m/s\^2\?",
        ),
        ("joint.1.max_acceleration_deg_s2=4.19", r"max_acceleration_deg_s2 = 4.19 deg/s\^2: .*: is it in rad/s\^2\?"),
        ("joint.4.max_jerk_mm_s3=0.5", r"max_jerk_mm_s3 = 0.5 mm/s\^3: .* after 100 s: is it in m/s\^3\?"),
        ("joint.1.max_jerk_deg_s3=41.9", r"max_jerk_deg_s3 = 41.9 deg/s\^3: .* after 5.73 s: is it in rad/s\^3\?"),
        ("joint.4.max_velocity_mm_s=3", ""),
        ("joint.4.max_velocity_mm_s=100", ""),
        ("joint.1.max_velocity_deg_s=720", ""),
        ("execution.rotation_deg=0.0035", r"execution.rotation_deg = 0.0035 deg: .*: is it in radians\?"),
        ("execution.rotation_deg=12", r"execution.rotation_deg = 12 deg: .*: is it in arcminutes\?"),
        ("execution.translation_mm=0.00005", r"execution.translation_mm = 5e-05 mm: .*: is it in metres\?"),
        ("execution.translation_mm=5", r"execution.translation_mm = 5 mm: .*: is it in micrometres\?"),
        ("execution={rotation_deg=0,translation_mm=0}", ""),
        ("measurement={position_sigma_mm=0.4,tangent_sigma_deg=0.0087}", r"tangent_sigma_deg = .*: is it in radians\?"),
    ],
)
def test_numbers_of_a_robot_by_what_they_would_mean(said: str, phrase: str) -> None:
    told = load_robot(THREE, said.split(";")).warnings
    if not phrase:
        assert told == ()
        return
    (warning,) = told
    assert str(THREE) in warning and "\n" not in warning
    assert re.search(phrase, warning)


MODULI = [
    ("youngs_modulus_GPa=6000,poisson_ratio=0.3", r"youngs_modulus_GPa = 6000 GPa: Young's .*: is it in MPa or ksi\?"),
    ("youngs_modulus_GPa=60,shear_modulus_GPa=60", "shear_modulus_GPa = 60 GPa: shear modulus .* 1 times Young's"),
    ("youngs_modulus_GPa=20,shear_modulus_GPa=8000", "shear_modulus_GPa = 8000 GPa: .* third to a half: is it in MPa"),
    (IN_NO_DOUBT, ""),
]
RADII = [
    ("radius_mm=26.5", r"radius_mm = 26.5 mm: .* is 26.5 its radius in centimetres or its radius in inches\?"),
    ("radius_mm=265", ""),
]
INCHES = ("radius_mm=3.77", r"is 3.77 its radius in inches or its curvature in 1/m \(curvature_y_per_m\)\?")
PAIRS = [(*moduli, *radius) for moduli in MODULI for radius in RADII]
PAIRS += [(*moduli, *INCHES) for moduli in (MODULI if FUZZ else MODULI[-1:])]  # a robot so bent takes seconds


@pytest.mark.parametrize(("said", "phrase", "bend", "hint"), PAIRS)
def test_moduli_and_radii_are_doubted_as_they_were_said(said: str, phrase: str, bend: str, hint: str) -> None:
    tube = f"outer_diameter_mm=2.64,inner_diameter_mm=2.39,{said},section=[{{length_mm=150,{bend}}}]"
    robot = load_robot(THREE, [f"tube.1={{{tube}}}"])
    told = " ".join(ctrplan.check(robot).flags)
    assert bool(told) == bool(phrase or hint)
    assert re.search(phrase, told) and re.search(hint, told)


def tubes_of(moduli: str) -> list[str]:
    """Overrides by which all three tubes are said by these moduli."""
    sizes = ("2.64", "2.39", 150, 265), ("2.31", "1.95", 167, 265), ("1.825", "1.6", 270, 90)
    return [
        f"tube.{i}={{outer_diameter_mm={outer},inner_diameter_mm={inner},{moduli},"
        f"section=[{{length_mm={length},radius_mm={radius}}}]}}"
        for i, (outer, inner, length, radius) in enumerate(sizes, start=1)
    ]


@pytest.mark.parametrize(
    ("moduli", "phrase"),
    [
        ("youngs_modulus_GPa=0.065,poisson_ratio=0.3", r"youngs_modulus_GPa = 0.065 GPa: .* is it in TPa\?"),
        ("youngs_modulus_GPa=0.2,poisson_ratio=0.29", r"youngs_modulus_GPa = 0.2 GPa: .* of a metal: is it in TPa\?"),
        ("youngs_modulus_GPa=0.065,poisson_ratio=0.45", ""),
        ("youngs_modulus_GPa=0.05,poisson_ratio=0.48", ""),
        ("youngs_modulus_GPa=0.5,poisson_ratio=0.3", ""),
        ("youngs_modulus_GPa=3.6,poisson_ratio=0.38", ""),
        ("youngs_modulus_GPa=5,poisson_ratio=0.4", ""),
        ("youngs_modulus_GPa=200,poisson_ratio=0.29", ""),
    ],
)
def test_moduli_of_all_tubes_by_what_materials_are(moduli: str, phrase: str) -> None:
    """Shapes depend on the ratios of stiffnesses alone: all of them a thousand times too small change none."""
    stated = load_robot(THREE, tubes_of(moduli)).warnings
    assert len(stated) == bool(phrase) and all(re.search(phrase, text) for text in stated)


def test_stiffnesses_of_all_tubes_a_thousand_times_too_small() -> None:
    stiffnesses = [tube.bending_stiffness_Nm2 / 1e3 for tube in load_robot(THREE).tubes]
    said = [f"tube.{i}.bending_stiffness_Nm2={EI}" for i, EI in enumerate(stiffnesses, start=1)]
    (warning,) = load_robot(THREE, said).warnings
    assert re.search(r"bending_stiffness_Nm2 = 5.07e-05 N m\^2: .* is it in kN m\^2\?", warning)


def test_a_radius_in_metres_is_refused_by_name() -> None:
    tube = "outer_diameter_mm=2.64,inner_diameter_mm=2.39,youngs_modulus_GPa=60,poisson_ratio=0.3"
    with pytest.raises(InputError, match="own outer radius: is it its radius in metres"):
        load_robot(THREE, [f"tube.1={{{tube},section=[{{length_mm=150,radius_mm=0.265}}]}}"])


def test_a_tube_that_is_straight_in_any_unit_is_in_no_doubt() -> None:
    assert load_robot(THREE, ["tube.1.section.1.curvature_y_per_m=1e-5"]).warnings == ()
    assert load_robot(THREE, ["tube.1.section.1.curvature_y_per_m=0"]).warnings == ()


def test_lengths_in_metres_beside_a_home_in_millimetres_are_named_before_nesting() -> None:
    said = [f"tube.{i}.section.{k}.length_mm={x}" for i, k, x in ((1, 1, 0.15), (2, 1, 0.017), (2, 2, 0.15))]
    with pytest.raises(InputError, match=r"tube.2: sections add up to 0.167 mm, .*: are they in metres\?"):
        load_robot(THREE, said)
    said += [f"tube.{i}.collar_length_mm=0.017" for i in (2, 3)]
    with pytest.raises(InputError, match=r"tube.1.*: is 0.15 mm long, .*: are its lengths in metres\? No joint values"):
        load_robot(THREE, said)


def test_many_doubts_are_one_line_that_says_how_many_more_there_are() -> None:
    (warning,) = load_robot(THREE, [f"tube.{i}.bending_stiffness_Nm2=50700" for i in (1, 2, 3)]).warnings
    assert f"(2 more numbers in doubt: ctrplan check {THREE})" in warning


def test_radii_of_an_inner_tube_alone() -> None:
    """By its own modulus nothing is wrong with it; but a tube twice as wide fits where it is."""
    tube = "youngs_modulus_GPa=60,poisson_ratio=0.3,section=[{length_mm=200,radius_mm=90}]"
    half = f"tube.2={{outer_diameter_mm=1.05,inner_diameter_mm=0.925,{tube}}}"
    wide = ["tube.1.outer_diameter_mm=2.5", "tube.1.inner_diameter_mm=2.2"]
    (warning,) = load_robot(ROBOTS / "table_1_pair.toml", [*wide, half]).warnings
    assert re.search(
        r"tube.2.outer_diameter_mm = 1.05 mm: leaves .* mm on every side.*: are its diameters radii", warning
    )


def test_a_collar_in_metres_where_the_file_has_no_home(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It was a traceback: the bases that follow from the collar are a doubt about a table that is not there."""
    tubes = [
        "[[tube]]\nouter_diameter_mm = 2.5\ninner_diameter_mm = 2.2\nyoungs_modulus_GPa = 60\npoisson_ratio = 0.3\n"
        "[[tube.section]]\nlength_mm = 120\nradius_mm = 250\n",
        "[[tube]]\nouter_diameter_mm = 2.1\ninner_diameter_mm = 1.85\nyoungs_modulus_GPa = 60\npoisson_ratio = 0.3\n"
        "collar_length_mm = 0.02\n[[tube.section]]\nlength_mm = 200\nradius_mm = 90\n",
    ]
    (tmp_path / "r.toml").write_text("".join(tubes) + "[[contact]]\nfriction_coefficient = 0.2\n")
    assert main(["bound", str(tmp_path / "r.toml"), "--theta-deg", "0", "1.5708", "--l-mm", "0", "-30"]) == 0
    said = capsys.readouterr().err
    assert "collar_length_mm = 0.02 mm: is shorter than the tube is wide: is it in metres?" in said
    assert "--theta-deg" in said and "are these in radians?" in said


def test_points_for_the_tip_in_python_and_on_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    robot = load_robot(THREE)
    with pytest.raises(InputError, match=r"tip_m = \[34.0, -47.0, 200.0\] m: lies .* are these in millimetres"):
        ctrplan.inverse_kinematics(robot, [34, -47, 200])
    assert main(["ik", str(THREE), "--tip-mm", "3.4", "-4.7", "20"]) == 1
    assert "--tip-mm = [3.4, -4.7, 20.0] mm: lies 20.8 mm from the base, " in (told := capsys.readouterr().err)
    assert "are these in centimetres?" in told and "UserWarning" not in told
    assert main(["bound", str(THREE), "--theta-deg", "0", "180", "90", "--l-mm", "0", "-0.017", "-0.06"]) == 2
    assert "are these in metres?" in capsys.readouterr().err
    assert main(["ik", str(THREE), "--tip-mm", "0.034", "-0.047", "0.2"]) == 2
    assert "--tip-mm = [0.034, -0.047, 0.2] mm: lies 0.208 mm from the base" in capsys.readouterr().err


@pytest.mark.parametrize(("theta", "is_so"), [([0, 90, 180], True), ([0.5, 90.5, 200.0], True), ([0, 1, 2], False)])
@pytest.mark.parametrize("name", ["bound", "solve", "zero_clearance", "bound_many"])
def test_degrees_given_for_radians_are_warned_about(name: str, theta: list[float], is_so: bool) -> None:
    robot = load_robot(THREE)
    l_b = [0.0, -0.017, -0.05]  # noqa: E741
    arguments = ([theta], [l_b]) if name == "bound_many" else (theta, l_b)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        getattr(robot, name)(*arguments)
    assert bool(told) == is_so
    if is_so:
        assert "theta_b" in str(told[0].message) and "degrees" in str(told[0].message)
        assert told[0].filename == __file__


THETA_DEG, COLLARS_M = [0.0, 90.0, 180.0], [0.0, -0.017, -0.05]
IN_DEGREES = {  # what takes collars or joint values of a scenario in free space, given rotations
    "MotionChecker.check": lambda s, q: ctrplan.MotionChecker(s).check([q]),
    "MotionChecker.motion": lambda s, q: ctrplan.MotionChecker(s).motion(s.start, q),
    "MotionChecker.motions": lambda s, q: ctrplan.MotionChecker(s).motions([s.start], [q]),
    "MotionChecker.clearance": lambda s, q: ctrplan.MotionChecker(s).clearance(q),
    "History.advance": lambda s, q: s.robot.history().advance(q[:3], COLLARS_M),
    "History.follow": lambda s, q: s.robot.history().follow([q[:3]], [COLLARS_M]),
    "Walker.bound": lambda s, q: s.robot.walker().bound(q[:3], COLLARS_M),
    "Observer.observe": lambda s, q: s.robot.observer(1e-3).observe(q[:3], COLLARS_M),
    "TipTracker": lambda s, q: ctrplan.TipTracker(s, q),
    "certify": lambda s, q: ctrplan.certify(s, [s.start, q]),
    "reorder": lambda s, q: ctrplan.reorder([s.start, q], s),
    "l_shaped": lambda s, q: ctrplan.l_shaped([s.start, q], s),
    "plan_uncertainty": lambda s, q: ctrplan.plan_uncertainty(s, q),
    "bound_with_parameters": lambda s, q: ctrplan.bound_with_parameters(s.robot, q[:3], COLLARS_M),
    "Goal": lambda s, q: s.with_(goal=ctrplan.Goal(joints=q, tip_m=None, tolerance_m=1e-3)),
}


@pytest.mark.parametrize("name", IN_DEGREES)
def test_degrees_given_to_what_takes_joints_are_warned_about(name: str) -> None:
    scenario = bare_scenario(load_robot(THREE))
    for theta, is_so in ((THETA_DEG, True), (np.radians(THETA_DEG), False)):
        with warnings.catch_warnings(record=True) as told, suppress(ctrplan.CtrplanError):
            warnings.simplefilter("always")
            IN_DEGREES[name](scenario, np.append(theta, scenario.start[3]))
        assert bool(told) == is_so
        if is_so:
            assert "degrees" in str(told[0].message) and told[0].filename == __file__


def test_millimetres_given_for_metres_of_joints_are_named() -> None:
    robot = load_robot(THREE)
    with pytest.raises(InputError, match=r"are these millimetres\?"):
        robot.bound([0, 0, 0], [0, -17, -50])
    with pytest.raises(InputError, match=r"are these millimetres\?"):
        robot.mechanics.solve([0, 0, 0], [0, -17, -50])


@pytest.mark.parametrize(
    ("factor", "word"),
    [(1e3, "millimetres"), (1 / 25.4e-3, "centimetres or inches"), (100.0, "centimetres")],
)
def test_measured_tips_by_the_length_of_the_robot(factor: float, word: str, tmp_path: Path) -> None:
    robot = pair_robot()
    data = measured(robot, waypoints(robot, 3))
    write_csv(tmp_path / "a.csv", replace(data, position_m=data.position_m * factor))
    with pytest.raises(InputError, match=f"are these {word}"):
        load_measurements(tmp_path / "a.csv", robot)


def test_the_rules_themselves() -> None:
    assert likely_units(200.0, "m", 0.1, 0.3) == ["mm"] and likely_units(7.9, "m", 0.1, 0.3) == ["in"]
    assert likely_units(0.2e-3, "mm", 0.1, 0.3) == ["m"] and likely_units(0.5, "m", 0.1, 0.3) == []
    assert likely_units(11.0, "m", 0.1, 0.3) == ["cm", "in"]
    assert are_radians([3.1416]) and are_radians([0, -6.283]) and are_radians([0.349, -1.047, 1.396])
    assert not any(map(are_radians, ([], [0.0], [3], [1.5], [3.1], [0.35, 20], [2.0, -2.0], [90.0], [np.inf])))
    assert in_radians([0, 3.1416, 90]) == 1 and in_radians([0, 1.5, 90]) is None and in_radians([0, 0.349, -1.047]) == 1
    assert are_degrees([0.5, 90.0, 1.2]) and not are_degrees([0.5, 6.0, 1.2]) and not are_degrees([6.3, 7.0, 7.7])
    assert are_degrees([0, 30.0]) and not are_degrees([6.0]) and not are_degrees([6.5]) and not are_degrees([])
    assert not are_degrees([np.nan]) and are_degrees([400.3])


@pytest.mark.parametrize("file", sorted(ROBOTS.glob("*.toml")), ids=lambda file: file.stem)
def test_no_shipped_robot_is_in_doubt(file: Path) -> None:
    robot = load_robot(file)
    assert ctrplan.check(robot).flags == () and not [text for text in robot.warnings if text.endswith("?")]


def test_diameters_given_as_radii_are_not_told_from_moduli_that_were_stated_but_from_a_stated_clearance() -> None:
    content = dict(load_robot(THREE).content)
    tubes = [dict(tube) for tube in content["tube"]]
    for tube in tubes:
        for key in ("outer_diameter_mm", "inner_diameter_mm"):
            tube[key] /= 2
        del tube["bending_stiffness_Nm2"]
        tube["youngs_modulus_GPa"] = 60.0
    contacts = [
        dict(contact, clearance_mm=gap) for contact, gap in zip(content["contact"], (0.0425, 0.0625), strict=True)
    ]
    assert ctrplan.robot_from_dict(content | {"tube": tubes}).warnings == ()
    (warning, *_) = ctrplan.robot_from_dict(content | {"tube": tubes, "contact": contacts}).warnings
    assert "or are the diameters radii?" in warning or "or are the diameters radii (1 more" in warning


def test_a_robot_made_in_code_says_so_when_it_is_made() -> None:
    robot = load_robot(THREE)
    slow = replace(robot.drive.joints[3], max_velocity=1e-5)
    drive = replace(robot.drive, joints=(*robot.drive.joints[:3], slow))
    with pytest.warns(UserWarning, match=r"max_velocity_mm_s = 0.01 mm/s: .*: is it in m/s\?"):
        made = robot.with_(drive=drive)
    assert "is it in m/s?" in " ".join(made.warnings)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        robot.with_(name="the same")


@pytest.mark.parametrize(
    ("ends", "phrase"),
    [
        ("[0.19, 0.21]", ""),
        ("[19, 21]", r"must contain its value, 0.2: is it in %\?"),
        ("[-0.02, 0.02]", r"must contain its value, 0.2: is it said as plus or minus\?"),
        ("[0.9, 1.1]", r"must contain its value, 0.2: is it said as a share of the value\?"),
        ("[0.3, 0.4]", r"must contain its value, 0.2\.$"),
    ],
)
def test_intervals_in_other_units_are_refused_by_name(ends: str, phrase: str) -> None:
    said = [f"uncertainty.ci95.contact={{1={{friction_coefficient={ends}}}}}"]
    if not phrase:
        assert load_robot(THREE, said).warnings == ()
        return
    with pytest.raises(InputError, match=phrase):
        load_robot(THREE, said)
    length = ["uncertainty.ci95.tube={1={section={1={length_mm=[0.149, 0.151]}}}}"]
    with pytest.raises(InputError, match=r"must contain its value, 150: is it 1000 times too small"):
        load_robot(THREE, length)


@pytest.mark.parametrize(
    ("joint", "change", "phrase"),
    [
        (
            0,
            {"max_velocity": 60.0},
            r"max_velocity_deg_s = 3437.7.* turn: is it in deg/min or deg/s given for rad/s\?",
        ),
        (
            3,
            {"max_velocity": 10.0},
            r"max_velocity_mm_s = 10000.0 mm/s: takes 0.027 s .*: is it in mm/s given for m/s\?",
        ),
        (
            3,
            {"max_acceleration": 50.0},
            r"max_acceleration_mm_s2 = 50000.0 .*: is it in mm/min\^2 or mm/s\^2 given for m/s\^2\?",
        ),
        (0, {"lower": -180.0, "upper": 180.0}, r"turns by 2.063e\+04 deg: are its limits degrees given for radians\?"),
    ],
)
def test_units_of_files_given_in_code_are_named(joint: int, change: dict[str, float], phrase: str) -> None:
    robot = load_robot(THREE)
    joints = list(robot.drive.joints)
    joints[joint] = replace(joints[joint], **change)
    with pytest.warns(UserWarning, match=phrase):
        robot.with_(drive=replace(robot.drive, joints=tuple(joints)))
