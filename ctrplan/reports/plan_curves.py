"""A plan over time: error bounds, margins, joint positions and speeds as panels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.drive.drive import UNITS, Kind
from ctrplan.planning.motion import path_limits
from ctrplan.planning.plan_timing import leg_end_s, sample_time_s
from ctrplan.reports import palette
from ctrplan.reports.curves import Limit, Mark, Panel, Series, Shade, Timeline
from ctrplan.reports.plan_words.numbers import millimetres

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan

MOST_SAMPLES = 1500  # of a trajectory: more than there are pixels across


def timeline(plan: Plan) -> Timeline:
    """The plan's time, shaded by its legs."""
    ends = leg_end_s(plan).tolist()
    legs = zip([0.0, *ends[:-1]], ends, plan.legs, strict=True)
    shades = (Shade(start, end, leg.kind, palette.LEG_KINDS[leg.kind]) for start, end, leg in legs)
    return Timeline(plan.trajectory.duration_s, tuple(shades))


def error_panel(plan: Plan) -> Panel:
    """How far friction takes the tip [mm]: worst case, prediction, the value at the goal and what is allowed there."""
    samples, limit_m = plan.certificate.samples, plan.scenario.cost.max_error_goal_m
    time_s, bound_mm = sample_time_s(plan), samples.bound_m * MM_PER_M
    series = (
        Series("worst case", time_s, bound_mm, palette.BOUND),
        Series("predicted by history", time_s, samples.predicted_m * MM_PER_M, palette.BOUND, "dotted"),
    )
    stated_m = plan.certificate.goal_bound_m
    at_goal = Mark(f"at the goal\n{millimetres(stated_m)}", stated_m * MM_PER_M, palette.GOAL, True)
    title = "Friction error of the tip"
    if limit_m is None:
        return Panel(title, "error", "mm", series, marks=(at_goal,))
    allowed = Mark(f"allowed\n{millimetres(limit_m)}", limit_m * MM_PER_M, palette.LIMIT, False)
    limits = (Limit(limit_m * MM_PER_M, palette.LIMIT),)
    return Panel(title, "error", "mm", series, limits, "allowed at the goal", (at_goal, allowed))


def direction_panel(plan: Plan) -> Panel:
    """How far friction turns the tip's direction in the worst case [deg]."""
    return _sampled(
        plan,
        "Worst-case friction error of the tip's direction",
        "error",
        "deg",
        np.degrees(plan.certificate.samples.bound_rad),
        palette.BOUND,
    )


def margin_panels(plan: Plan) -> tuple[Panel, ...]:
    """Clearance [mm] (but in free space), stability and strain [%], each with what it must keep."""
    samples, limits = plan.certificate.samples, path_limits(plan.scenario)
    clearance_mm, least_mm = samples.clearance_m * MM_PER_M, limits.clearance_m * MM_PER_M
    rows = [
        ("Clearance beyond the margins", "clearance", "mm", clearance_mm, palette.CLEARANCE, least_mm, "least allowed"),
        ("Stability", "stability", "", samples.stability, palette.STABILITY, limits.stability, "least allowed"),
        ("Strain", "strain", "%", 100 * samples.max_strain, palette.STRAIN, 100 * limits.max_strain, "most allowed"),
    ]
    shown = rows if np.isfinite(samples.clearance_m).any() else rows[1:]
    return tuple(_sampled(plan, *row) for row in shown)


def position_panels(plan: Plan) -> tuple[Panel, ...]:
    """Joints between their limits: rotations [deg], translations [mm], those that there are."""
    kinds = [kind for kind in UNITS if any(joint.kind == kind for joint in plan.scenario.robot.drive.joints)]
    return tuple(_positions(plan, kind) for kind in kinds)


def speed_panel(plan: Plan) -> Panel:
    """Every joint's speed as a share of its limit [%]."""
    drive, trajectory, rows = plan.scenario.robot.drive, plan.trajectory, _shown_rows(plan)
    share = 100 * np.abs(trajectory.velocity[rows]) / drive.max_velocity
    series = tuple(
        Series(name, trajectory.time_s[rows], share[:, j], colour, "solid" if drive.is_rotation[j] else "dotted")
        for j, (name, colour) in enumerate(zip(drive.names, palette.joint_colours(drive), strict=True))
    )
    return Panel("Speeds", "speed", "% of limit", series, (Limit(100.0, palette.LIMIT),), "limit")


def _sampled(
    plan: Plan,
    title: str,
    quantity: str,
    unit: str,
    values: Array,
    colour: str,
    limit: float | None = None,
    limits_are: str = "",
) -> Panel:
    """One quantity at the certificate's samples."""
    limits = () if limit is None else (Limit(limit, palette.LIMIT),)
    return Panel(title, quantity, unit, (Series(title, sample_time_s(plan), values, colour),), limits, limits_are)


def _positions(plan: Plan, kind: Kind) -> Panel:
    drive, trajectory, rows, (unit, si) = plan.scenario.robot.drive, plan.trajectory, _shown_rows(plan), UNITS[kind]
    colours = palette.joint_colours(drive)
    chosen = [j for j, joint in enumerate(drive.joints) if joint.kind == kind]
    series = (
        Series(drive.names[j], trajectory.time_s[rows], trajectory.position[rows, j] / si, colours[j]) for j in chosen
    )
    ends = ((end / si, colours[j]) for j in chosen for end in (drive.lower[j], drive.upper[j]))
    limits = tuple(Limit(float(end), colour) for end, colour in ends if np.isfinite(end))
    return Panel(f"{kind.capitalize()}s", "position", unit, tuple(series), limits, "limits", from_zero=False)


def _shown_rows(plan: Plan) -> NDArray[np.int_]:
    """Rows of the trajectory that are drawn, the first and the last among them."""
    count = len(plan.trajectory.time_s)
    return np.unique(np.linspace(0, count - 1, MOST_SAMPLES).round().astype(int))
