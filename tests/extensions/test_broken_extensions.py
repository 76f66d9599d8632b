"""A file of an extension that can't be used ends the command with one sentence that names it, and exit code 2."""

from __future__ import annotations

from pathlib import Path

import pytest
from extending_page import PLACES, run, source, write_extension, write_inputs
from made_up_input import FUZZ

BOUND = "ctrplan bound my_pair.toml --theta-deg 0 90 --l-mm 0 -15 --set effects.guide_twist.theta_2_deg_per_mm=1"
COMMANDS = {
    "An effect": BOUND,
    "A planner": "ctrplan plan first.toml",
    "An obstacle": "ctrplan plan boxed.toml",
    "An output format": "ctrplan plan first.toml",
}
THINGS = {
    "An effect": "effect",
    "A planner": "planner",
    "An obstacle": "obstacle kind",
    "An output format": "trajectory format",
}
# What the file of a section says, what a broken one says in its place, and what the sentence is to say.
BROKEN = [
    *((heading, "from __future__", "from __future", "can't be imported: ") for heading in PLACES),
    *((heading, "\n@register", "\n# @register", f"registers no {thing}") for heading, thing in THINGS.items()),
    ("An effect", '"guide_twist"', '"backlash"', "'backlash': is the name of another effect already, in ctrplan."),
    ("A planner", '"RRT"', '"RRT*"', "'RRT*': is the name of another planner already, in ctrplan."),
    ("An obstacle", '"turned_box"', '"mesh"', "'mesh': is the name of another obstacle kind already, in ctrplan."),
    ("An output format", '"jsonl"', '"csv"', "'csv': is the name of another trajectory format already, in ctrplan."),
    ("An output format", '".jsonl"', '".csv"', "suffix = '.csv': is the suffix of format csv already"),
    ("An output format", '".jsonl"', '"/../x"', "suffix = '/../x': must be a dot and letters or digits"),
    ("An effect", "    equation =", "    formula =", "GuideTwist lacks equation"),
    (
        "An effect",
        '"drive"\n',
        '"gear"\n',
        "the stage of GuideTwist must be one of clock, drive, mechanics, sensor",
    ),
    ("An effect", "def parameters", "def numbers", "GuideTwist lacks parameters"),
    ("A planner", "ompl_planner", "planner", "RRT lacks ompl_planner"),
    ("A planner", ' = "RRT"', "", "RRT lacks a default"),
    ("An obstacle", "def distance", "def depth", "TurnedBox lacks distance"),
    ("An obstacle", "    kind = ", "    sort = ", "TurnedBox lacks kind"),
    ("An obstacle", "def shape", "def body", "TurnedBoxEntry lacks shape"),
    ("An obstacle", "@dataclass(", "# @dataclass(", "TurnedBox must be a dataclass"),
    ("An output format", ', suffix=".jsonl"', "", "missing 1 required keyword-only argument: 'suffix'"),
]


ALIKE = ("can't be imported", "registers no", "is the name of another")  # said by what reads all four
FIRST = [next(case for case in BROKEN if said in case[3]) for said in ALIKE]
OTHERS = ("GuideTwist lacks parameters", "TurnedBox lacks kind")  # as what else an effect or an obstacle lacks
TRIED = [case for case in BROKEN if FUZZ or case in FIRST or not any(said in case[3] for said in (*ALIKE, *OTHERS))]


@pytest.mark.parametrize(("heading", "old", "new", "said"), TRIED, ids=[f"{case[0]}: {case[3]}" for case in TRIED])
def test_a_file_that_can_not_be_used_is_named(heading: str, old: str, new: str, said: str, tmp_path: Path) -> None:
    assert old in source(heading)
    file = f"EXTENSIONS/{PLACES[heading]}"
    write_extension(tmp_path, PLACES[heading], source(heading).replace(old, new))
    assert said in sentence(tmp_path, COMMANDS[heading]).partition(file)[2]


@pytest.mark.parametrize(
    ("heading", "shipped"),
    [
        ("An effect", "backlash.py"),
        ("A planner", "rrt_star.py"),
        ("An obstacle", "sphere.py"),
        ("An output format", "csv_table.py"),
    ][: 4 if FUZZ else 1],
)
def test_a_file_of_the_name_of_a_shipped_one_is_refused(heading: str, shipped: str, tmp_path: Path) -> None:
    place = PLACES[heading].rpartition("/")[0] + "/" + shipped
    write_extension(tmp_path, place, source(heading))
    assert sentence(tmp_path, COMMANDS[heading]).endswith(f"/{place}: has the name of a file of the package.")


