"""Public patients, from their files to certified plans, measured against the raw voxels and triangles.

    python benchmarks/patients.py FOLDER OUT [CASE ...]         # of patient_cases.py; default: all
    python benchmarks/patients.py FOLDER OUT --without          # only plans without the bound in the cost
    python benchmarks/patients.py FOLDER OUT --table            # what OUT holds already
    python benchmarks/patients.py FOLDER OUT --commands         # what would be run

FOLDER has the clones that docs/patients.md lists. Each case is a folder below OUT, as `ctrplan case` writes it.
Commands are processes of their own; processor time and largest memory are the operating system's figures of them.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from patient_cases import CASES, PublicCase
from patient_clearance import measured_clearance

COMMAND = Path(sys.executable).with_name("ctrplan")
WITHOUT = ["--set", "cost.error_along=0", "--set", "cost.error_goal=0"]


def run_case(case: PublicCase, root: Path, out: Path) -> None:
    """Writes what came of a case to result.json in its folder."""
    folder = out / case.name.replace(" ", "_")
    folder.mkdir(parents=True, exist_ok=True)
    made = _run([*case.command(root), "-o", str(folder / "case"), "--quiet", "--from", "scenario"], folder / "case.log")
    found: dict[str, Any] = {"case": case.name, "organ": case.organ, "robot": case.robot, "made": made}
    if made["code"] == 0:
        measure = [
            sys.executable,
            __file__,
            str(folder / "case"),
            "--measure",
        ]  # so that this process stays small, since
        found |= json.loads(subprocess.run(measure, capture_output=True, check=True).stdout)  # children start as large
    (folder / "result.json").write_text(json.dumps(found, indent=1) + "\n")


def run_without(case: PublicCase, out: Path) -> None:
    """Plans a case that has a plan again, with a cost that says nothing of the bound."""
    folder = out / case.name.replace(" ", "_")
    file = folder / "result.json"
    found = json.loads(file.read_text()) if file.exists() else {}
    if "plan_bound_mm" not in found or "without" in found:
        return
    plan = ["plan", str(folder / "case" / "placed.toml"), "--allow-outside", "--quiet", "-o", str(folder / "without")]
    found["without"] = _run([*plan, *WITHOUT], folder / "without.log")
    if found["without"]["code"] == 0:
        certificate = json.loads((folder / "without" / "plan.json").read_text())["certificate"]
        found["without_bound_mm"] = certificate["goal_bound_m"] * 1e3
    file.write_text(json.dumps(found, indent=1) + "\n")


def _run(arguments: list[str], file: Path) -> dict[str, Any]:
    """Runs a command of ctrplan: exit code, clock and processor time [s], largest memory [MB], what it said."""
    begun = time.perf_counter()
    with file.open("w+") as log:
        process = subprocess.Popen([COMMAND, *arguments], stdout=log, stderr=log)
        _, status, used = os.wait4(process.pid, 0)
        log.seek(0)
        words = log.read().strip().splitlines()
    return {
        "command": shlex.join(["ctrplan", *arguments]),
        "code": os.waitstatus_to_exitcode(status),
        "clock_s": round(time.perf_counter() - begun, 1),
        "processor_s": round(used.ru_utime + used.ru_stime, 1),
        "memory_MB": round(used.ru_maxrss / 1024),
        "words": words[-30:],
    }


def _figures(case: Path) -> dict[str, Any]:
    """Claimed and measured clearance, the bound at the goal, the report's size."""
    certificate = json.loads((case / "plan" / "plan.json").read_text())["certificate"]
    measured = measured_clearance(case / "placed.toml", case / "robot.toml", case / "plan")
    return {
        "plan_bound_mm": certificate["goal_bound_m"] * 1e3,
        "plan_claimed_mm": certificate["min_clearance_m"] * 1e3,
        "measured_mm": measured.room_mm,
        "nearest": measured.part,
        "at_s": measured.time_s,
        "at_mm": measured.point_mm.round(1).tolist(),
        "shapes": measured.states,
        "report_MB": (case / "plan" / "report.html").stat().st_size / 1e6,
    }


HEADER = "case | robot | processor time (clock), s | memory, MB | clearance certified | worst friction | measured |"
BOUNDS = " bound at the goal | without it in the cost |"


def table(out: Path) -> None:
    """Prints what the folders below OUT hold; clearances and bounds in mm."""
    print(f"| {HEADER}{BOUNDS}\n|{'---|' * 9}")
    for case in CASES.values():
        file = out / case.name.replace(" ", "_") / "result.json"
        if file.exists():
            _row(json.loads(file.read_text()), file.parent / "case" / "plan" / "plan.json")


def _row(found: dict[str, Any], plan: Path) -> None:
    made = found["made"]
    spent = f"{made['processor_s']:.0f} ({made['clock_s']:.0f}) | {made['memory_MB']}"
    start = f"| {found['case']} | `{found['robot']}` | {spent} |"
    if "measured_mm" not in found:
        why = next((words for words in reversed(made["words"]) if words.startswith("ctrplan:")), "")
        print(f"{start} no plan: {why} | | | | |")
        return
    certificate = json.loads(plan.read_text())["certificate"]
    worst = certificate["closest"]["clearance_m"] * 1e3
    clearances = f"{found['plan_claimed_mm']:.2f} | {worst:.2f} | {found['measured_mm']:.2f}"
    without = f"{found['without_bound_mm']:.2f}" if "without_bound_mm" in found else "no plan"
    print(f"{start} {clearances} | {found['plan_bound_mm']:.2f} | {without} |")


def main() -> None:
    if sys.argv[2:] == ["--measure"]:
        print(json.dumps(_figures(Path(sys.argv[1]))))
        return
    root, out, *names = sys.argv[1:]
    if names == ["--commands"]:
        for case in CASES.values():
            print(shlex.join(["ctrplan", *case.command(Path(root)), "-o", case.name.replace(" ", "_")]))
        return
    chosen = [case for case in CASES.values() if case.name in names or not names]
    for case in chosen:
        run_case(case, Path(root).resolve(), Path(out).resolve())
        print(case.name, flush=True)
    for case in chosen or (CASES.values() if names == ["--without"] else []):
        run_without(case, Path(out).resolve())
    table(Path(out))


if __name__ == "__main__":
    main()
