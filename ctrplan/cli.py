"""The command line: `ctrplan plan` and `ctrplan bound`. Every failure is one sentence on stderr and an exit code."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ctrplan import __version__
from ctrplan.errors import CtrplanError, InputError

if TYPE_CHECKING:
    from ctrplan.planning import Plan
    from ctrplan.planning.planner import Progress

INTERRUPTED = 130

PLAN_EXAMPLES = """examples:
  ctrplan plan scenarios/vessel.toml -o out
  ctrplan plan scenarios/ribs.toml -o out --time 10 --seed 3
  ctrplan plan scenarios/ribs.toml -o out --set cost.error_goal=0 --set robot.contact.1.friction_coefficient=0.3
"""
BOUND_EXAMPLES = """examples:
  ctrplan bound scenarios/robots/three_tube.toml --theta-deg 0 90 180 --l-mm 0 -17 -62.8
  ctrplan bound scenarios/robots/table_1_pair.toml --theta-deg 0 180 --l-mm 0 -17 --set contact.1.friction_coefficient=0.4
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; returns its exit code: 0 done, 1 no answer, 2 malformed input, 130 interrupted."""
    parsed = _parser().parse_args(arguments)
    try:
        return int(parsed.run(parsed))
    except CtrplanError as error:
        print(f"ctrplan: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("ctrplan: interrupted before there was a result.", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader of our output went away
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="ctrplan", description=(__import__("ctrplan").__doc__ or "").splitlines()[0])
    parser.add_argument("--version", action="version", version=f"ctrplan {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    plan = commands.add_parser(
        "plan",
        help="plan a certified motion and write a trajectory for the drive",
        description="Plan a motion that keeps the worst-case friction error small; write plan.json, trajectory.csv, report.html, plan.png.",
        epilog=PLAN_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    plan.add_argument("scenario", metavar="SCENARIO.toml")
    plan.add_argument(
        "-o", "--output", metavar="DIR", default="ctrplan-output", help="folder for the results (default: %(default)s)"
    )
    plan.add_argument("--seed", type=int, default=0, help="seed of the search (default: %(default)s)")
    plan.add_argument(
        "--time", type=float, metavar="S", help="seconds of search (default: the scenario's planner.time_s)"
    )
    plan.add_argument("--quiet", action="store_true", help="no progress bar")
    _add_set(plan, "the scenario's key, or the robot's after robot.")
    plan.set_defaults(run=_plan)

    bound = commands.add_parser(
        "bound",
        help="bound the friction error at one configuration",
        description="Largest tip deviation that friction can cause at one configuration, over all directions of approach.",
        epilog=BOUND_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    bound.add_argument("robot", metavar="ROBOT.toml")
    bound.add_argument(
        "--theta-deg", type=float, nargs="+", required=True, metavar="DEG", help="base rotations, outermost tube first"
    )
    bound.add_argument(
        "--l-mm",
        type=float,
        nargs="+",
        required=True,
        metavar="MM",
        help="base translations, outermost tube first, <= 0",
    )
    bound.add_argument(
        "--accuracy", choices=["search", "certificate"], default="certificate", help="mesh (default: %(default)s)"
    )
    bound.add_argument("--json", action="store_true", help="machine-readable output")
    _add_set(bound, "the robot's key")
    bound.set_defaults(run=_bound)
    return parser


def _add_set(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="overrides",
        help=f"change {what}, e.g. tube.2.poisson_ratio=0.28",
    )


def _plan(arguments: argparse.Namespace) -> int:
    from ctrplan.planning import plan
    from ctrplan.scenario import load_scenario

    if arguments.time is not None and not 0 < arguments.time <= 3600:
        raise InputError("must be above 0 and at most 3600", key="--time", value=arguments.time, unit="s")
    if not 0 <= arguments.seed < 2**31 - 10**5:
        raise InputError("must be from 0 to 2147383647", key="--seed", value=arguments.seed)
    scenario = load_scenario(arguments.scenario, arguments.overrides)
    folder = _output_folder(arguments.output)
    for warning in scenario.warnings:
        print(f"ctrplan: warning: {warning}", file=sys.stderr)
    with _Bar(quiet=arguments.quiet or not sys.stderr.isatty()) as bar:
        result = plan(scenario, seed=arguments.seed, time_s=arguments.time, progress=bar.update)
    _write(result, folder)
    print(_summary(result, folder))
    return INTERRUPTED if result.interrupted else 0


def _output_folder(name: str) -> Path:
    """The folder, made if need be, before any time is spent on planning."""
    folder = Path(name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be made: {error.strerror}", key="--output", value=name) from None
    if not os.access(folder, os.W_OK):
        raise InputError("is not writable", key="--output", value=name)
    return folder


def _write(result: Plan, folder: Path) -> None:
    from ctrplan.export import write_trajectory_csv
    from ctrplan.plan_json import write_plan_json
    from ctrplan.plots import write_plan_png
    from ctrplan.report import write_report

    write_plan_json(folder / "plan.json", result)
    write_trajectory_csv(folder / "trajectory.csv", result.trajectory)
    write_plan_png(folder / "plan.png", result)
    write_report(result, folder / "report.html")


def _summary(result: Plan, folder: Path) -> str:
    c, report = result.certificate, result.reorder
    clearance = (
        "free space" if math.isinf(c.min_clearance_m) else f"{c.min_clearance_m * 1e3:.2f} mm beyond the margins"
    )
    lines = [
        f"{result.scenario.name}: {len(result.legs)} legs, {result.style}, {result.trajectory.duration_s:.1f} s, {c.stops} stops",
        f"  worst-case friction error   {c.goal_bound_m * 1e3:.2f} mm at the goal, {c.worst_bound_m * 1e3:.2f} mm on the way",
        f"  clearance of every shape    {clearance}",
        f"  least stability             {c.min_stability:.2f}, largest strain {100 * c.max_strain:.2f} %",
        f"  cost                        {c.cost_mm:.1f} mm; reordering took {report.cost_before_mm:.1f} to {report.cost_after_mm:.1f} mm",
        f"  certified on                {len(c.samples.leg)} samples, no point moves more than {c.spacing_m * 1e3:.2f} mm between two",
        f"  written to                  {folder}/plan.json, trajectory.csv, report.html, plan.png",
    ]
    if result.style == "simultaneous":
        lines.insert(
            1, "  note: no path of rotations before translations was found in time; joints move simultaneously"
        )
    return "\n".join(lines)


class _Bar:
    """Progress on a terminal: the search with its best cost, then the certificate."""

    def __init__(self, *, quiet: bool) -> None:
        self.quiet = quiet
        self.bar: Any = None
        self.stage = ""

    def __enter__(self) -> _Bar:
        return self

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.close()

    def update(self, progress: Progress) -> None:
        """Moves the bar to a stage's fraction."""
        if self.quiet:
            return
        from tqdm import tqdm

        if progress.stage != self.stage:
            if self.bar is not None:
                self.bar.close()
            self.stage = progress.stage
            self.bar = tqdm(
                total=1.0,
                desc=f"{progress.stage:11}",
                bar_format="{desc}|{bar}| {percentage:3.0f} % {postfix}",
                leave=False,
            )
        self.bar.n = progress.fraction
        if progress.best_cost_mm is not None:
            self.bar.set_postfix_str(f"best cost {progress.best_cost_mm:.1f} mm", refresh=False)
        self.bar.update(0)


