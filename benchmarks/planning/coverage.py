"""Do plans keep what their uncertainty promises? Virtual robots drawn from a calibrated file's intervals drive them.

    python benchmarks/run.py coverage [SCENARIO ...] [--robots N] [--processes N] [--seed N]

The robot file comes from `ctrplan.calibrate` on made-up measurements of the three-tube robot, friction among what is
fitted, so that it has 95 % intervals, their correlation and model_error_mm. The base is registered within REGISTRATION.
Each virtual robot draws its parameters, its base, what calibration left unexplained, and its friction at the start;
its history is simulated along the plan. Every scenario has draws of its own, and none that the plan itself used. A
scenario that has no plan with all this taken off its clearances is planned without the intervals, and judged with them.
"""

import multiprocessing
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import common
import numpy as np
import tomli_w
from common import ROBOTS, SCENARIOS, table

import ctrplan
from ctrplan import CtrplanError, History, NoAnswerError, Plan, Robot, Scenario, robot_from_dict, scenario_from_dict
from ctrplan.base.arrays import Array
from ctrplan.calibration.parameters import BaseParameters
from ctrplan.robot.robot import StatedIntervals
from ctrplan.scenario.prediction import rows_to_simulate, start_states
from ctrplan.scenario.scenario import anatomy_grid
from ctrplan.storage.toml_document import read_document
from ctrplan.uncertainty.parameters import uncertain_parameters
from ctrplan.uncertainty.tip_slopes import clamped_collars
from ctrplan.uncertainty.worst_case import Draws, wilson

NAMES = ["ribs", "vessel", "heart_chamber", "airway", "deploy"]
REGISTRATION = {"position_sigma_mm": 0.15, "rotation_sigma_deg": 0.05}
TRUTH = {
    "calibration": {"precurvature_factor_1_1": 1.03, "precurvature_factor_3_2": 0.98, "poisson_ratio_2": 0.34},
    "friction": {"mu_1": 0.21, "mu_2": 0.18},
}
NOISE = 3.0  # times 0.1 mm and 0.15 deg
CONFIGURATIONS = 80  # of which those far from snapping are measured, as a laboratory would
APPROACHES = 5  # of each: both ways of every pair, and an oscillation
LEAST_STABILITY, LARGEST_BOUND_M = 1.0, 6e-3
Content = dict[str, Any]


