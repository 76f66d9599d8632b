"""What a diagnosis is worth to the planner: one scenario planned before and after, and how the plans turn out.

python benchmarks/diagnosis_to_plan.py [--scenario FILE] [--robot ROBOT.toml --measurements MEASUREMENTS.csv] [--seed N]

Without files the measurements are made by the tests' own generator (tests/oracles/hidden_effects): the robot of Table
II with friction that its user does not know of, ordinary parameters off as well. The diagnosed robot takes the drive
of the scenario's robot; plans are carried out by the true robot, friction followed along the path from eight start
states.
"""

from __future__ import annotations

import argparse
import copy
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from own_cache import use_own_cache

import ctrplan
from ctrplan.calibration.robot_content import calibrated_content, model_error_m, within_file
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.errors import CtrplanError
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.robot_file import load_robot, robot_from_dict
from ctrplan.files.scenario_file import load_scenario, scenario_from_dict
from ctrplan.planning import Plan
from ctrplan.robot.robot import Robot
from ctrplan.scenario.scenario import Scenario
from ctrplan.storage.toml_document import read_document

ROOT = Path(__file__).resolve().parents[1]
SIZE = 13.0  # of the friction: coefficients of about 0.2, as the paper finds
DRIVE = ("home", "joint")
SEARCH = ["planner.time_s=20"]  # a shared machine may be slow
Content = dict[str, Any]


def made_up(folder: Path, seed: int) -> tuple[Path, Path, Mapping[str, Any]]:
    """Robot file, measurements and truth of a case of the bank."""
    sys.path.insert(0, str(ROOT / "tests" / "oracles"))
    from hidden_effects.case import Case, make, write

    case = Case("friction", "single", seed, (("friction", SIZE),), count=24)
    write(case, folder)
    made = make(case)
    truth = asdict(made.ordinary) | {"friction": made.parameters["friction"]}
    return folder / case.name / "robot.toml", folder / case.name / "measurements.csv", truth


def true_content(believed: Mapping[str, Any], truth: Mapping[str, Any]) -> Content:
    """The robot behind made-up measurements as a robot file."""
    content: Content = copy.deepcopy(dict(believed))
    for i, tube in enumerate(content["tube"]):
        tube["bending_stiffness_Nm2"] *= truth["stiffness"][i]
        tube["poisson_ratio"] = truth["poisson_ratio"][i]
        for section in tube["section"]:
            section["curvature_x_per_m"] *= truth["curvature"][i]
            section["curvature_y_per_m"] *= truth["curvature"][i]
    for i, contact in enumerate(content["contact"], start=1):
        contact["friction_coefficient"] = truth["friction"][f"mu_{i}"]
    return content


def before(found: Diagnosis) -> Content:
    """The robot file of ordinary calibration alone, with the error that leaves on unseen poses."""
    return calibrated_content(
        within_file(found.base.fit), (), found.data, model_error_m(found.gap.before_m, found.noise.position_m)
    )


def with_drive(content: Content, scenario: Scenario) -> Content:
    """The robot on the drive of the scenario's own."""
    own = scenario.robot.content
    driven = content | {key: own[key] for key in DRIVE if key in own}
    for tube, other in zip(driven["tube"], own["tube"], strict=True):
        tube |= {key: other[key] for key in ("collar_length_mm",) if key in other}
    return driven


def planned(path: Path, robot: Content, folder: Path, seed: int) -> Plan:
    """The scenario planned for a robot. Raises CtrplanError where there is no plan."""
    (folder / "robot.toml").write_text(tomli_w.dumps(robot), encoding="utf-8")
    content = dict(read_document(path).content) | {"robot": str((folder / "robot.toml").resolve())}
    scenario = scenario_from_dict(content, file=str(path), overrides=SEARCH, allow_outside=True)
    return ctrplan.plan(scenario, seed=seed)


def arrivals_m(plan: Plan, true: Robot) -> np.ndarray:
    """(S,) how far the true robot's tip ends from the goal, over the friction states it may start in."""
    scenario = plan.scenario
    goal = np.asarray(scenario.goal.tip_m)
    theta, l = true.drive.collars(np.concatenate([np.linspace(leg.start, leg.end, 40) for leg in plan.legs]))  # noqa: E741
    starts = [phi for phi in product((-1.0, 0.0, 1.0), repeat=true.n - 1) if any(phi)]
    tips = [true.history(start).follow(theta, l).position_m[-1] for start in starts]
    placed = np.array(tips) @ np.asarray(scenario.base_R).T + np.asarray(scenario.base_position_m)
    return np.linalg.norm(placed - goal, axis=1)


def describe(label: str, plan: Plan, true: Robot | None) -> str:
    c, model_m = plan.certificate, plan.scenario.robot.model_error_m
    certified = c.goal_tip_error_m + c.goal_bound_m + model_m
    real = "" if true is None else f"{np.nanmax(arrivals_m(plan, true)) * 1e3:.2f}"
    predicted = c.goal_predicted_m
    numbers = (c.length_mm, *(1e3 * x for x in (c.goal_tip_error_m, predicted, c.goal_bound_m, model_m, certified)))
    return f"| {label} | {' | '.join(f'{x:.2f}' for x in numbers)} | {real} |"


def main() -> None:
    use_own_cache()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", type=Path, default=ROOT / "scenarios" / "ribs.toml")
    parser.add_argument("--robot", type=Path)
    parser.add_argument("--measurements", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, truth = Path(name), None
        robot_file, data_file = given.robot, given.measurements
        if robot_file is None:
            robot_file, data_file, truth = made_up(folder, given.seed)
        robot = load_robot(robot_file)
        found = ctrplan.diagnose(robot, load_measurements(data_file, robot))
        print(f"{found.verdict}: {[t.name for t in found.listed]} in {found.time_s:.0f} s")
        for effect in found.to_json()["effects"]:
            print({key: (p["value"], p["ci95"]) for key, p in effect["parameters"].items()}, "true:", truth)
        scenario = load_scenario(given.scenario)
        true = None if truth is None else robot_from_dict(with_drive(true_content(robot.content, truth), scenario))
        believed = copy.deepcopy(dict(robot.content))
        rows = {"as believed": believed, "calibrated": before(found), "diagnosed": found.robot_content()}
        print(
            "\n| planned with the robot | joint length (mm) | tip without friction to goal (mm) "
            "| predicted friction (mm) | friction bound (mm) | model_error_mm | certified: tip, bound and model (mm) "
            "| the true robot ends at most this far from the goal (mm) |\n|---|---|---|---|---|---|---|---|"
        )
        for label, content in rows.items():
            try:
                print(
                    describe(label, planned(given.scenario, with_drive(content, scenario), folder, 0), true), flush=True
                )
            except CtrplanError as error:
                margin = content.get("model_error_mm", 0.0)
                print(f"| {label} | no plan | | | | {margin:.2f} | {str(error).rsplit(': ', 1)[-1]} | |", flush=True)


if __name__ == "__main__":
    main()