def _bound(arguments: argparse.Namespace) -> int:
    import numpy as np

    from ctrplan.robot import load_robot, nesting_violation

    robot = load_robot(arguments.robot, arguments.overrides)
    for key, values in (("--theta-deg", arguments.theta_deg), ("--l-mm", arguments.l_mm)):
        if len(values) != robot.n:
            raise InputError(f"needs {robot.n} values, one per tube, outermost first", key=key, value=values)
        if not all(map(math.isfinite, values)):
            raise InputError("must be finite", key=key, value=values)
    theta_b, l_b = np.radians(arguments.theta_deg), np.multiply(arguments.l_mm, 1e-3)
    if sentence := nesting_violation(robot, theta_b, l_b):
        raise InputError(sentence, key="--l-mm", value=arguments.l_mm, unit="mm")
    for warning in robot.warnings:
        print(f"ctrplan: warning: {warning}", file=sys.stderr)
    found = robot.bound(theta_b, l_b, accuracy=arguments.accuracy)
    print(json.dumps(_bound_json(robot.n, found), indent=1) if arguments.json else _bound_text(robot.n, found))
    return 0 if math.isfinite(found.position_m) else 1


def _bound_json(n: int, found: Any) -> dict[str, Any]:
    def shape(s: Any) -> dict[str, Any]:
        return {
            "tip_mm": [round(x * 1e3, 6) for x in s.tip_m.tolist()],
            "tip_tangent": s.tip_tangent.tolist(),
            "status": s.status.name,
            "residual": s.residual,
            "stability": s.stability,
            "max_strain": s.max_strain,
        }

    import itertools

    finite = math.isfinite(found.position_m)
    return {
        "bound_position_mm": found.position_m * 1e3 if finite else None,
        "bound_tangent_deg": math.degrees(found.tangent_rad) if finite else None,
        "frictionless": shape(found.frictionless),
        "corners": [
            {"phi": list(phi), **shape(s)}
            for phi, s in zip(itertools.product((1, -1), repeat=n - 1), found.corners, strict=True)
        ],
    }


def _bound_text(n: int, found: Any) -> str:
    import itertools

    def tip(s: Any) -> str:
        x, y, z = s.tip_m * 1e3
        return f"tip ({x:9.3f}, {y:9.3f}, {z:9.3f}) mm   {s.status.name}"

    lines = [
        f"worst-case friction error of the tip: {found.position_m * 1e3:.3f} mm, {math.degrees(found.tangent_rad):.3f} deg",
        f"  frictionless    {tip(found.frictionless)}, stability {found.frictionless.stability:.2f}",
    ]
    for phi, s in zip(itertools.product((1, -1), repeat=n - 1), found.corners, strict=True):
        signs = " ".join("+" if p > 0 else "-" for p in phi) or "none"
        lines.append(
            f"  phi = {signs:9} {tip(s)}, {_distance_mm(s, found.frictionless):.3f} mm from the frictionless tip"
        )
    if not math.isfinite(found.position_m):
        lines.append("  a solve did not reach its residual: no bound is promised here")
    return "\n".join(lines)


def _distance_mm(a: Any, b: Any) -> float:
    return math.dist(a.tip_m, b.tip_m) * 1e3


if __name__ == "__main__":
    sys.exit(main())