def calibrated(seed: int) -> Content:
    """The content of a calibrated robot file."""
    from measured_data import SIGMA_M, SIGMA_RAD, measured, waypoints

    content = dict(read_document(ROBOTS / "three_tube.toml").content)
    noise = {"position_sigma_mm": NOISE * SIGMA_M * 1e3, "tangent_sigma_deg": float(np.degrees(NOISE * SIGMA_RAD))}
    robot = robot_from_dict(content | {"measurement": noise})
    poses = waypoints(robot, CONFIGURATIONS, seed)
    poses = replace(poses, l_commanded=_inserted(robot, poses.sequence // APPROACHES, seed))
    bounds = robot.bound_many(poses.theta_commanded[poses.rows], poses.l_commanded[poses.rows])
    poses = poses.subset((bounds.stability > LEAST_STABILITY) & (bounds.position_m < LARGEST_BOUND_M))
    data = measured(robot, poses, TRUTH, seed, NOISE)
    base = [p.name for p in BaseParameters().parameters(robot) if "friction" not in p.name]
    names = [name for name in base if name != "stiffness_factor_1"]
    return ctrplan.calibrate(robot, data, [*names, "effects.friction.mu_1", "effects.friction.mu_2"]).robot_content()


def _inserted(robot: Robot, configuration: Array, seed: int) -> Array:
    """(R, 3) base translations [m] of rows: the inner tube anywhere it can be, the same in a configuration's rows."""
    joints, drive = np.zeros((int(configuration.max()) + 1, len(robot.drive.joints))), robot.drive
    joints[:, -1] = np.random.default_rng(seed).uniform(drive.lower[-1], drive.upper[-1], len(joints))
    translations: Array = drive.commanded(joints)[1][configuration]
    return translations


def placed(path: Path, robot: Content, folder: Path) -> Scenario:
    """The scenario with the calibrated robot on its own drive, and a registered base."""
    given = dict(read_document(path).content)
    own = read_document(path.parent / given["robot"]).content
    (folder / "robot.toml").write_text(
        tomli_w.dumps(robot | {key: own[key] for key in ("home", "joint")}), encoding="utf-8"
    )
    changed = {"robot": str(folder / "robot.toml"), "base": {**given.get("base", {}), **REGISTRATION}}
    return scenario_from_dict(given | changed, file=str(path), allow_outside=True)


def planned(scenario: Scenario) -> tuple[Plan, str]:
    """A plan with its uncertainty, and how it was found. Raises NoAnswerError where there is none either way."""
    try:
        return ctrplan.plan(scenario), "with intervals"
    except NoAnswerError:
        effects = {
            name: {key: value for key, value in table.items() if key != "ci95"}
            for name, table in scenario.robot.effects.items()
        }
        bare = replace(scenario.robot, intervals=StatedIntervals(), effects=effects, model_error_m=0.0)
        registration = replace(scenario.registration, position_sigma_m=0.0, rotation_sigma_rad=0.0)
        plan = replace(ctrplan.plan(replace(scenario, robot=bare, registration=registration)), scenario=scenario)
        return replace(plan, uncertainty=ctrplan.uncertainty(plan)), "without"


@dataclass(frozen=True, eq=False)
class Trial:
    """What all virtual robots of a plan share; inherited by the processes."""

    plan: Plan
    joints: Array  # (K, m) simulated
    closest: int  # row where the plan comes nearest to the anatomy
    draws: Draws
    start: Array  # (N,) which start state

    def drive(self, k: int) -> tuple[float, float]:
        """How far robot k ends from the goal, and its clearance beyond the margins where the plan has the least [m]."""
        scenario = self.plan.scenario
        parameters = uncertain_parameters(scenario.robot)
        robot = parameters.robot_at(self.draws.offset[k])
        theta_b, l_b = clamped_collars(parameters, robot, *scenario.robot.drive.commanded(self.joints))
        history = History(robot.mechanics, start_states(scenario)[int(self.start[k])])
        try:
            before = max(self.closest, 1)
            history.follow(theta_b[:before], l_b[:before])
            step = history.advance(theta_b[self.closest], l_b[self.closest])
            tip = history.follow(theta_b[self.closest :], l_b[self.closest :]).position_m[-1]
        except CtrplanError:
            return np.nan, np.nan
        ahead = step.shape.s_m >= 0
        points = step.shape.centreline_m[ahead] + self._moved(step.shape.centreline_m[ahead], k)
        grid, room = anatomy_grid(scenario), np.inf
        if grid is not None:
            located = points @ scenario.base_R.T + scenario.base_position_m
            room = float((grid.sample(located) - step.shape.radius_m[ahead]).min())
        goal = scenario.base_R.T @ (scenario.goal.tip_m - scenario.base_position_m)
        return float(np.linalg.norm(tip + self._moved(tip[None], k)[0] - goal)), room

    def _moved(self, points: Array, k: int) -> Array:
        turned = np.cross(self.draws.turn_rad[k], points)
        moved: Array = self.draws.shift_m[k] + turned + self.draws.unexplained_m[k]
        return moved


_TRIAL: list[Trial] = []


def _drive(k: int) -> tuple[float, float]:
    return _TRIAL[0].drive(k)


def trial(plan: Plan, robots: int, seed: int) -> Trial:
    scenario, samples = plan.scenario, plan.certificate.samples
    rows = rows_to_simulate(scenario.robot, samples.joints, samples.leg)
    closest = plan.uncertainty.closest.sample if plan.uncertainty and plan.uncertainty.closest else 0
    rows = np.unique(np.append(rows, closest))
    parameters = uncertain_parameters(scenario.robot)
    draws = Draws.of(parameters, scenario.registration, scenario.robot.model_error_m, robots, seed=1000 + seed)
    start = np.random.default_rng(seed).integers(0, len(start_states(scenario)), robots)
    return Trial(plan, samples.joints[rows], int(np.searchsorted(rows, closest)), draws, start)


def share(events: Array) -> str:
    low, high = wilson(events)
    return f"{100 * events.mean():.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def row(name: str, how: str, plan: Plan, found: Array) -> list[str]:
    said = plan.uncertainty
    assert said is not None and said.goal.quantile_by_history_m is not None
    miss, room = found[np.all(np.isfinite(found), axis=1)].T
    goal, closest, quantile_m = said.goal, said.closest, said.goal.quantile_by_history_m
    cells = [name, how, f"{len(miss)} of {len(found)}", f"{goal.worst_m * 1e3:.2f}", share(miss <= goal.worst_m)]
    cells += [f"{quantile_m * 1e3:.2f}", share(miss <= quantile_m)]
    cells += [f"{100 * goal.chance_by_history.stated:.1f} %" if goal.chance_by_history else ""]
    cells += [share(miss > plan.scenario.goal.tolerance_m)]
    if closest is None:
        return [*cells, *[""] * 4]
    cells += [f"{closest.worst_m * 1e3:.2f}", share(room >= closest.worst_m)]
    return [*cells, f"{100 * closest.chance_margin.stated:.1f} %", share(room < 0)]


COLUMNS = "scenario | planned | robots | worst miss stated (mm) | within it | 95 % quantile stated (mm) | within it"
COLUMNS += " | chance to miss the tolerance, stated | seen | least room stated (mm) | at least that"
COLUMNS += " | chance to enter the margin, stated | seen at the narrowest sample"


def rows(given: Any, robot: Content) -> Iterator[list[str]]:
    with tempfile.TemporaryDirectory() as folder:
        for name in given.scenarios or NAMES:
            scenario = placed(SCENARIOS / f"{name}.toml", robot, Path(folder))
            try:
                plan, how = planned(scenario)
            except CtrplanError as error:
                yield [name, f"no plan: {str(error).rsplit(': ', 1)[-1]}", *[""] * (COLUMNS.count("|") - 1)]
                continue
            _TRIAL[:] = [trial(plan, given.robots, given.seed + 100 * NAMES.index(name))]
            with ProcessPoolExecutor(given.processes, multiprocessing.get_context("fork")) as pool:
                found = np.array(list(pool.map(_drive, range(given.robots), chunksize=4)))
            yield row(name, how, plan, found)


def main() -> None:
    given = common.arguments(__doc__, ("scenarios*", NAMES), robots=1000, processes=2, seed=0)
    robot = calibrated(given.seed)
    print(f"model_error_mm {robot['model_error_mm']:.2f}")
    table("plans", COLUMNS, rows(given, robot))
