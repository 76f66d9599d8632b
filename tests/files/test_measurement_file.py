"""measurements.csv: what is read, and one clear sentence for everything that is wrong with it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured_data import measured, pair_robot, waypoints, write_csv

import ctrplan
from ctrplan.errors import InputError
from ctrplan.files.measurement_file import load_joint_path, load_measurements
from ctrplan.files.robot_file import robot_from_dict

ROBOT = pair_robot()
WITH_COLLAR = replace(ROBOT, tubes=(ROBOT.tubes[0], replace(ROBOT.tubes[1], collar_length_m=3e-3)))
Table = list[list[str]]


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Table:
    path = tmp_path_factory.mktemp("data") / "good.csv"
    write_csv(path, measured(ROBOT, waypoints(ROBOT, 2)))
    return [line.split(",") for line in path.read_text().splitlines()]


def test_what_is_written_is_read(tmp_path: Path) -> None:
    data = measured(ROBOT, waypoints(ROBOT, 2))
    write_csv(tmp_path / "a.csv", data)
    read = load_measurements(tmp_path / "a.csv", ROBOT)
    assert read.count == data.count == 6
    np.testing.assert_array_equal(read.position_m, data.position_m)
    np.testing.assert_allclose(read.tangent, data.tangent, atol=1e-15)
    np.testing.assert_array_equal(read.rows, data.rows)
    assert read.configuration.tolist() == [0, 0, 0, 1, 1, 1]
    assert not read.is_stream and len(read.sha256) == 64


def _text(table: Table) -> str:
    return "\n".join(",".join(row) for row in table) + "\n"


def _with_nan(table: Table, word: str) -> Table:
    """The second pose's row without its pose."""
    k = table[0].index("x_m")
    row = [i for i, cells in enumerate(table) if i and cells[k]][1]
    return [cells[:k] + [word] * len(cells[k:]) if i == row else cells for i, cells in enumerate(table)]


@pytest.mark.parametrize("word", ["nan", "NaN", "NA", "null", "-nan(ind)", "", "--"])
def test_words_of_a_missing_pose_are_one(word: str, table: Table, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(_text(_with_nan(table, word)))
    read = load_measurements(tmp_path / "a.csv", ROBOT)
    assert read.count == 5 and len(read.sequence) == len(table) - 1
    (tmp_path / "b.csv").write_text(_text([[("nan" if c == table[1][2] else c) for c in row] for row in table]))
    with pytest.raises(InputError, match="must be a finite number"):
        load_measurements(tmp_path / "b.csv", ROBOT)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "# made by a recorder\n# 40 rows, and more\n" + text,
        lambda text: "#\n\n  # one, two\n" + text,
        lambda text: text + "# the end\n",
        lambda text: "# " + text,  # numpy.savetxt
        lambda text: "# recorded today\n#" + text,
        lambda text: "\ufeff# recorded today\n" + text,
    ],
)
def test_comments_are_passed_over_and_a_commented_header_is_one(
    change: Callable[[str], str], table: Table, tmp_path: Path
) -> None:
    (tmp_path / "plain.csv").write_text(_text(table))
    (tmp_path / "a.csv").write_text(change(_text(table)), encoding="utf-8")
    read, plain = (load_measurements(tmp_path / name, ROBOT) for name in ("a.csv", "plain.csv"))
    np.testing.assert_array_equal(read.position_m, plain.position_m)
    np.testing.assert_array_equal(read.theta_commanded, plain.theta_commanded)


def test_a_decimal_comma_is_named(table: Table, tmp_path: Path) -> None:
    rows = [[f'"{cell.replace(".", ",")}"' for cell in row] for row in table]
    (tmp_path / "a.csv").write_text(_text(rows))
    with pytest.raises(InputError, match="must be a number, with a point for the decimal comma"):
        load_measurements(tmp_path / "a.csv", ROBOT)


def _set(row: int, column: str, text: str) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        table[row][table[0].index(column)] = text

    return change


def _scale(columns: tuple[str, ...], factor: float) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        for row in table[1:]:
            for column in columns:
                k = table[0].index(column)
                row[k] = repr(float(row[k]) * factor) if row[k] else ""

    return change


def _rename(old: str, new: str) -> Callable[[Table], None]:
    return _set(0, old, new)


def _drop(column: str) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        k = table[0].index(column)
        for row in table:
            del row[k]

    return change


def _drop_two(table: Table) -> None:
    _drop("ty")(table)
    _drop("tz")(table)


def _repeat_header(table: Table) -> None:
    table.insert(5, list(table[0]))


def _exchange(table: Table, one: str, other: str) -> None:
    table[0] = [{one: other, other: one}.get(name, name) for name in table[0]]


def _double_column(table: Table) -> None:
    for row in table:
        row.append(row[3])


def _third_tube(table: Table) -> None:
    for k, row in enumerate(table):
        row += ["theta_3_rad", "l_3_m"] if k == 0 else ["0", "0"]


