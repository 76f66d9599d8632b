"""What solves ask of the allocator, counted by model/tests/memory_test.cpp."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def test_solves_after_the_first_ask_for_no_memory_and_a_workspace_stays_below_2_mb(tmp_path: Path) -> None:
    libraries = sorted(ROOT.glob("build/*/libctr.a"), key=lambda path: path.stat().st_mtime)
    compiler = shutil.which(os.environ.get("CXX", "c++"))
    if not libraries or compiler is None:
        pytest.skip("needs a C++ compiler and the library that building the package in this folder leaves")
    program = tmp_path / "memory_test"
    source = ROOT / "model" / "tests" / "memory_test.cpp"
    command = [compiler, "-std=c++20", "-O1", "-I", str(ROOT / "model" / "include"), str(source), str(libraries[-1])]
    subprocess.run([*command, "-o", str(program)], check=True, capture_output=True, text=True)
    done = subprocess.run([program], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
