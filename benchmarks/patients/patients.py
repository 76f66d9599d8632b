"""Public patients, from their files to certified plans, measured against the raw voxels and triangles.

    python benchmarks/run.py patients FOLDER OUT [CASE ...]         # of public_patients.toml; default: all
    python benchmarks/run.py patients FOLDER OUT --page             # the cases of docs/patients.md
    python benchmarks/run.py patients FOLDER OUT --commands         # what would be run

FOLDER has the clones that docs/patients.md lists. Each case is a folder below OUT, as `ctrplan case` writes it.
Commands are processes of their own; processor time and largest memory are the operating system's figures of them. The
cases follow each other on one core, from an empty cache; what is measured of them and the plans without the bound in
the cost run on another one meanwhile.
"""

import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import common
from common import ROBOTS, SCENARIOS, again, spent, table

from ctrplan.storage.toml_document import read_document

Place = str | tuple[float, float, float]
COMMAND = Path(sys.executable).with_name("ctrplan")
WITHOUT = ["--set", "cost.error_along=0", "--set", "cost.error_goal=0"]


@dataclass(frozen=True)
class PublicCase:
    """A patient, a robot and a task."""

    name: str
    organ: str
    robot: str
    folder: str  # below the folder with the clones
    target: Place
    entries: tuple[Place, ...]
    avoid: tuple[str, ...] = ()
    lumen: tuple[str, ...] = ()
    phases: tuple[str, ...] = ()  # files of one structure that moves, of which a lumen or obstacle is the first
    more: str = ""
    page: bool = False  # whether docs/patients.md has it

    def command(self, root: Path) -> list[str]:
        """Arguments of ctrplan, without the output folder; ends with a sentence where there is no such patient."""
        own = root / self.folder
        if not own.is_dir():
            sys.exit(f"{own}: is not there, and needed for {self.name}; docs/patients.md says what to clone")
        files = [str(own / file) for file in (*self.lumen, *self.avoid) if file not in self.phases]
        roles = [word for file in self.lumen for word in ("--lumen", file)]
        roles += [word for file in self.avoid for word in ("--avoid", file)]
        places = ["--target", *_place(own, self.target)]
        places += [word for entry in self.entries for word in ("--entry", *_place(own, entry))]
        robot = ["--robot", str(ROBOTS / f"{self.robot}.toml")]
        moving = ["--phases", *(str(own / file) for file in self.phases)] if self.phases else []
        return ["case", *files, *moving, *roles, *places, "--frame", "RAS", *robot, *self.more.split()]


def _place(folder: Path, place: Place) -> list[str]:
    """A point [mm] of a file with three numbers, or with a 4 x 4 matrix whose last column counts."""
    if not isinstance(place, str):
        return [f"{x:g}" for x in place]
    rows = [list(map(float, line.split())) for line in (folder / place).read_text().splitlines() if line.strip()]
    numbers = [row[3] for row in rows[:3]] if len(rows) == 4 else [row[0] for row in rows]
    return [f"{x:.3f}" for x in numbers]


def all_cases() -> dict[str, PublicCase]:
    groups = read_document(SCENARIOS / "patients" / "public_patients.toml").content
    cases = [PublicCase(**{**group, **own}) for group in map(dict, groups.values()) for own in group.pop("cases")]
    return {case.name: case for case in cases}


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
        measure = again("patients", str(out), str(folder / "case"), "--measure")  # of its own: this process stays
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
    cores = sorted(os.sched_getaffinity(0))
    own = os.environ | {"CTRPLAN_CACHE_DIR": str(folder / "cache")}
    command = ["taskset", "--cpu-list", str(cores[core]), str(COMMAND), *arguments]
    with (folder / log).open("w+") as stream:
        code, clock_s, processor_s, memory = spent(command, own, stream)
        stream.seek(0)
        words = stream.read().strip().splitlines()
    used = {"clock_s": round(clock_s, 1), "processor_s": round(processor_s, 1), "memory_MB": round(memory)}
    return {"command": shlex.join(["ctrplan", *arguments]), "code": code, **used, "words": words[-30:]}


def _figures(case: Path) -> dict[str, Any]:
    """Claimed and measured clearance, the bound at the goal."""
    from patient_clearance import measured_clearance  # with ctrplan, which the process that starts others needs not

    certificate = json.loads((case / "plan" / "plan.json").read_text())["certificate"]
    measured = measured_clearance(case / "placed.toml", case / "robot.toml", case / "plan")
    metres = certificate["goal_bound_m"], certificate["closest"]["clearance_m"], certificate["min_clearance_m"]
    claimed = zip(("plan_bound_mm", "worst_mm", "plan_claimed_mm"), (1e3 * x for x in metres), strict=True)
    where = {"nearest": measured.part, "at_s": measured.time_s, "at_mm": measured.point_mm.round(1).tolist()}
    return {**dict(claimed), "measured_mm": measured.room_mm, **where}


def print_table(out: Path) -> None:
    """Prints what the folders below OUT hold; clearances and bounds in mm."""
    files = [out / name.replace(" ", "_") / "result.json" for name in all_cases()]
    head = "case | robot | processor time (clock), s | memory, MB | clearance certified | worst friction | measured"
    rows = (_row(json.loads(file.read_text())) for file in files if file.exists())
    table("patients", f"{head} | bound at the goal | without it in the cost", rows)


def _row(found: dict[str, Any]) -> list[str]:
    made = found["made"]
    start = [found["case"], f"`{found['robot']}`", f"{made['processor_s']:.0f} ({made['clock_s']:.0f})"]
    start.append(str(made["memory_MB"]))
    if "measured_mm" not in found:
        why = next((words for words in reversed(made["words"]) if words.startswith("ctrplan:")), "")
        return [*start, f"no plan: {why}", "", "", "", ""]
    sizes = (found[key] for key in ("plan_claimed_mm", "worst_mm", "measured_mm", "plan_bound_mm"))
    without = f"{found['without_bound_mm']:.2f}" if "without_bound_mm" in found else "no plan"
    return [*start, *(f"{mm:.2f}" for mm in sizes), without]


def run(chosen: list[PublicCase], root: Path, out: Path) -> None:
    """All cases one after the other, each judged while the next ones run."""
    begun = time.perf_counter()
    with ThreadPoolExecutor(max_workers=1) as judge:
        judged: list[Future[None]] = []
        for case in chosen:
            run_case(case, root, out)
            judged.append(judge.submit(judge_case, case, out))
            print(f"{time.perf_counter() - begun:4.0f} s  {case.name}", file=sys.stderr, flush=True)
        for result in judged:
            result.result()


def main() -> None:
    cases, switches = all_cases(), dict.fromkeys(("page", "commands", "measure"), False)
    given = common.arguments(__doc__, "folder", "out", ("cases*", cases), **switches)
    root, out = Path(given.folder).resolve(), Path(given.out).resolve()
    if given.measure:
        print(json.dumps(_figures(out)))
    elif given.commands:
        for case in cases.values():
            print(shlex.join(["ctrplan", *case.command(root), "-o", case.name.replace(" ", "_")]))
    else:
        named = given.cases or [case.name for case in cases.values() if case.page or not given.page]
        run([cases[name] for name in named], root, out)
        print_table(out)