@pytest.mark.parametrize("place", ["guide_twist.py", "effects/guide_twist.py", "effects/gear/guide_twist.py"])
def test_a_file_where_nothing_looks_is_refused(place: str, tmp_path: Path) -> None:
    write_extension(tmp_path, place, source("An effect"))
    said = sentence(tmp_path, BOUND)
    assert f"EXTENSIONS/{place}: is read by nothing: must lie in one of effects/clock, effects/drive" in said


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path) -> None:
    said = sentence(tmp_path, "export CTRPLAN_EXTENSIONS=nowhere", BOUND)
    assert said == "ctrplan: CTRPLAN_EXTENSIONS = 'nowhere': is not a folder that exists."


def test_two_folders_are_read_and_may_not_have_a_file_of_the_same_name(tmp_path: Path) -> None:
    write_inputs(tmp_path)
    write_extension(tmp_path, PLACES["An effect"], source("An effect"))
    second = tmp_path / "second" / "effects" / "drive"
    second.mkdir(parents=True)
    both = "export CTRPLAN_EXTENSIONS=$CTRPLAN_EXTENSIONS:second"
    use = [BOUND, BOUND.replace("twist", "swirl")]
    (second / "swirl.py").write_text(source("An effect").replace("guide_twist", "guide_swirl"))
    done = run(tmp_path, both, *use)
    assert (done.returncode, done.stderr) == (0, "")
    (second / "swirl.py").rename(second / "guide_twist.py")
    assert "second/effects/drive/guide_twist.py: has the name of a file in" in sentence(tmp_path, both, *use)


def sentence(folder: Path, *commands: str) -> str:
    """The only line that commands write to standard error; they end with exit code 2 and write no file."""
    write_inputs(folder)
    before = sorted(folder.iterdir())
    done = run(folder, *commands)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    assert sorted(folder.iterdir()) == before
    return done.stderr.rstrip("\n")


def test_an_effect_that_returns_another_shape_is_named(tmp_path: Path) -> None:
    """Once it was a traceback of a reshape, or a friction state that no fit has asked for."""
    good = "return Collars(theta, collars.l)"
    assert good in source("An effect")
    write_extension(
        tmp_path, PLACES["An effect"], source("An effect").replace(good, "return Collars(theta[:, :1], theta)")
    )
    said = sentence(tmp_path, BOUND)
    assert said.endswith("effects.guide_twist: returns an array of shape (1, 1) where it was given (1, 2)."), said


DISTANCE = "return Box(self.lower_m, self.upper_m).distance(self.turned(points_m, -self.turn_rad))"
BOX = "return corners.min(axis=0), corners.max(axis=0)"
TWIST = "theta = with_column(theta, tube, k * collars.l[:, tube - 1])"
FORMATS = "ctrplan plan first.toml -o out --formats csv jsonl --set planner.time_s=0.2"
RRT = "ctrplan plan first.toml --set planner.name=RRT --set planner.time_s=0.2"
BOXED = "ctrplan plan boxed.toml --set planner.time_s=0.2"
ODD = [  # section, what its file says, what a broken one says instead, a command, and what is said then
    (
        "An effect",
        TWIST,
        "1 / 0",
        BOUND,
        r"effects.guide_twist: drive: ZeroDivisionError: division by zero (line 30 of",
    ),
    (
        "An effect",
        TWIST,
        "collars.theta[:, 0] += 1",
        BOUND,
        "effects.guide_twist: drive: ValueError: output array is read",
    ),
    (
        "An effect",
        TWIST,
        "theta = theta * np.nan",
        BOUND,
        "guide_twist: drive: NameError: name 'np' is not defined (line 30",
    ),
    (
        "An effect",
        TWIST,
        "theta = theta * float('nan')",
        BOUND,
        "effects.guide_twist: returns numbers that are not finite.",
    ),
    ("An effect", "return Collars(theta, collars.l)", "return theta", BOUND, "must return Collars, not ndarray."),
    ("An effect", "return tuple(Param", "return 7 or tuple(Param", BOUND, "parameters: must return a tuple of Param"),
    (
        "An obstacle",
        DISTANCE,
        "return 1 / 0",
        BOXED,
        "anatomy of kind turned_box: distance: ZeroDivisionError: division by",
    ),
    (
        "An obstacle",
        DISTANCE,
        "points_m *= 0",
        BOXED,
        "turned_box: distance: ValueError: output array is read-only (line 30",
    ),
    ("An obstacle", BOX, "return None", BOXED, "'turned_box' must say the lower and the upper corner of its box."),
    (
        "A planner",
        "return planner",
        "return 7",
        RRT,
        "planner RRT: ompl_planner: must return a planner of OMPL, not int.",
    ),
    (
        "A planner",
        "planner = og",
        "planner = ag",
        RRT,
        "planner RRT: ompl_planner: NameError: name 'ag' is not defined (l",
    ),
    (
        "An output format",
        'return ""',
        'return None or b""',
        FORMATS,
        "trajectory format jsonl: TypeError: sequence item 0",
    ),
    (
        "An output format",
        'return "".join',
        'return 7 or "".join',
        FORMATS,
        "jsonl: must return text that can be written, not int.",
    ),
]
USUAL = ("1 / 0", "collars.theta[:, 0] += 1", "return None", "return 7", "return 7 or tuple(Param")
ASKED = [case for case in ODD if FUZZ or case[2] in USUAL]


