"""What solves ask of the allocator, counted by model/tests/memory_test.cpp."""

import os
import subprocess
from pathlib import Path

from places import ROOT


def test_solves_after_the_first_ask_for_no_memory_and_a_workspace_stays_below_2_mb(tmp_path: Path) -> None:
    libraries = sorted(ROOT.glob("build/*/libctr.a"), key=lambda path: path.stat().st_mtime)
    assert libraries, (
        "building the package in this folder (make install) leaves build/*/libctr.a, which this links with"
    )
    program = tmp_path / "memory_test"
    source = ROOT / "model" / "tests" / "memory_test.cpp"
    command = [os.environ.get("CXX", "c++"), "-std=c++20", "-O1", "-I", str(ROOT / "model" / "include"), str(source)]
    subprocess.run([*command, str(libraries[-1]), "-o", str(program)], check=True)
    done = subprocess.run([program], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
