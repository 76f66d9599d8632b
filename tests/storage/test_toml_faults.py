"""The walk that names a fault finds one exactly where msgspec, which reads the file, refuses."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ctrplan.files.robot_file import RobotEntry
from ctrplan.files.scenario_file import ScenarioEntry
from ctrplan.storage.toml_faults import first_fault


class Inner(msgspec.Struct, forbid_unknown_fields=True):
    """A table in a table."""

    size_mm: Annotated[float, msgspec.Meta(gt=0, le=5)]
    kind: Literal["a", "b"] | None = None


class Outer(msgspec.Struct, forbid_unknown_fields=True):
    """One of every kind that files have."""

    name: Annotated[str, msgspec.Meta(min_length=1, max_length=3)]
    inner: list[Inner] = []
    point: tuple[float, float] | None = None
    interval: float | list[float] = 0.0
    joints: dict[str, Any] | None = None
    count: Annotated[int, msgspec.Meta(ge=1, lt=9)] = 1
    on: bool = True


SCALARS = st.none() | st.booleans() | st.integers(-9, 9) | st.floats(-9, 9) | st.text("ab", max_size=4) | st.dates()
INNER = st.dictionaries(st.sampled_from(["size_mm", "kind", "size", "x"]), SCALARS, max_size=2)
VALUES = SCALARS | st.lists(SCALARS, max_size=3) | INNER | st.lists(INNER, max_size=2)
KEYS = st.sampled_from([*Outer.__struct_fields__, "x"])


def refused(content: Any, schema: type[msgspec.Struct]) -> bool:
    try:
        msgspec.convert(content, schema)
    except msgspec.ValidationError:
        return True
    return False


@settings(max_examples=1000)
@given(st.dictionaries(KEYS, VALUES, max_size=3).map(lambda more: {"name": "a", **more}) | VALUES)
def test_a_fault_is_found_where_msgspec_refuses(content: Any) -> None:
    assert (first_fault(content, Outer) is not None) == refused(content, Outer)


UNKNOWN = "unknown key, known ones are name, and optional inner, point, interval, joints, count, on"


@pytest.mark.parametrize("schema", [RobotEntry, ScenarioEntry])
@given(st.data())
def test_schemas_of_files_are_walked_as_they_are_read(schema: type[msgspec.Struct], data: st.DataObject) -> None:
    keys = st.sampled_from(schema.__struct_fields__)
    content = data.draw(st.dictionaries(keys, VALUES, max_size=4))
    assert (first_fault(content, schema) is not None) == refused(content, schema)


@pytest.mark.parametrize(
    ("change", "path", "rule"),
    [
        ({"inner": [{"size_mm": 1}, {"size_mm": 6}]}, ("inner", 1, "size_mm"), "must be above 0 and at most 5"),
        ({"inner": [{"size_mm": 0}]}, ("inner", 0, "size_mm"), "must be above 0 and at most 5"),
        ({"count": 0}, ("count",), "must be >= 1"),
        ({"count": 9}, ("count",), "must be < 9"),
        ({"name": ""}, ("name",), "must be text of length >= 1"),
        ({"inner": [{"size_mm": 1, "kind": "c"}]}, ("inner", 0, "kind"), "must be one of a, b"),
        ({"inner": [{}]}, ("inner", 0, "size_mm"), "is missing"),
        ({"inner": [{"size_in": 1}]}, ("inner", 0, "size_in"), "unknown key, expected size_mm (in mm)"),
        ({"point": [1]}, ("point",), "must be a list of length 2"),
        ({"point": [1, True]}, ("point", 1), "must be a number"),
        ({"interval": "x"}, ("interval",), "must be a number or a list"),
        ({"interval": [0, "x"]}, ("interval", 1), "must be a number"),
        ({"joints": 3}, ("joints",), "must be a table"),
        ({"name": "abcd"}, ("name",), "must be text of length <= 3"),
        ({"count": 1.5}, ("count",), "must be a whole number"),
        ({"on": 1}, ("on",), "must be true or false"),
        ({"a.b$`c`": 1}, ("a.b$`c`",), UNKNOWN),
    ],
)
def test_place_and_rule(change: dict[str, Any], path: tuple[str | int, ...], rule: str) -> None:
    assert first_fault({"name": "a", **change}, Outer) == (path, rule)
