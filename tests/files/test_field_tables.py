"""Tables and documents as programs and people leave them: read, or one sentence names what is in the way."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured_data import measured, pair_robot, waypoints, write_csv

import ctrplan
from ctrplan.errors import InputError
from ctrplan.files.measurement_file import load_joint_path, load_measurements

ROBOT = pair_robot()
DATA = measured(ROBOT, waypoints(ROBOT, 6))


@pytest.fixture(scope="module")
def text(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("tables") / "a.csv"
    write_csv(path, DATA)
    return path.read_text()


def refusal(path: Path, content: str | bytes) -> str:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as caught:
        load_measurements(path, ROBOT)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("name", ["a.csv", "a.toml", "a.json", "a.fcsv", "a.mrk.json"])
@pytest.mark.parametrize(
    ("content", "phrase"),
    [
        (b"", "is empty"),
        (b" \n\n", "is empty"),
        (b"<!DOCTYPE html>\n<p>404", "is a web page"),
        (b"version https://git-lfs.github.com/spec/v1\noid", "is a pointer of Git LFS"),
        ("x_m,y_m\n1,2\n".encode("utf-16"), "is not UTF-8 text, but UTF-16: save it as UTF-8"),
        (gzip.compress(b"x_m,y_m\n1,2\n", mtime=0), "is packed by gzip: unpack it first"),
        (b"PK\x03\x04 of a spreadsheet", "is packed by zip: unpack it first"),
    ],
)
def test_what_is_no_text_of_a_person_is_called_what_it_is(
    name: str, content: bytes, phrase: str, tmp_path: Path
) -> None:
    from ctrplan.files.slicer_markups import read_markups

    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=phrase) as caught:
        if name.endswith(("fcsv", "mrk.json")):
            read_markups(path)
        else:
            ctrplan.check(path, robot=ROBOT)
    assert str(caught.value).startswith(str(path))


def test_a_line_of_spreadsheets_is_no_row(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("sep=,\n" + text)
    np.testing.assert_allclose(load_measurements(tmp_path / "a.csv", ROBOT).position_m, DATA.position_m)


@pytest.mark.parametrize("value", ["0", "0.0", "-0.0"])
def test_a_point_at_nought_is_one_that_was_not_seen(value: str, text: str, tmp_path: Path) -> None:
    head, *rows = text.splitlines()
    names, cells = head.split(","), rows[1].split(",")
    for name in ("x_m", "y_m", "z_m"):
        cells[names.index(name)] = value
    told = refusal(tmp_path / "a.csv", "\n".join([head, rows[0], ",".join(cells), *rows[2:]]))
    assert "row 2, x_m" in told and "as trackers write what they do not see: leave such poses out" in told


def test_sentences_name_titles_units_cases_and_missing_values(text: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    head, *rows = text.splitlines()
    assert "is its line a title? One begins with #" in refusal(path, f"% measured today\n{text}")
    units = ",".join("rad" if "rad" in name else "m" for name in head.split(","))
    assert "'rad': must be a number, a row of units begins with #" in refusal(path, "\n".join([head, units, *rows]))
    assert "is missing (is THETA_1_RAD meant?)" in refusal(path, text.replace(head, head.upper()))
    cells = rows[1].split(",")
    cells[head.split(",").index("x_m")] = "-3.697314E28"  # of NDI's trackers
    assert "left empty where nothing was measured" in refusal(path, "\n".join([head, rows[0], ",".join(cells)]))


def test_whole_degrees_in_a_column_of_radians_are_said(tmp_path: Path) -> None:
    rows = "".join(f"0,{30 * k},0,-0.0048\n" for k in range(7))
    (tmp_path / "a.csv").write_text(f"theta_1_rad,theta_2_rad,l_1_m,l_2_m\n{rows}")
    (note,) = [note for note in load_joint_path(tmp_path / "a.csv", ROBOT).notes if "degrees" in note]
    assert note.endswith("rotations go to 180 rad, in whole numbers: are these degrees?")


def test_check_says_how_long_measurements_took_and_that_tangents_point_back(tmp_path: Path) -> None:
    assert DATA.time_s is not None
    late = replace(DATA, tangent=-DATA.tangent, time_s=DATA.time_s * 1e3)
    write_csv(tmp_path / "a.csv", late)
    result = ctrplan.check(tmp_path / "a.csv", robot=ROBOT)
    assert any(f"they took {np.ptp(late.time_s) / 3600:.3g} h" in line for line in result.lines)
    assert [flag for flag in result.flags if "hold them as (-tx, -ty, -tz) (tx, ty, tz): read so" in flag]
    write_csv(tmp_path / "b.csv", DATA)
    assert ctrplan.check(tmp_path / "b.csv", robot=ROBOT).flags == ()


def with_columns(path: Path, text: str, **columns: list[str]) -> tuple[list[str], list[str]]:
    """Columns beside the joints that are read of a table with more of them, and what is said of those that are not."""
    header, *rows = text.splitlines()
    lines = [",".join([header, *columns])]
    cells = zip(*([values[k % len(values)] for k in range(len(rows))] for values in columns.values()), strict=True)
    lines += [",".join([row, *more]) for row, more in zip(rows, cells, strict=True)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    data = load_measurements(path, ROBOT)
    return list(data.more), [note.partition(": ")[2] for note in data.warnings if "not read" in note]


def test_a_column_that_is_not_read_is_said(text: str, tmp_path: Path) -> None:
    """Notes are none of the data's; a typing error in a temperature once made the whole column vanish."""
    path = tmp_path / "a.csv"
    assert with_columns(path, text, note=["calm", ""], n=["1"]) == (["n"], ["column note holds text and is not read."])
    both = with_columns(path, text, note=["calm"], who=["I", "you"])
    assert both == ([], ["columns note, who hold text and are not read."])
    typo = ["21", "21", "warm", *["22"] * 100]
    (said,) = with_columns(path, text, temperature_C=typo)[1]
    assert said == "column temperature_C is not read: row 3, temperature_C = 'warm' must be a number."
    assert with_columns(path, text, temperature_C=["21", "", "n/a"], empty=[""]) == (["temperature_C"], [])
