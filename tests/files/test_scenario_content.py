"""Whatever a scenario's content is: a scenario comes out, or one sentence."""

from __future__ import annotations

import contextlib
import copy
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from written_scenario import SCENARIO, place

from ctrplan.anatomy.mesh_file import load_mesh
from ctrplan.errors import InputError
from ctrplan.files.measurement_file import load_joint_path, load_measurements
from ctrplan.files.robot_file import load_robot, robot_from_dict
from ctrplan.files.scenario_file import load_scenario, scenario_from_dict
from ctrplan.scenario.scenario import Scenario

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths of everything within a document."""
    yield path
    for key, item in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from places(item, (*path, key))


CONTENT = tomllib.loads(SCENARIO)
VALUES = st.one_of(
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=5),
    st.lists(st.floats() | st.integers(-9, 9), max_size=4),
    st.dictionaries(st.text(max_size=3) | st.sampled_from(["rotate outer", "tip_mm", "name"]), st.floats(), max_size=3),
)


@pytest.fixture(scope="module")
def scenario_path(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("shared") / "case"
    place(folder)
    return str(folder / "scenario.toml")


@settings(max_examples=200, deadline=None)
@given(changes=st.lists(st.tuples(st.sampled_from(list(places(CONTENT))[1:]), VALUES), min_size=1, max_size=3))
def test_any_content_gives_a_scenario_or_an_input_error(
    scenario_path: str, changes: list[tuple[tuple[Any, ...], Any]]
) -> None:
    content = copy.deepcopy(CONTENT)
    for path, value in changes:
        with contextlib.suppress(KeyError, IndexError, TypeError):  # a place that an earlier change removed
            table = content
            for key in path[:-1]:
                table = table[key]
            table[path[-1]] = value
    try:
        assert isinstance(scenario_from_dict(content, file=scenario_path), Scenario)
    except InputError as error:
        assert str(error).isprintable()


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: scenario_from_dict(None), "must be a mapping with the keys of a scenario file"),
        (lambda: scenario_from_dict([("name", 1)]), "must be a mapping with the keys of a scenario file"),
        (lambda: robot_from_dict(None), "must be a mapping with the keys of a robot file"),
        (lambda: scenario_from_dict({}, overrides=None), "overrides"),
        (lambda: scenario_from_dict({}, overrides=[1]), "overrides"),
        (lambda: robot_from_dict({}, overrides=None), "overrides"),
        (lambda: load_scenario(None), "must be the path of a TOML file"),
        (lambda: load_robot(b"robot.toml"), "must be the path of a TOML file"),
        (lambda: load_measurements(None, None), "must be the path of a CSV file"),
        (lambda: load_joint_path(3, None), "must be the path of a CSV file"),
        (lambda: load_mesh(None), "must be the path of a mesh"),
    ],
)
def test_what_is_no_file_and_no_content_is_refused_in_one_sentence(call: Callable[[], object], sentence: str) -> None:
    with pytest.raises(InputError) as caught:
        call()
    assert sentence in str(caught.value) and str(caught.value).isprintable()


def test_numbers_of_numpy_are_numbers(scenario_path: str) -> None:
    content = {**CONTENT, "base": {**CONTENT["base"], "position_mm": np.array([1, 2, 3])}}
    np.testing.assert_allclose(scenario_from_dict(content, file=scenario_path).base_position_m, [1e-3, 2e-3, 3e-3])