def _stand_still(table: Table) -> None:
    for name in ("theta_1_rad", "theta_2_rad", "l_1_m", "l_2_m"):
        for row in table[1:]:
            row[table[0].index(name)] = table[2][table[0].index(name)]


def _no_pose(table: Table) -> None:
    for row in table[1:]:
        row[-6:] = [""] * 6


def _commas(table: Table) -> None:
    """Numbers with decimal commas, between the commas of the columns."""
    for row in table[1:]:
        row[:] = [cell.replace(".", ",") for cell in row]


def _every_s(table: Table, step_s: float) -> None:
    for k, row in enumerate(table[1:]):
        row[table[0].index("time_s")] = f"{k * step_s:g}"


@pytest.mark.parametrize(
    ("step_s", "phrase"),
    [
        (2.0, ""),
        (0.5, ""),
        (120.0, ""),
        (4000.0, r"time_s: .*: is it in milliseconds\?"),
        (4e6, r"time_s: .*: is it in microseconds\?"),
        (0.03, r"time_s: .*: is it in minutes\?"),
    ],
)
def test_time_in_another_unit_is_told_by_the_speed_of_the_drive(
    step_s: float, phrase: str, table: Table, tmp_path: Path
) -> None:
    changed = [list(row) for row in table]
    _every_s(changed, step_s)
    (tmp_path / "a.csv").write_text("\n".join(",".join(row) for row in changed))
    told = load_measurements(tmp_path / "a.csv", ROBOT).warnings
    assert len(told) == bool(phrase) and all(re.search(phrase, text) for text in told)
    flags = [text for text in ctrplan.check(tmp_path / "a.csv", robot=ROBOT).flags if "heed no joint" not in text]
    assert len(flags) == bool(phrase) and all(re.search(phrase, text) for text in flags)


REFUSED = {
    "missing column": (_drop("l_2_m"), "l_2_m: is missing"),
    "other unit": (_rename("l_2_m", "l_2_mm"), "l_2_m: is missing, found l_2_mm: columns are in rad and m"),
    "one of a tangent": (_drop_two, "tx: one component of a tangent says nothing"),
    "millimetres": (_scale(("x_m", "y_m", "z_m"), 1000.0), "are these millimetres?"),
    "metres of kilometres": (_scale(("x_m", "y_m", "z_m"), 1e-5), "are these metres?"),
    "translations in mm": (_scale(("l_2_m",), 1000.0), "are these millimetres?"),
    "degrees": (_scale(("theta_2_rad",), 180.0), "are these degrees?"),
    "tangent": (_set(2, "tx", "3.0"), "must be a unit vector"),
    "time": (_set(3, "time_s", "0.5"), "time runs backwards"),
    "repeated header": (_repeat_header, "repeats the header, were files joined?"),
    "doubled column": (_double_column, "the header has this column 2 times"),
    "tube count": (_third_tube, "has joints of 3 tubes, the robot file has 2"),
    "still": (_stand_still, "all joints are constant"),
    "not a number": (_set(4, "theta_2_rad", "left"), "row 4, theta_2_rad = 'left': must be a number"),
    "infinite": (_set(4, "theta_2_rad", "inf"), "must be a finite number"),
    "half a pose": (_set(2, "tz", ""), "row 2, tz: is empty, a pose needs all of"),
    "no pose": (_no_pose, "holds no pose"),
    "not nested": (_set(2, "l_2_m", "0.01"), "row 2: "),
    "no header": (lambda table: table.pop(0), "header: is missing: the first row holds numbers"),
    "x alone in mm": (_scale(("x_m",), 1000.0), "beyond the reach of 0.2 m, are these millimetres or centimetres?"),
    "decimal commas": (lambda table: _commas(table), "decimal commas"),
    "innermost first": (
        lambda table: _exchange(table, "l_1_m", "l_2_m"),
        "must be at least 3 mm apart, the collar of tube 2: are the tubes innermost first? List the outermost first.",
    ),
    "run comes back": (_set(30, "sequence", "0"), "this run was over"),
}


def test_tubes_that_nest_in_no_order_are_not_said_to_be_in_another(table: Table, tmp_path: Path) -> None:
    changed = [list(row) for row in table]
    for name in ("l_1_m", "l_2_m"):
        for row in range(1, len(changed)):
            _set(row, name, "0")(changed)
    (tmp_path / "a.csv").write_text(_text(changed))
    with pytest.raises(InputError, match="must be at least 3 mm apart, the collar of tube 2[.]$"):
        load_measurements(tmp_path / "a.csv", WITH_COLLAR)