@pytest.mark.parametrize(("heading", "old", "new", "command", "said"), ASKED, ids=[case[2] for case in ASKED])
def test_what_functions_of_ones_own_do_wrong_is_one_sentence(
    heading: str, old: str, new: str, command: str, said: str, tmp_path: Path
) -> None:
    """Once a traceback out of the middle of a plan; arrays that they changed in place were changed for everybody."""
    assert old in source(heading)
    write_inputs(tmp_path)
    write_extension(tmp_path, PLACES[heading], source(heading).replace(old, new))
    done = run(tmp_path, command)
    assert done.returncode in (1, 2) and done.stderr.count("\n") == 1 and said in done.stderr, done.stderr


SOFT = """
from ctrplan.effects.effect import Effect, Parameter, register

@register
class Soft(Effect):
    name, stage, equation, signature, experiment = "soft", "mechanics", "E = E", "soft", "press"

    def parameters(self, robot):
        return (Parameter("percent", prior=1),)

    def mechanics(self, values, robot):
        return NUMBERS
"""


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        (
            "{'contact.1.friction': 1.0}",
            "effects.soft: makes another robot, of which contact.1.friction: no such parameter",
        ),
        (
            "{'contact.1.friction_coefficient': float('nan')}",
            "effects.soft: makes another robot, of which friction_coeff",
        ),
        ("[1]", "effects.soft: must return numbers by name, not list."),
    ][: 3 if FUZZ else 1],
)
def test_numbers_that_no_robot_has_are_those_of_the_effect(numbers: str, said: str, tmp_path: Path) -> None:
    write_inputs(tmp_path)
    write_extension(tmp_path, "effects/mechanics/soft.py", SOFT.replace("NUMBERS", numbers))
    assert said in sentence(tmp_path, BOUND.replace("guide_twist.theta_2_deg_per_mm", "soft.percent"))


WARM = """
from ctrplan.effects.effect import Effect, Parameter, register
from ctrplan.measurement.measurements import Poses

@register
class Warm(Effect):
    name, stage, equation, signature, experiment = "warm", "sensor", "p = p", "warm", "warm it"
    needs_columns = ("temperature_C",)

    def parameters(self, robot):
        return (Parameter("percent", prior=1),)

    def sensor(self, values, poses, data):
        WRITES
        return Poses(poses.position, poses.frame)
"""
WRITES = ("data.more['temperature_C'] -= 20", "data.position_m[:] = 0", "poses.position[:, 0] += 1e-3")


@pytest.mark.parametrize("writes", WRITES if FUZZ else WRITES[:1])
def test_an_effect_cannot_change_what_was_measured(writes: str, tmp_path: Path) -> None:
    """Once a sensor's effect that wrote into a column changed it for whatever was asked next."""
    write_inputs(tmp_path)
    write_extension(tmp_path, "effects/sensor/warm.py", WARM.replace("WRITES", writes))
    (tmp_path / "path.csv").write_text(
        "theta_1_rad,theta_2_rad,l_1_m,l_2_m,temperature_C\n0,1,0,-0.015,20\n0,1,0,-0.03,25\n"
    )
    done = run(tmp_path, "ctrplan simulate my_pair.toml path.csv -o out --set effects.warm.percent=1")
    assert done.returncode == 1 and "effects.warm: sensor: ValueError" in done.stderr, done.stderr
    assert "read-only" in done.stderr and done.stderr.count("\n") == 1
