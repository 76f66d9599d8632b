"""TOML files are read strictly, and an override equals editing the file."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pair_file import PAIR
from places import ROBOTS

from ctrplan import scenario_from_dict
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot
from ctrplan.storage.toml_document import Document, read_document


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refusal(*arguments: Any) -> str:
    with pytest.raises(InputError) as caught:
        load_robot(*arguments)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "place"),
    [("a = 1\nname = ]", "line 2, column 8"), ("a = 1\nb = 2 3\n", "line 2, column 7"), ("a = [", "end of document")],
)
def test_a_syntax_error_names_line_and_column(folder: Path, text: str, place: str) -> None:
    (folder / "robot.toml").write_text(text)
    assert refusal("robot.toml").startswith(f"robot.toml: is not valid TOML at {place}: ")


def test_files_that_are_no_text_are_refused(folder: Path) -> None:
    (folder / "latin.toml").write_bytes(b'name = "\xe9"')
    (folder / "huge.toml").write_bytes(b"#" * 2_000_000)
    (folder / "deep.toml").write_text("a" + ".a" * 2_000 + " = 1")
    assert refusal("latin.toml") == "latin.toml: is not UTF-8 text (byte 8), as TOML files are."
    assert refusal("huge.toml") == "huge.toml: is larger than 1 MB, no robot or scenario file."
    assert refusal("deep.toml") == "deep.toml: is nested too deeply."
    assert refusal("missing.toml") == "missing.toml: does not exist."
    assert refusal(".") == ".: is a folder, not a TOML file."
    assert refusal("a\0b").startswith("a?b: can't be read (")
    assert refusal("latin.toml/robot.toml").startswith("latin.toml/robot.toml: can't be read (")


def test_a_key_or_file_name_can_not_break_the_sentence(folder: Path) -> None:
    (folder / "robot.toml").write_text('"a\\nb.\\u001b" = 1\n' + PAIR)
    assert refusal("robot.toml").startswith("robot.toml: a b.? = 1: unknown key, known ones are tube, ")


def test_a_byte_order_mark_and_windows_lines_are_read(folder: Path) -> None:
    (folder / "plain.toml").write_text(PAIR)
    (folder / "robot.toml").write_bytes(b"\xef\xbb\xbf" + PAIR.replace("\n", "\r\n").encode())
    assert load_robot("robot.toml").sha256 == load_robot("plain.toml").sha256


def test_errors_survive_pickling_with_their_parts() -> None:
    error = InputError("must be > 0", file="a.toml", key="tube.1.x_mm", value=-1, unit="mm")
    copied = pickle.loads(pickle.dumps(error))
    assert str(copied) == str(error) == "a.toml: tube.1.x_mm = -1 mm: must be > 0."
    assert vars(copied) == vars(error)


def test_the_hash_sees_content_and_not_layout(folder: Path) -> None:
    (folder / "a.toml").write_text("# comment\nb = 1\na = [1, 2]\n")
    assert read_document("a.toml").sha256 == Document({"a": [1.0, 2], "b": 1}).sha256
    assert read_document("a.toml").sha256 != Document({"a": [2, 1], "b": 1}).sha256


OVERRIDES = [
    ("tube.2.poisson_ratio=0.28", "poisson_ratio = -0.2", "poisson_ratio = 0.28"),
    ("tube.2.poisson_ratio=.28", "poisson_ratio = -0.2", "poisson_ratio = 0.28"),
    ("tube.1.section.1.length_mm=140.", "length_mm = 150", "length_mm = 140"),
    ("tube.1.section.1.length_mm = 140", "length_mm = 150", "length_mm = 140"),
    ("home.l_mm.2=-18", "l_mm = [0, -17]", "l_mm = [0, -18]"),
    ("contact.1.clearance_mm=0.06", "[[contact]]", "[[contact]]\nclearance_mm = 0.06"),
    ("contact.1.friction_coefficient=[0.1, 0.3]", "friction_coefficient = 0.2", "friction_coefficient = [0.1, 0.3]"),
    ("name=other", 'name = "pair"', 'name = "other"'),
    ('name="a = b"', 'name = "pair"', 'name = "a = b"'),
    ("effects.tip_load.force_x_N=1", "[home]", "[effects.tip_load]\nforce_x_N = 1\n[home]"),
    ("model_error_mm=1", 'name = "pair"', 'name = "pair"\nmodel_error_mm = 1.0'),
]


@pytest.mark.parametrize(("override", "old", "new"), OVERRIDES)
def test_an_override_equals_editing_the_file(folder: Path, override: str, old: str, new: str) -> None:
    (folder / "a.toml").write_text(PAIR)
    assert old in PAIR
    (folder / "b.toml").write_text(PAIR.replace(old, new, 1))
    overridden, edited = load_robot("a.toml", [override]), load_robot("b.toml")
    given = load_robot("a.toml")
    assert overridden.sha256 == edited.sha256
    assert overridden.sha256 != given.sha256 or overridden.name != given.name  # a name is no content
    assert (overridden.tubes, overridden.contacts, overridden.name) == (edited.tubes, edited.contacts, edited.name)


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("tube.3.poisson_ratio=0.3", "robot.toml: tube.3: no such entry to override: positions go from 1 to 2."),
        ("tube.0.poisson_ratio=0.3", "robot.toml: tube.0: no such entry to override: positions go from 1 to 2."),
        (
            "tube.poisson_ratio=0.3",
            "robot.toml: tube.poisson_ratio: no such entry to override: positions go from 1 to 2.",
        ),
        ("name.x=1", "robot.toml: name.x: no such key to override: name is a single value."),
        ("tube.2.poison_ratio=1", "robot.toml: tube.2.poison_ratio = 1: unknown key, did you mean poisson_ratio?"),
        ("tube.2.poisson_ratio=high", "robot.toml: tube.2.poisson_ratio = 'high': must be a number."),
        ("tube.2.poisson_ratio=nan", "robot.toml: tube.2.poisson_ratio = nan: must be a finite number."),
        ("tube.2.poisson_ratio=", "robot.toml: tube.2.poisson_ratio = '': must be a number."),
        ("name=1\nx=2", r"robot.toml: name = '1\nx=2': must be one line of printable text."),
        *((text, None) for text in ("", "=", "=1", "name", "a..b=1", '"=1', "name\n.x=1", "tube.²=1")),
    ],
)
def test_a_bad_override_is_refused_in_one_sentence(folder: Path, override: str, sentence: str | None) -> None:
    (folder / "robot.toml").write_text(PAIR)
    found = refusal("robot.toml", [override])
    assert sentence is None or found == sentence
    assert found.isprintable() and found.endswith((".", "?"))


@given(st.text(max_size=30) | st.from_regex(r"(name|tube|tube\.[0-3]|home\.l_mm)(\.\w+)?=.*", fullmatch=True))
def test_any_override_gives_a_document_or_an_input_error(override: str) -> None:
    content = {"name": "a", "tube": [{"x_mm": 1}, {"x_mm": 2}], "home": {"l_mm": [0, 1]}}
    try:
        assert Document(content).with_overrides([override]).content != content or "=" in override
    except InputError as error:
        assert str(error).isprintable()
    assert content == {"name": "a", "tube": [{"x_mm": 1}, {"x_mm": 2}], "home": {"l_mm": [0, 1]}}


def test_keys_of_a_kind_are_looked_up_once_however_many_tables_are_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """10,000 spheres took 9.1 s of a processor to be read, 1.4 since the keys of each kind are not looked up anew."""
    sphere = {"kind": "sphere", "center_mm": [300, 0, 0], "radius_mm": 1}
    joints = {"rotate inner": 0, "rotate outer": 0, "translate inner": -20}

    def looked_up(count: int) -> int:
        kinds, fields = list[object](), msgspec.structs.fields
        content = {"robot": "table_5_pair.toml", "start": joints, "goal": {"joints": joints}}
        with monkeypatch.context() as patch:
            patch.setattr(msgspec.structs, "fields", lambda kind: kinds.append(kind) or fields(kind))
            scenario_from_dict(content | {"anatomy": [sphere] * count}, file=ROBOTS / "many.toml")
        return len(kinds)

    looked_up(1)
    assert looked_up(20) == looked_up(1)
