"""Public patients, from their files to certified plans, measured against the raw voxels and triangles.

    python benchmarks/patients.py FOLDER OUT [CASE ...]         # of patient_cases.py; default: all
    python benchmarks/patients.py FOLDER OUT --page             # what docs/patients.md, case.md and anatomy.md show
    python benchmarks/patients.py FOLDER OUT --table            # what OUT holds already
    python benchmarks/patients.py FOLDER OUT --commands         # what would be run

FOLDER has the clones that docs/patients.md lists. Each case is a folder below OUT, as `ctrplan case` writes it.
Commands are processes of their own; processor time and largest memory are the operating system's figures of them. The
cases follow each other on one core, from an empty cache; what is measured of them and the plans without the bound in
the cost run on another one meanwhile.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from patient_cases import CASES, PAGE, PublicCase

COMMAND = Path(sys.executable).with_name("ctrplan")
WITHOUT = ["--set", "cost.error_along=0", "--set", "cost.error_goal=0"]


def run_case(case: PublicCase, root: Path, out: Path) -> None:
    """Writes what came of a case to result.json in its folder."""
    folder = out / case.name.replace(" ", "_")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    made = _run([*case.command(root), "-o", str(folder / "case"), "--quiet"], folder, "case.log", core=0)
    _write(folder, {"case": case.name, "organ": case.organ, "robot": case.robot, "made": made})


def judge_case(case: PublicCase, out: Path) -> None:
    """Measures a case that has a plan, and plans it again with a cost that says nothing of the bound."""
    folder = out / case.name.replace(" ", "_")
    found = json.loads((folder / "result.json").read_text())
    if found["made"]["code"] == 0:
        measure = [sys.executable, __file__, str(folder / "case"), "--measure"]  # a process of its own: this one stays
        found |= json.loads(subprocess.run(measure, capture_output=True, check=True).stdout)  # small for what it starts
        plan = ["plan", str(folder / "case" / "placed.toml"), "--allow-outside", "--quiet", "--formats", "csv"]
        found["without"] = _run([*plan, "-o", str(folder / "without"), *WITHOUT], folder, "without.log", core=-1)
    if "without" in found and found["without"]["code"] == 0:
        certificate = json.loads((folder / "without" / "plan.json").read_text())["certificate"]
        found["without_bound_mm"] = certificate["goal_bound_m"] * 1e3
    shutil.rmtree(folder / "cache", ignore_errors=True)
    _write(folder, found)


def _write(folder: Path, found: dict[str, Any]) -> None:
    (folder / "result.json").write_text(json.dumps(found, indent=1) + "\n")


def _run(arguments: list[str], folder: Path, log: str, core: int) -> dict[str, Any]:
    """Runs a command on one core: exit code, clock and processor time [s], largest memory [MB], its last words."""
    begun = time.perf_counter()
    cores = sorted(os.sched_getaffinity(0))
    own = os.environ | {"CTRPLAN_CACHE_DIR": str(folder / "cache")}
    command = ["taskset", "--cpu-list", str(cores[core]), str(COMMAND), *arguments]
    with (folder / log).open("w+") as stream:
        process = subprocess.Popen(command, stdout=stream, stderr=stream, env=own)
        _, status, used = os.wait4(process.pid, 0)
        stream.seek(0)
        words = stream.read().strip().splitlines()
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
    from patient_clearance import measured_clearance  # with ctrplan, which the process that starts others needs not

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


def run(chosen: list[PublicCase], root: Path, out: Path) -> None:
    """All cases one after the other, each judged while the next ones run."""
    begun = time.perf_counter()
    with ThreadPoolExecutor(max_workers=1) as judge:
        judged: list[Future[None]] = []
        for case in chosen:
            run_case(case, root, out)
            judged.append(judge.submit(judge_case, case, out))
            print(f"{time.perf_counter() - begun:4.0f} s  {case.name}", flush=True)
        for one in judged:
            one.result()


def printed(out: Path) -> None:
    """What docs/case.md shows: the words of the case of our own, and of brain 2."""
    make = Path(__file__).resolve().parents[1] / "scenarios" / "make_scan.py"
    folder = out / "lungs"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    subprocess.run([sys.executable, str(make), str(folder / "scan")], check=True, stdout=subprocess.DEVNULL)
    own = _run(["case", str(folder / "scan"), "-o", str(folder / "case"), "--quiet"], folder, "case.log", core=0)
    brain = json.loads((out / "brain_2" / "result.json").read_text())["made"]
    for name, made in (("lungs", own), ("brain 2", brain)):
        print(
            f"{name}: {made['clock_s']} s by the clock, {made['processor_s']} s of a processor, {made['memory_MB']} MB"
        )
        print("\n".join(line for line in made["words"] if line.startswith("[")))


def sizes() -> None:
    """Large volumes and meshes, each in a process of its own, on all cores."""
    for what in ("volume", "mesh"):
        subprocess.run([sys.executable, str(Path(__file__).with_name("scans.py")), what], check=True)


def main() -> None:
    if sys.argv[2:] == ["--measure"]:
        print(json.dumps(_figures(Path(sys.argv[1]))))
        return
    root, out, *names = sys.argv[1:]
    if names == ["--commands"]:
        for case in CASES.values():
            print(shlex.join(["ctrplan", *case.command(Path(root)), "-o", case.name.replace(" ", "_")]))
        return
    wanted = PAGE if names == ["--page"] else names
    chosen = [case for case in CASES.values() if case.name in wanted or not names]
    run(chosen, Path(root).resolve(), Path(out).resolve())
    table(Path(out))
    if names == ["--page"]:
        printed(Path(out).resolve())
        sizes()


if __name__ == "__main__":
    main()
