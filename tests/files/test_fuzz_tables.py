"""Damaged measurements and joint paths: read, or refused in one sentence with file, row, column, value and rule."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_input import FUZZ, HANG_S, NUMBERS, assert_names_the_fault, cases
from measured_data import pair_robot, waypoints, write_csv

from ctrplan.errors import InputError
from ctrplan.files.measurement_file import load_joint_path, load_measurements

ROBOT = pair_robot()
READERS: dict[str, Callable[..., Any]] = {"measurements": load_measurements, "path": load_joint_path}
CELLS = (
    NUMBERS
    | st.sampled_from(
        ["", " ", '"', '"a', "theta_1_rad", "x_m", "1_000", "0x10", "\N{ARABIC-INDIC DIGIT ONE}", "1,5", "1;5", "-"]
    )
    | st.text(st.characters(codec="utf-8"), max_size=4)
)
# (kind, row's share, column's share, cell)
DAMAGE = st.lists(
    st.tuples(
        st.sampled_from(["cell", "cell", "cell", "header", "row", "column", "twice", "end"]),
        st.floats(0, 0.999),
        st.floats(0, 0.999),
        CELLS,
    ),
    min_size=1,
    max_size=4,
)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[list[str]]]:
    """A place for files, and the cells of a good one."""
    folder = tmp_path_factory.mktemp("tables")
    data = waypoints(ROBOT, 2)
    theta, l = data.theta_commanded[data.rows], data.l_commanded[data.rows]  # noqa: E741
    shapes = [ROBOT.zero_clearance(*row) for row in zip(theta, l, strict=True)]
    tips, tangents = (np.array([getattr(shape, name) for shape in shapes]) for name in ("tip_m", "tip_tangent"))
    write_csv(folder / "good.csv", type(data)(**{**vars(data), "position_m": tips, "tangent": tangents}))
    return folder, [line.split(",") for line in (folder / "good.csv").read_text().splitlines()]


def damaged(cells: list[list[str]], changes: list[tuple[str, float, float, str]]) -> str:
    lines = [list(row) for row in cells]
    for kind, down, across, new in changes:
        row = int(down * len(lines))
        column = int(across * len(lines[row])) if lines[row] else 0
        if kind == "cell" and lines[row]:
            lines[row][column] = new
        elif kind == "header":
            lines[0][min(column, len(lines[0]) - 1)] = new
        elif kind == "row":
            del lines[row]
        elif kind == "column":
            for line in lines:
                del line[column : column + 1]
        elif kind == "twice":
            lines.insert(row, list(lines[row]))
        else:
            lines[row] = lines[row][:column]
        if not lines:
            return new
        lines[0] = lines[0] or [new]
    return "\n".join(",".join(line) for line in lines)


@pytest.mark.parametrize("kind", sorted(READERS))
def test_the_undamaged_table_is_read(kind: str, table: tuple[Path, list[list[str]]]) -> None:
    assert len(READERS[kind](table[0] / "good.csv", ROBOT).theta_commanded) == len(table[1]) - 1


@pytest.mark.parametrize("kind", sorted(READERS))
def test_a_damaged_table_is_read_or_refused_in_one_sentence(kind: str, table: tuple[Path, list[list[str]]]) -> None:
    folder, cells = table
    file = folder / f"{kind}.csv"

    @cases(250)
    @given(DAMAGE)
    def check(changes: list[tuple[str, float, float, str]]) -> None:
        file.write_bytes(damaged(cells, changes).encode("utf-8", "surrogatepass"))
        try:
            read = READERS[kind](file, ROBOT)
        except InputError as error:
            assert_names_the_fault(error, str(file))
            return
        assert np.isfinite(read.theta_commanded).all() and np.isfinite(read.l_commanded).all()
        assert np.all(np.abs(read.sequence) < 2**53)

    check()


@pytest.mark.parametrize("kind", sorted(READERS))
def test_bytes_lost_and_put_into_a_table(kind: str, table: tuple[Path, list[list[str]]]) -> None:
    folder, _ = table
    content, file = (folder / "good.csv").read_bytes(), folder / f"{kind}.csv"

    @cases(100)
    @given(st.integers(0, len(content) - 1), st.binary(max_size=6), st.integers(0, 200))
    def check(at: int, new: bytes, lost: int) -> None:
        file.write_bytes(content[:at] + new + content[at + lost :])
        try:
            READERS[kind](file, ROBOT)
        except InputError as error:
            assert_names_the_fault(error, str(file))

    check()


@pytest.mark.parametrize("kind", sorted(READERS))
@pytest.mark.parametrize("text", ["1e300", "-1e300", "9223372036854775808", "1e15", "0.5"])
def test_a_run_has_a_number_that_is_kept_or_refused(kind: str, text: str, table: tuple[Path, list[list[str]]]) -> None:
    folder, cells = table
    file = folder / f"{kind}.csv"
    file.write_text(damaged([cells[0], *([text, *row[1:]] for row in cells[1:])], []))
    if text == "1e15":
        assert np.all(READERS[kind](file, ROBOT).sequence == 10**15)
        return
    with pytest.raises(InputError, match=r"must be (a whole number of at most 15 digits|from -1e\+20 to 1e\+20)"):
        READERS[kind](file, ROBOT)


@pytest.mark.parametrize("kind", sorted(READERS))
@pytest.mark.parametrize("runs", ["one run", "a run per row"])
def test_reading_takes_time_in_proportion_to_the_rows(kind: str, runs: str, tmp_path: Path) -> None:
    """A million rows are read within seconds, also where every one of them is a run of its own."""
    seconds = []
    for count in (10_000, 1_000_000 if FUZZ else 60_000):
        file = tmp_path / f"{count}.csv"
        each = (f"{k if runs == 'a run per row' else 0},{k},{math.sin(k)}" for k in range(count))
        rows = "\n".join(f"{row},0.5,-0.02,-0.03,0,0,0.08,0,0,1" for row in each)
        file.write_text(f"sequence,time_s,theta_1_rad,theta_2_rad,l_1_m,l_2_m,x_m,y_m,z_m,tx,ty,tz\n{rows}\n")
        began = time.process_time()
        assert len(READERS[kind](file, ROBOT).theta_commanded) == count
        seconds.append((time.process_time() - began) / count)
    assert seconds[1] < 3 * seconds[0] and seconds[1] * 1e6 < 2 * HANG_S, f"{seconds} s per row"


@pytest.mark.parametrize("kind", sorted(READERS))
def test_a_table_of_a_gigabyte_is_refused_by_its_size(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "large.csv"
    with file.open("wb") as stream:
        stream.truncate(10**9)  # takes no room on the disk
    with pytest.raises(InputError, match="is larger than 200 MB") as caught:
        READERS[kind](file, ROBOT)
    assert_names_the_fault(caught.value, str(file))
