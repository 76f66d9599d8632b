"""Damaged robot and scenario files: read, or refused in one sentence with file, key, value and rule."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_input import FUZZ, NUMBERS, assert_names_the_fault, cases
from places import SCENARIOS

from ctrplan.errors import CtrplanError, InputError
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.robot_file import load_robot
from ctrplan.files.scenario_file import load_scenario
from ctrplan.measurement.measurements import Measurements
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import bare_scenario
from ctrplan.scenario.scenario import Scenario

ROBOTS = {path.stem: path.read_text() for path in sorted((SCENARIOS / "robots").glob("*.toml"))}
PROBLEMS = {name: (SCENARIOS / f"{name}.toml").read_text() for name in ("pair_free", "ribs", "vessel")}
TEXT = st.text(st.characters(codec="utf-8"), max_size=8)
VALUES = (
    NUMBERS
    | st.sampled_from(
        ["", '""', "true", "[]", "{}", "2020-01-01", "12:00:00", "[nan]", "[[[]]]", "{a = 1}", "'x'", "--"]
    )
    | st.sampled_from(['"../../../etc/passwd"', '"/dev/zero"', r'"a\u0000b"', '"."', r'"\n<script>"', "0x7fffffffffff"])
    | st.lists(NUMBERS, max_size=13).map(lambda numbers: f"[{', '.join(numbers)}]")
    | TEXT
)
# What happens to a file's text: (kind, share of the way through it, what is put there).
DAMAGE = st.lists(
    st.tuples(
        st.sampled_from(["value", "value", "value", "key", "drop", "twice", "swap", "insert"]),
        st.floats(0, 0.999),
        VALUES,
    ),
    min_size=1,
    max_size=3,
)


def damaged(text: str, changes: list[tuple[str, float, str]]) -> bytes:
    """The text with lines lost, doubled and swapped, and keys and values replaced."""
    lines = text.splitlines()
    for kind, share, new in changes:
        if not lines:
            return encoded(new)
        at = int(share * len(lines))
        if kind == "value":
            places = [k for k, line in enumerate(lines) if re.match(r"\s*[\w\"' ]+=", line)]
            at = places[int(share * len(places))] if places else at
            lines[at] = lines[at].partition("=")[0] + "= " + new
        elif kind == "key":
            lines[at] = new + lines[at][len(lines[at].partition("=")[0]) :]
        elif kind == "drop":
            del lines[at : at + 1 + len(new) % 4]
        elif kind == "twice":
            lines[at:at] = lines[at : at + 1 + len(new) % 7]
        elif kind == "swap":
            other = (at + 1 + len(new)) % len(lines)
            lines[at], lines[other] = lines[other], lines[at]
        else:
            lines.insert(at, new)
    return encoded("\n".join(lines))


def encoded(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("made") / "up"
    shutil.copytree(SCENARIOS, place)
    return place


def check_reading(read: Callable[[Path], object], kind: type, file: Path, content: bytes) -> None:
    """What was read is of the kind, or the refusal names the fault."""
    file.write_bytes(content)
    try:
        assert isinstance(read(file), kind)
    except InputError as error:
        assert_names_the_fault(error, str(file))


@cases(300)
@given(st.sampled_from(sorted(ROBOTS)), DAMAGE)
def test_a_damaged_robot_file_is_read_or_refused_in_one_sentence(
    folder: Path, name: str, changes: list[tuple[str, float, str]]
) -> None:
    check_reading(load_robot, Robot, folder / "robot.toml", damaged(ROBOTS[name], changes))


NUMBER = re.compile(r"(\s*[\w\"']+\s*=\s*)(\[.*\]|-?[\d.e+-]+)\s*(#.*)?$")
EXTREMES = ("5e-324", "-5e-324", "1e-200", "1e160", "1.7e308", "-1.7e308")


def numbers() -> dict[str, list[tuple[int, re.Match[str]]]]:
    """Lines with a number of each robot file: of each key in the first file that has it, and in every one if FUZZ."""
    found, tried = dict[str, list[tuple[int, re.Match[str]]]](), set[tuple[str, str]]()
    for name in sorted(ROBOTS):
        own, table = dict[int, tuple[str, str]](), ""
        matches = {k: parts for k, line in enumerate(ROBOTS[name].splitlines()) if (parts := NUMBER.match(line))}
        for k, line in enumerate(ROBOTS[name].splitlines()):
            table = line.strip() if line.lstrip().startswith("[") else table
            if k in matches:
                own[k] = table, line.split("=")[0].strip()
        if rows := [(k, matches[k]) for k, key in own.items() if FUZZ or key not in tried]:
            found[name] = rows
        tried |= set(own.values())
    return found


NUMBERS_OF = numbers()


@pytest.mark.parametrize("name", NUMBERS_OF)
def test_no_number_of_a_robot_file_is_too_small_or_too_large_for_its_reader(folder: Path, name: str) -> None:
    """Products of tiny numbers are zero and those of huge ones infinite: a radius of 1 / 0 was a traceback."""
    lines, file = ROBOTS[name].splitlines(), folder / "robot.toml"
    for k, parts in NUMBERS_OF[name]:
        for new in EXTREMES:
            value = f"[{', '.join([new] * len(parts[2].split(',')))}]" if parts[2].startswith("[") else new
            content = "\n".join([*lines[:k], parts[1] + value, *lines[k + 1 :]])
            check_reading(load_robot, Robot, file, encoded(content))


@cases(200)
@given(st.sampled_from(sorted(PROBLEMS)), DAMAGE)
def test_a_damaged_scenario_file_is_read_or_refused_in_one_sentence(
    folder: Path, name: str, changes: list[tuple[str, float, str]]
) -> None:
    check_reading(load_scenario, Scenario, folder / "scenario.toml", damaged(PROBLEMS[name], changes))


@cases(100)
@given(st.sampled_from(sorted(ROBOTS)), st.integers(0, 5000), st.binary(max_size=6), st.integers(0, 50))
def test_bytes_lost_and_put_into_a_robot_file(folder: Path, name: str, at: int, new: bytes, lost: int) -> None:
    content = ROBOTS[name].encode()
    at %= len(content)
    check_reading(load_robot, Robot, folder / "robot.toml", content[:at] + new + content[at + lost :])


MAPPING = """
header = false
separator = ";"
tubes = "innermost first"
values = "commanded"
rotations = "wrapped"

