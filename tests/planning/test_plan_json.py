"""plan.json says everything once, in plain finite numbers, as docs/plan.schema.json promises."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from places import ROOT

from ctrplan.plans.plan import Plan, plan_to_json, write_plan_json

SCHEMA = json.loads((ROOT / "docs" / "plan.schema.json").read_text(encoding="utf-8"))
PAIR_WAYPOINTS_DEG = [[0, 0], [60, -120]]


@pytest.fixture(scope="module")
def free_plan(make_plan: Callable[..., Plan]) -> Plan:
    return make_plan(PAIR_WAYPOINTS_DEG, robot="robots/table_1_pair.toml")


def test_schema_is_one() -> None:
    Draft202012Validator.check_schema(SCHEMA)


def test_schema_has_the_present_figures(tmp_path: Path) -> None:
    subprocess.run([sys.executable, str(ROOT / "tools" / "plan_schema.py"), str(tmp_path / "new.json")], check=True)
    made = (tmp_path / "new.json").read_text(encoding="utf-8")
    assert made == (ROOT / "docs" / "plan.schema.json").read_text(encoding="utf-8"), "run tools/plan_schema.py"


def test_content_satisfies_the_schema(plan: Plan, free_plan: Plan) -> None:
    for content in map(plan_to_json, (plan, free_plan)):
        Draft202012Validator(SCHEMA).validate(content)


@pytest.mark.parametrize("key", sorted(SCHEMA["required"]))
def test_schema_misses_what_is_missing(plan: Plan, key: str) -> None:
    content = plan.to_json()
    del content[key]
    assert not Draft202012Validator(SCHEMA).is_valid(content)


def test_file_returns_every_bit(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    write_plan_json(path, plan)
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content == plan_to_json(plan)
    samples, columns = plan.certificate.samples, content["certificate"]["samples"]
    for name in ("leg", "joints", "path_mm", "bound_m", "clearance_m", "tip_m"):
        np.testing.assert_array_equal(columns[name], getattr(samples, name))


def test_names_survive_as_they_are(plan: Plan, tmp_path: Path) -> None:
    name = 'Rippenbogen "süd" </script> \\ 肋骨'
    write_plan_json(tmp_path / "plan.json", replace(plan, scenario=replace(plan.scenario, name=name)))
    assert json.loads((tmp_path / "plan.json").read_text(encoding="utf-8"))["scenario"]["name"] == name


def test_numbers_are_finite(free_plan: Plan) -> None:
    certificate = free_plan.certificate
    failed = replace(certificate.samples, bound_m=np.full_like(certificate.samples.bound_m, np.nan))
    content = plan_to_json(replace(free_plan, certificate=replace(certificate, samples=failed)))
    json.dumps(content, allow_nan=False)
    assert content["certificate"]["min_clearance_m"] is None
    assert set(content["certificate"]["samples"]["clearance_m"]) == {None}
    assert set(content["certificate"]["samples"]["bound_m"]) == {None}
    Draft202012Validator(SCHEMA).validate(content)


def test_types_are_plain(plan: Plan) -> None:
    assert {type(leaf) for leaf in leaves(plan_to_json(plan))} <= {str, int, float, bool, type(None)}


def test_legs_join_and_say_both_units(plan: Plan) -> None:
    legs, joints = plan_to_json(plan)["legs"], plan.scenario.robot.drive.joints
    assert [leg["kind"] for leg in legs] == ["rotation", "translation"]
    for before, after in zip(legs, legs[1:], strict=False):
        assert before["end"] == after["start"]
    for k, leg in enumerate(plan.legs):
        for joint, value in zip(joints, leg.end, strict=True):
            unit, si = ("deg", "rad") if joint.kind == "rotation" else ("mm", "m")
            assert legs[k]["end"][joint.name] == {unit: pytest.approx(value / joint.si_per_unit), si: value}


def test_provenance(plan: Plan) -> None:
    content, scenario = plan_to_json(plan), plan.scenario
    source = {"name": scenario.name, "path": scenario.path, "sha256": scenario.sha256}
    assert content["scenario"] == {**source, "sha256_of": scenario.sha256_of}
    assert content["robot"]["sha256"] == scenario.robot.sha256
    assert content["seed"] == plan.seed and content["trajectory"]["period_s"] == pytest.approx(0.01)


def leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, (dict, list)):
        for entry in value.values() if isinstance(value, dict) else value:
            yield from leaves(entry)
    else:
        yield value
