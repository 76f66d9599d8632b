"""The curves of plan.png: error bound, margins, joint positions and speeds over time, legs shaded by their kind."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ctrplan.drive.drive import UNITS, Kind
from ctrplan.planning.motion import path_limits
from ctrplan.planning.plan_timing import leg_end_s, sample_time_s
from ctrplan.reports import palette
from ctrplan.reports.plan_words.verdict import millimetres

if TYPE_CHECKING:
    from ctrplan.planning.plan import Plan

LIMIT: dict[str, Any] = {"linestyle": "--", "linewidth": 1.1}


def draw_bound(ax: Axes, plan: Plan) -> None:
    """The bound with its value at the goal and, where one is required, its limit there."""
    samples, limit_m = plan.certificate.samples, plan.scenario.cost.max_error_goal_m
    error_mm = samples.bound_m * 1e3
    _prepare(ax, plan, "Worst-case friction error of the tip", "error bound (mm)")
    ax.plot(sample_time_s(plan), error_mm, color=palette.BOUND, linewidth=2)
    ax.plot(plan.trajectory.duration_s, error_mm[-1], "o", color=palette.GOAL, markersize=7, clip_on=False)
    largest = [float(np.nanmax(error_mm)), 1e-3]
    ends = [(f"at the goal\n{millimetres(samples.bound_m[-1])}", error_mm[-1], palette.GOAL)]
    if limit_m is not None:
        ax.axhline(limit_m * 1e3, color=palette.LIMIT, **LIMIT)
        ends.append((f"allowed\n{millimetres(limit_m)}", limit_m * 1e3, palette.LIMIT))
        largest.append(limit_m * 1e3)
    top = 1.15 * max(largest)
    ax.set_ylim(0, top)
    _end_labels(ax, ends, top)
    patches = [Patch(facecolor=c, edgecolor=palette.MUTED, linewidth=0.4) for c in palette.LEG_KINDS.values()]
    driven = [leg.kind for leg in plan.legs]
    shown = [(patch, kind) for patch, kind in zip(patches, palette.LEG_KINDS, strict=True) if kind in driven]
    _legend(ax, [patch for patch, _ in shown], [f"{kind} leg" for _, kind in shown])


def draw_margins(ax: Axes, plan: Plan) -> None:
    """Clearance and stability, or in free space stability and strain, each with what it must keep."""
    samples, limits = plan.certificate.samples, path_limits(plan.scenario)
    stability = ("stability", samples.stability, limits.stability, palette.STABILITY)
    if np.isfinite(samples.clearance_m).any():
        title = "Clearance beyond the margins, and stability"
        pair = (("clearance (mm)", samples.clearance_m * 1e3, limits.clearance_m * 1e3, palette.CLEARANCE), stability)
    else:
        title = "Stability and strain"
        pair = (stability, ("strain (%)", samples.max_strain * 100, limits.max_strain * 100, palette.STRAIN))
    _prepare(ax, plan, f"{title}; dashed: their limits", "")
    ax.set_xlabel("time (s)")
    other = ax.twinx()
    other.spines["top"].set_visible(False)
    for side, (label, values, limit, colour) in zip((ax, other), pair, strict=True):
        side.plot(sample_time_s(plan), values, color=colour, linewidth=2)
        side.axhline(limit, color=colour, **LIMIT)
        low, high = min(0.0, limit, np.nanmin(values)), max(limit, np.nanmax(values))
        side.set_ylim(low - 0.08 * (high - low), high + 0.12 * (high - low))
        side.set_ylabel(label, color=colour)
        side.tick_params(axis="y", colors=colour)


def draw_positions(ax: Axes, plan: Plan, kind: Kind) -> None:
    """Joints of one kind between their limits, deg or mm."""
    drive, trajectory, (unit, si) = plan.scenario.robot.drive, plan.trajectory, UNITS[kind]
    _prepare(ax, plan, f"{kind.capitalize()}s", f"position ({unit})")
    handles, names = [], []
    for j, colour in enumerate(palette.joint_colours(drive)):
        if drive.joints[j].kind == kind:
            handles += ax.plot(trajectory.time_s, trajectory.position[:, j] / si, color=colour, linewidth=2)
            names.append(drive.names[j])
            for limit in (drive.lower[j], drive.upper[j]):
                if np.isfinite(limit):
                    ax.axhline(limit / si, color=colour, **LIMIT)
    ax.margins(y=0.12)
    limited = np.isfinite(drive.lower[drive.is_rotation == (kind == "rotation")]).any()
    limit_line = [Line2D([], [], color=palette.MUTED, **LIMIT)] if limited else []
    _legend(ax, handles + limit_line, names + ["limit"] * len(limit_line))


def draw_velocities(ax: Axes, plan: Plan) -> None:
    """Every joint's speed as a share of its limit."""
    drive, trajectory = plan.scenario.robot.drive, plan.trajectory
    _prepare(ax, plan, "Speeds, colours as above, translations dotted", "speed (% of limit)")
    share = 100 * np.abs(trajectory.velocity) / drive.max_velocity
    for j, colour in enumerate(palette.joint_colours(drive)):
        ax.plot(trajectory.time_s, share[:, j], "-" if drive.is_rotation[j] else ":", color=colour, linewidth=2)
    ax.axhline(100, color=palette.LIMIT, **LIMIT)
    ax.set_ylim(0, 112)


def _prepare(ax: Axes, plan: Plan, title: str, label: str) -> None:
    """Axis over time with its legs shaded by kind."""
    ax.set_title(title, loc="left", fontsize=11.5, fontweight="bold", color=palette.INK)
    ax.set_ylabel(label)
    ax.set_xlim(0, max(plan.trajectory.duration_s, 1e-3))
    ends = leg_end_s(plan)
    for start, end, leg in zip(np.concatenate([[0.0], ends[:-1]]), ends, plan.legs, strict=True):
        ax.axvspan(start, end, facecolor=palette.LEG_KINDS[leg.kind], edgecolor="none", zorder=0)
        ax.axvline(end, color=palette.MUTED, linewidth=0.6, zorder=0.5)
    ax.grid(axis="y", color=palette.GRID, linewidth=0.8)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(labelsize=10, colors=palette.INK)


def _end_labels(ax: Axes, ends: Sequence[tuple[str, float, str]], top: float) -> None:
    """Texts beside the right end of an axis from 0 to top, moved apart where they would overlap."""
    places = sorted(ends, key=lambda end: end[1])
    share: list[float] = []
    for _, value, _ in places:
        share.append(max(value / top, share[-1] + 0.26 if share else 0.08))
    for (text, _, colour), y in zip(places, share, strict=True):
        ax.text(1.012, y, text, transform=ax.transAxes, color=colour, va="center", fontsize=10.5, fontweight="bold")


def _legend(ax: Axes, handles: Sequence[Line2D | Patch], names: Sequence[str]) -> None:
    """Above the axis, right, so that it covers nothing; names stand as they are, dollar signs included."""
    legend = ax.legend(
        handles, names, loc="lower right", bbox_to_anchor=(1.0, 0.985), ncols=len(names), frameon=False, fontsize=10,
        handlelength=1.6, columnspacing=1.2, borderaxespad=0.2,
    )  # fmt: skip
    for text in legend.get_texts():
        text.set_parse_math(False)