[[run]]
file = "log.txt"
tracker = "a"
frame = { position_mm = [1, 2, 3], quaternion_wxyz = [1, 0, 0, 0] }
[[run]]
joints = "log.txt"
poses = "log.txt"
tracker = "b"
frame = "unknown"

[columns]
time = 1
theta = [3, 2]
l = ["-5", "4"]
position = [6, 7, 8]
tangent = ["", 9, 10]
more = { load = 11 }

[units]
theta = "deg"
l = "mm"
position = "mm"
time = "ms"

[zero]
theta_deg = [0, 10]
l_mm = [-1, 0]
"""


@cases(150)
@given(DAMAGE)
def test_a_damaged_mapping_file_is_read_or_refused_in_one_sentence(
    folder: Path, changes: list[tuple[str, float, str]]
) -> None:
    robot = load_robot(folder / "robots" / "table_1_pair.toml")
    rows = [f"{k};{5 * k};{7 * k};-1;{20 + k};{k};{-k};{100 + k};0.6;0.8;{k}" for k in range(1, 9)]
    (folder / "log.txt").write_text("\n".join(rows))
    check_reading(
        lambda file: load_measurements(file, robot), Measurements, folder / "mapping.toml", damaged(MAPPING, changes)
    )


@cases(30)
@given(st.sampled_from(["table_1_pair", "table_5_pair"]), DAMAGE)
def test_a_robot_that_was_read_has_a_bound_or_says_why_not(
    folder: Path, name: str, changes: list[tuple[str, float, str]]
) -> None:
    """What the reader lets through, the mechanics must bear: a status or one sentence, never anything else."""
    file = folder / "robot.toml"
    file.write_bytes(damaged(ROBOTS[name], changes))
    try:
        robot = load_robot(file)
        theta_b, l_b = robot.drive.collars(bare_scenario(robot).start)
        bound = robot.bound(theta_b, l_b)
    except CtrplanError as error:
        assert str(error).isprintable()
        return
    assert bound.position_m >= 0 or bound.position_m != bound.position_m
