"""Mutants: one line of the program is made wrong at a time, and the tests that are named for it have to fail.

`python tools/mutants.py` works on a copy of the tree in build/mutants and prints which mutants die; it ends with 1
where one lives, or where the tests fail on the unchanged copy. `--only WORD ...` takes those whose file or number is
named. Mutants of the core cost a build each, of one file. Run it after tests were dropped or changed: a law that no
test holds any more shows as a mutant that lives.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PLACE = ROOT / "build" / "mutants"
TREE, CORE = PLACE / "tree", PLACE / "core"
FOLDERS = ("benchmarks", "ctrplan", "docs", "examples", "model", "scenarios", "tests", "tools")
COPIED = (*FOLDERS, "pyproject.toml", "README.md")


@dataclass(frozen=True)
class Mutant:
    """A line of a file made wrong, what law that breaks, and the tests that hold the law."""

    file: str
    line: str
    mutated: str
    law: str
    tests: str


MUTANTS = (
    Mutant(
        "model/src/contact/load_moments.cpp",
        "keep(state.load_moment(e, g, t, 1, lane), -dot(column[0], m));",
        "keep(state.load_moment(e, g, t, 1, lane), dot(column[0], m));",
        "a load bends as its moment says",
        "tests/mechanics/test_terms.py",
    ),
    Mutant(
        "model/src/contact/stability.cpp",
        "value = largest >= -smallest ? largest : smallest;",
        "value = largest >= -smallest ? smallest : largest;",
        "stability is the lowest mode of the second variation",
        "tests/mechanics/test_solver.py",
    ),
    Mutant(
        "model/src/history/friction_state.cpp",
        "const double slid = slip - options_.breakaway * (phi_[k] - last_phi_[k]);",
        "const double slid = slip + options_.breakaway * (phi_[k] - last_phi_[k]);",
        "work is what friction loses and what is stored",
        "tests/mechanics/test_history.py",
    ),
    Mutant(
        "model/src/bound/bound.cpp",
        "if (distance > position) {",
        "if (distance < position) {",
        "the bound is of the worst corner",
        "tests/mechanics/test_solver.py",
    ),
    Mutant(
        "model/src/cells/cell_spread.cpp",
        "off[k] = most[std::min(k + beyond, bodies.points - 1)];",
        "off[k] = most[k];",
        "what counts of a difference reaches beyond a point",
        "tests/mechanics/test_friction_cells.py",
    ),
    Mutant(
        "model/src/cells/bodies_between.cpp",
        "finer.push_back(weight * ((1 + phi[pair] * sign) / 2));",
        "finer.push_back(weight * ((1 - phi[pair] * sign) / 2));",
        "a body between corners is the corners' in its corners",
        "tests/mechanics/test_friction_cells.py tests/planning/test_states_between.py",
    ),
    Mutant(
        "model/src/surface/triangle_tree.cpp",
        "if (by_b < 0) square = std::min(square, from_segment(p, ac));",
        "if (by_b > 0) square = std::min(square, from_segment(p, ac));",
        "the distance of a surface is that of its nearest triangle",
        "tests/anatomy/test_triangle_tree.py",
    ),
    Mutant(
        "model/src/walk/check_path.cpp",
        "sample.max_strain <= limits.max_strain",
        "sample.max_strain >= limits.max_strain",
        "a walk ends where the strain is too large",
        "tests/planning/test_motion.py tests/mechanics/test_walker.py tests/mechanics/test_solver.py",
    ),
    Mutant(
        "ctrplan/certificate/anatomy_distance.py",
        "np.sqrt(far**2 - half_m**2)",
        "np.sqrt(far**2 + half_m**2)",
        "the body between two points is nearer than they are",
        "tests/planning/test_certificate.py::test_pieces_of_a_body_cover_it",
    ),
    Mutant(
        "ctrplan/certificate/friction_cube.py",
        "ERROR_FACTOR = 1.5 ",
        "ERROR_FACTOR = 0.0 ",
        "no friction state is nearer than the cube says",
        "tests/planning/test_friction_cube.py",
    ),
    Mutant(
        "ctrplan/certificate/problems.py",
        "samples.stability < limits.stability,",
        "samples.stability > limits.stability,",
        "a certificate refuses what is less stable than asked",
        "tests/planning/test_certificate.py",
    ),
    Mutant(
        "ctrplan/certificate/certificate.py",
        '"min", "m", claim="clearance", limit=',
        '"max", "m", claim="clearance", limit=',
        "a tour's clearance is that of its narrowest stage",
        "tests/planning/test_closest_places.py::test_a_tour_has_the_places_of_its_narrowest_stage_and_the_start_of_its_first",
    ),
    Mutant(
        "ctrplan/planning/reordering.py",
        "_way_cost(checker, motion) > _way_cost(checker, before) + 1e-9:",
        "_way_cost(checker, motion) < _way_cost(checker, before) + 1e-9:",
        "reordering never costs more",
        "tests/planning/test_planning.py::test_reorder_swaps_a_translation_before_a_rotation "
        "tests/planning/test_planning.py::test_reorder_puts_rotations_first_at_no_higher_cost",
    ),
    Mutant(
        "ctrplan/pipeline/chain.py",
        "np.interp(times - late, data.time_s[waypoints], c)",
        "np.interp(times + late, data.time_s[waypoints], c)",
        "a pose belongs to the joints of a delay ago",
        "tests/pipeline/test_chain.py",
    ),
    Mutant(
        "ctrplan/calibration/residuals.py",
        "(data.position_m - prediction.position_m) / sigma_m",
        "(prediction.position_m - data.position_m) / sigma_m",
        "residuals are measured less predicted",
        "tests/calibration/test_calibration.py",
    ),
    Mutant(
        "ctrplan/calibration/fit_warnings.py",
        "wrong: NDArray[np.bool_] = norm > np.maximum(LEAST, TIMES * typical)",
        "wrong: NDArray[np.bool_] = norm > np.minimum(LEAST, TIMES * typical)",
        "a pose is wrong only compared with noise, with all and with companions",
        "tests/calibration/test_wrong_poses.py tests/diagnosis/test_gross_outliers.py",
    ),
    Mutant(
        "ctrplan/diagnosis/linear_fit.py",
        "moved = r + J @ solved(",
        "moved = r - J @ solved(",
        "a group left out has the residual of a refit without it",
        "tests/diagnosis/test_held_out.py",
    ),
    Mutant(
        "ctrplan/diagnosis/remainder.py",
        "variances = variances * np.sqrt(drawn",
        "variances = variances / np.sqrt(drawn",
        "variances of processes are the most probable ones",
        "tests/diagnosis/test_localise.py",
    ),
    Mutant(
        "ctrplan/files/mapping_file.py",
        "self._numbers[name] = self.numbers(name) + SI[unit] * zeros[k]",
        "self._numbers[name] = self.numbers(name) - SI[unit] * zeros[k]",
        "joints of a laboratory's table are counted from its zeros",
        "tests/files/test_mapping_file.py",
    ),
    Mutant(
        "ctrplan/base/arrays.py",
        "CHI95 = 2.795483 ",
        "CHI95 = 1.959964 ",
        "95 % of distances in space lie within the worst case",
        "tests/planning/test_plan_uncertainty.py::test_registration_alone_misses_by_a_chi_distribution",
    ),
    Mutant(
        "ctrplan/effects/drive/backlash.py",
        "theta[:, tube] -= width / 2 * directions[:, tube]",
        "theta[:, tube] += width / 2 * directions[:, tube]",
        "play stands behind the joint that pushed it",
        "tests/effects/test_backlash.py",
    ),
    Mutant(
        "ctrplan/calibration/residuals.py",
        "square: Array = np.where(norm <= c, norm**2, 2 * c * norm - c * c)",
        "square: Array = np.where(norm <= c, norm**2, 2 * c * norm + c * c)",
        "the robust loss goes on straight beyond its limit",
        "tests/calibration/test_robust_loss.py",
    ),
)


def main() -> int:
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument(
        "--only", nargs="+", metavar="WORD", default=[], help="mutants whose file has WORD, or its number"
    )
    parser.add_argument("--unchanged", action="store_true", help="run the tests on the unchanged copy first")
    given = parser.parse_args()
    chosen = [
        (number, mutant)
        for number, mutant in enumerate(MUTANTS, 1)
        if not given.only or any(word == str(number) or word in mutant.file for word in given.only)
    ]
    copy_tree()
    build_core()
    if given.unchanged:
        files = sorted({file for _, mutant in chosen for file in mutant.tests.split()})
        if not passes(files):
            print("tests fail on the unchanged copy")
            return 1
    lived = 0
    print("| # | file | law | the mutant | s |\n|---|---|---|---|---|")
    for number, mutant in chosen:
        start = time.monotonic()
        dies = dies_of(mutant)
        lived += not dies
        fate = "dies" if dies else "LIVES"
        print(f"| {number} | {mutant.file} | {mutant.law} | {fate} | {time.monotonic() - start:.0f} |", flush=True)
    print(f"{len(chosen) - lived} of {len(chosen)} die.")
    return 1 if lived else 0


def copy_tree() -> None:
    """The tree as it is; files that did not change keep their times, so that the core is not built anew."""
    TREE.mkdir(parents=True, exist_ok=True)
    for name in COPIED:
        source = ROOT / name
        files = [source] if source.is_file() else [p for p in source.rglob("*") if p.is_file()]
        kept = {TREE / file.relative_to(ROOT) for file in files}
        for file in files:
            target = TREE / file.relative_to(ROOT)
            if "__pycache__" in file.parts or file.name.startswith("_model"):
                continue
            if not target.exists() or target.read_bytes() != file.read_bytes():
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file, target)
        if source.is_dir():
            for old in (TREE / name).rglob("*"):
                if old.is_file() and old not in kept:
                    old.unlink()


def build_core() -> bool:
    """Whether the copy's core compiles; it is put where Python finds it."""
    bin_folder, cmake = Path(sys.executable).parent, "cmake"
    if not (CORE / "build.ninja").exists():
        found = subprocess.run(
            [sys.executable, "-m", "nanobind", "--cmake_dir"], capture_output=True, text=True, check=True
        )
        subprocess.run(
            [bin_folder / cmake, "-S", TREE / "model", "-B", CORE, "-G", "Ninja"]
            + [f"-DCMAKE_MAKE_PROGRAM={bin_folder / 'ninja'}", f"-Dnanobind_DIR={found.stdout.strip()}"]
            + [f"-DPython_EXECUTABLE={sys.executable}", "-DCMAKE_BUILD_TYPE=Release"],
            stdout=subprocess.DEVNULL,
            check=True,
        )
    done = subprocess.run([bin_folder / cmake, "--build", CORE], stdout=subprocess.DEVNULL)
    for library in CORE.glob("_model.*"):
        shutil.copyfile(library, TREE / "ctrplan" / library.name)
    return done.returncode == 0


def dies_of(mutant: Mutant) -> bool:
    """Whether a test fails; the copy is as it was afterwards."""
    path = TREE / mutant.file
    text = path.read_text(encoding="utf-8")
    if text.count(mutant.line) != 1:
        raise SystemExit(f"{mutant.file} has the line {text.count(mutant.line)} times: {mutant.line}")
    is_core = mutant.file.startswith("model/")
    path.write_text(text.replace(mutant.line, mutant.mutated), encoding="utf-8")
    try:
        if is_core and not build_core():
            raise SystemExit(f"{mutant.file} does not compile with: {mutant.mutated}")
        return not passes(mutant.tests.split())
    finally:
        path.write_text(text, encoding="utf-8")
        if is_core:
            build_core()


def passes(tests: list[str]) -> bool:
    """Whether pytest, which finds the copy's package before the installed one, ends well."""
    environment = {**os.environ, "PYTHONPATH": str(TREE), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    done = subprocess.run(
        command, cwd=TREE, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    if done.returncode not in (0, 1):
        raise SystemExit(done.stdout)
    return done.returncode == 0


if __name__ == "__main__":
    sys.exit(main())
