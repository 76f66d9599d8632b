"""Runs `ctrplan diagnose` on every folder of a bank: `python -m hidden_effects.run DIR OUT`. Resumable."""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

COMMAND = [sys.executable, "-c", "import sys; from ctrplan.__main__ import main; sys.exit(main())", "diagnose"]
LONGEST_S = 900


def diagnose(folder: Path, out: Path, left_out: str, command: list[str]) -> dict[str, Any]:
    """Seconds, exit code and message of one diagnosis; also written to out/run.json."""
    out.mkdir(parents=True, exist_ok=True)
    call = [*command, str(folder / "robot.toml"), str(folder / "measurements.csv"), "-o", str(out)]
    call += ["--without", left_out] if left_out else []
    began = time.perf_counter()
    try:
        done = subprocess.run(call, capture_output=True, text=True, timeout=LONGEST_S, check=False)
        code, message = done.returncode, done.stderr[-2000:]
    except subprocess.TimeoutExpired:
        code, message = -1, f"no answer within {LONGEST_S} s"
    report = {"seconds": round(time.perf_counter() - began, 1), "exit_code": code, "message": message}
    (out / "run.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    return report


def diagnose_all(bank: Path, out: Path, command: list[str], *, again: bool = False, jobs: int = 1) -> None:
    """Every complete folder of the bank that has no run.json yet, or with `again` no diagnosis; `jobs` at a time."""

    def run(folder: Path) -> None:
        truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        report = diagnose(folder, out / folder.name, truth.get("case", {}).get("left_out", ""), command)
        print(f"{folder.name}  {report['seconds']:6.1f} s  exit {report['exit_code']}", flush=True)

    done = "diagnosis.json" if again else "run.json"
    complete = [truth.parent for truth in sorted(bank.glob("*/truth.json"))]
    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(run, [folder for folder in complete if not (out / folder.name / done).exists()]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bank", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--jobs", type=int, default=1, help="sets at a time")
    parser.add_argument("--again", action="store_true", help="run again what gave no diagnosis")
    given = parser.parse_args()
    diagnose_all(given.bank, given.out, COMMAND, again=given.again, jobs=given.jobs)
    print(f"{resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime:.0f} s of processors in all")


if __name__ == "__main__":
    main()
