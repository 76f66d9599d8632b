"""How soon do commands start? Help, import, a bound and a loaded scenario, by the clock.

    python benchmarks/run.py start [SCENARIO] [--runs 9] [--robot three_tube]

Each row is a process of its own, run so many times after one that is not counted. Modules are those of ctrplan that are
imported at the end.
"""

import os
import subprocess
import sys
from pathlib import Path

import common
import numpy as np
from common import ROBOTS, SCENARIOS, SHIPPED, processors, spent, table

from ctrplan import load_robot

COMMAND = "import sys; from ctrplan.__main__ import main; sys.exit(main(sys.argv[1:]))"
MODULES = "import sys; print(sum(name.split('.')[0] == 'ctrplan' for name in sys.modules))"


def modules(code: str, arguments: list[str]) -> int:
    """How many modules of ctrplan some code imports, whether or not it exits."""
    kept = f"try:\n  exec({code!r})\nexcept SystemExit: pass\n{MODULES}"
    done = subprocess.run([sys.executable, "-c", kept, *arguments], check=True, capture_output=True, text=True)
    return int(done.stdout.split()[-1])


def bound_arguments(file: Path) -> list[str]:
    """A configuration of the robot at the middle of its drive's ranges, as the command wants it."""
    drive = load_robot(file).drive
    low, high = (np.where(drive.wraps, 0.0, limit) for limit in (drive.lower, drive.upper))
    theta, l_b = drive.collars((low + high) / 2)
    numbers = (np.degrees(theta), l_b * 1e3)
    flags = zip(("--theta-deg", "--l-mm"), numbers, strict=True)
    return ["bound", str(file), *(word for flag, row in flags for word in (flag, *(f"{x:.4f}" for x in row)))]


def main() -> None:
    given = common.arguments(__doc__, ("scenario?", SHIPPED), runs=9, robot="three_tube")
    scenario = given.scenario or "vessel"
    file = SCENARIOS / f"{scenario}.toml"
    load = f"import ctrplan; ctrplan.load_scenario({str(file)!r})"
    measured: dict[str, tuple[str, list[str]]] = {
        "python, nothing imported": ("pass", []),
        "import ctrplan": ("import ctrplan", []),
        "ctrplan --help": (COMMAND, ["--help"]),
        f"ctrplan bound, {given.robot}": (COMMAND, bound_arguments(ROBOTS / f"{given.robot}.toml")),
        f"load_scenario, {scenario}": (load, []),
    }
    rows = []
    for name, (code, arguments) in measured.items():
        command = [sys.executable, "-c", code, *arguments]
        taken = [spent(command, os.environ, subprocess.DEVNULL)[1] for _ in range(given.runs + 1)][1:]
        rows.append((name, f"{min(taken):.3f} s", f"{np.median(taken):.3f} s", modules(code, arguments)))
    print(f"{given.runs} runs each, {processors()}")
    table("seconds by the clock", ("what", "least", "median", "modules of ctrplan"), rows)
