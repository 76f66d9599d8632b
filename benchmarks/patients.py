"""Public patients, from their files to certified plans, measured against the raw voxels and triangles.

    python benchmarks/patients.py FOLDER OUT [CASE ...]         # of patient_cases.py; default: all
    python benchmarks/patients.py FOLDER OUT --table            # what OUT holds already

FOLDER has the clones that docs/patients.md lists. A case's folder below OUT has its scenario, placed scenario, plan and
report. Each command is a process of its own, whose processor time and largest memory are its children's.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

from patient_cases import CASES, Case
from patient_clearance import measured_clearance

ROBOTS = Path(__file__).resolve().parents[1] / "scenarios" / "robots"
COMMAND = Path(sys.executable).with_name("ctrplan")
NO_BOUND = ["--set", "cost.error_along=0", "--set", "cost.error_goal=0"]
LONGEST_S = 1200  # of the clock, for a command


def run_case(case: Case, root: Path, out: Path) -> None:
    """Writes what came of a case to result.json in its folder."""
    folder = out / case.name.replace(" ", "_")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scenario.toml").write_text(case.scenario(root, ROBOTS))
    place = ["place", "scenario.toml", "--allow-outside", "-o", "placed.toml", "--plan", "1"]
    options = ["--radius-mm", str(case.radius_mm), "--cone-deg", str(case.cone_deg), "--quiet"]
    result = {"case": case.name, "organ": case.organ, "robot": case.robot, "place": _run([*place, *options], folder)}
    if result["place"]["code"] == 0:
        plan = ["plan", "placed.toml", "--allow-outside", "--quiet"]
        result["plan"] = _run([*plan, "-o", "plan"], folder)
        result["without"] = _run([*plan, "-o", "without", *NO_BOUND], folder)
        result |= _figures(case, folder)
    (folder / "result.json").write_text(json.dumps(result, indent=1) + "\n")


def _run(arguments: list[str], folder: Path) -> dict[str, object]:
    """Runs a command of ctrplan: exit code, clock and processor time [s], largest memory [MB], its last words."""
    begun = time.perf_counter()
    with (folder / "log.txt").open("w+") as log:
        process = subprocess.Popen([COMMAND, *arguments], cwd=folder, stdout=log, stderr=log)
        _, status, used = os.wait4(process.pid, 0)
        log.seek(0)
        words = log.read().strip().splitlines()
    return {
        "command": "ctrplan " + " ".join(arguments),
        "code": os.waitstatus_to_exitcode(status),
        "clock_s": round(time.perf_counter() - begun, 1),
        "processor_s": round(used.ru_utime + used.ru_stime, 1),
        "memory_MB": round(used.ru_maxrss / 1024),
        "words": words[-30:],
    }


def _figures(case: Case, folder: Path) -> dict[str, object]:
    """Claimed and measured clearance, bounds at the goal with and without the bound in the cost."""
    found: dict[str, object] = {}
    for name in ("plan", "without"):
        if (folder / name / "plan.json").exists():
            certificate = json.loads((folder / name / "plan.json").read_text())["certificate"]
            found[f"{name}_bound_mm"] = certificate["goal_bound_m"] * 1e3
            found[f"{name}_claimed_mm"] = certificate["min_clearance_m"] * 1e3
    if "plan_bound_mm" in found:
        measured = measured_clearance(folder / "placed.toml", ROBOTS / f"{case.robot}.toml", folder / "plan")
        found |= {"measured_mm": measured.room_mm, "nearest": measured.part, "at_s": measured.time_s}
        found |= {"at_mm": measured.point_mm.round(1).tolist(), "shapes": measured.states}
    return found


def table(out: Path) -> None:
    """Prints what the folders below OUT hold."""
    print("| case | robot | processor time (s) | memory (MB) | clearance claimed / measured (mm) | bound (mm) | ... |")
    print("|---|---|---|---|---|---|---|")
    for case in CASES.values():
        file = out / case.name.replace(" ", "_") / "result.json"
        if file.exists():
            _row(json.loads(file.read_text()))


def _row(found: dict) -> None:
    runs = [found[key] for key in ("place", "plan") if key in found]
    spent, memory = sum(run["processor_s"] for run in runs), max(run["memory_MB"] for run in runs)
    clock = sum(run["clock_s"] for run in runs)
    start = f"| {found['case']} | {found['robot']} | {spent:.0f} ({clock:.0f}) | {memory} "
    if "plan_bound_mm" not in found:
        print(start + f"| no plan: {runs[-1]['words'][-1]} | | |")
        return
    room = f"{found['plan_claimed_mm']:.2f} / {found['measured_mm']:.2f}"
    without = f"{found['without_bound_mm']:.2f}" if "without_bound_mm" in found else "no plan"
    print(start + f"| {room} | {found['plan_bound_mm']:.2f} | {without} |")


def main() -> None:
    root, out, *names = sys.argv[1:]
    if names != ["--table"]:
        for name in names or CASES:
            print(name, flush=True)
            run_case(CASES[name], Path(root).resolve(), Path(out))
    table(Path(out))


if __name__ == "__main__":
    main()