@pytest.mark.parametrize("name", REFUSED)
def test_faults_are_one_sentence(name: str, table: Table, tmp_path: Path) -> None:
    change, sentence = REFUSED[name]
    changed = [list(row) for row in table]
    change(changed)
    path = tmp_path / "bad.csv"
    path.write_text("\n".join(",".join(row) for row in changed) + "\n")
    with pytest.raises(InputError) as error:
        load_measurements(path, WITH_COLLAR)
    assert sentence in str(error.value) and str(error.value).startswith(str(path)) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "is empty"),
        (b"x_m,y_m\n", "must have a header"),
        (b"\xff\xfe", "is not UTF-8"),
        (b"x_m;y_m\n0;0", "by semicolons"),
    ],
)
def test_files_that_are_none(content: bytes, sentence: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(content)
    with pytest.raises(InputError, match=sentence):
        load_measurements(tmp_path / "a.csv", ROBOT)
    with pytest.raises(InputError, match="does not exist"):
        load_measurements(tmp_path / "none.csv", ROBOT)


def test_blank_rows_are_none_in_measurements_as_in_paths(table: Table, tmp_path: Path) -> None:
    lines = [",".join(row) for row in table]
    (tmp_path / "whole.csv").write_text("\n".join(lines))
    (tmp_path / "gaps.csv").write_text("\n".join([*lines[:5], "", "," * (len(table[0]) - 1), " ,", *lines[5:], ",,"]))
    for read in (load_measurements, load_joint_path):
        whole, gaps = (read(tmp_path / name, ROBOT) for name in ("whole.csv", "gaps.csv"))
        np.testing.assert_array_equal(gaps.theta_commanded, whole.theta_commanded)


def test_an_effect_of_the_robot_without_its_column_is_warned_about(table: Table, tmp_path: Path) -> None:
    changed = [list(row) for row in table]
    _drop("time_s")(changed)
    (tmp_path / "a.csv").write_text("\n".join(",".join(row) for row in changed))
    late = pair_robot(effects={"lag": {"tau_s": 0.1}})
    (warning,) = load_measurements(tmp_path / "a.csv", late).warnings
    assert warning.endswith("without a column time_s the robot's lag is left out.")
    assert load_measurements(tmp_path / "a.csv", ROBOT).warnings == ()


def test_a_pair_that_never_turns_is_warned_about(table: Table, tmp_path: Path) -> None:
    changed = [list(row) for row in table]
    for row in changed[1:]:
        row[changed[0].index("theta_2_rad")] = row[changed[0].index("theta_1_rad")] = "0.1"
    path = tmp_path / "a.csv"
    path.write_text("\n".join(",".join(row) for row in changed) + "\n")
    assert "never turn against each other" in load_measurements(path, ROBOT).warnings[0]


def test_rows_nest_where_the_drive_puts_the_collars(tmp_path: Path) -> None:
    """What is commanded may look impossible, and be right for the drive that has this offset."""
    file = tmp_path / "path.csv"
    file.write_text("theta_1_rad,theta_2_rad,l_1_m,l_2_m\n0,0,0,0.001\n0,1,0,-0.01\n")
    offset = robot_from_dict({**ROBOT.content, "effects": {"homing_offset": {"l_2_mm": -2.0}}})
    assert load_joint_path(file, offset).l_commanded[0, 1] == 0.001
    with pytest.raises(InputError, match="row 1: the base of tube 2"):
        load_joint_path(file, ROBOT)


def test_a_row_that_is_written_twice_counts_once(tmp_path: Path) -> None:
    data = measured(ROBOT, waypoints(ROBOT, 4))
    write_csv(tmp_path / "once.csv", data)
    head, *rows = (tmp_path / "once.csv").read_text().splitlines()
    (tmp_path / "twice.csv").write_text("\n".join([head, *(row for row in rows for _ in range(2))]))
    once, twice = (load_measurements(tmp_path / f"{name}.csv", ROBOT) for name in ("once", "twice"))
    np.testing.assert_array_equal(twice.position_m, once.position_m)
    np.testing.assert_array_equal(twice.theta_commanded[twice.rows], once.theta_commanded[once.rows])
    assert any(f"{once.count} rows repeat the row before" in text for text in twice.warnings) and not once.warnings


def test_what_a_tracker_has_done_is_said_before_all_else(tmp_path: Path) -> None:
    """Zeros for what it did not see, tangents too; and an origin of its own, which is no unit."""
    data = measured(ROBOT, waypoints(ROBOT, 2))
    blind = replace(data, position_m=data.position_m.copy(), tangent=data.tangent.copy())
    blind.position_m[1], blind.tangent[1] = 0.0, 0.0
    for name, given, told in (
        ("blind", blind, "tip is 0 in all coordinates"),
        ("moved", replace(data, position_m=data.position_m + [0.5, -1.1, 1.2]), "is that the tracker's frame?"),
        ("inches", replace(data, position_m=data.position_m / 0.0254), "are these centimetres or inches?"),
    ):
        write_csv(tmp_path / f"{name}.csv", given)
        with pytest.raises(InputError, match=re.escape(told)):
            load_measurements(tmp_path / f"{name}.csv", ROBOT)
