"""A plan opens from anywhere: its folder holds scenario, robot and meshes by content, and goes into one file."""

from __future__ import annotations

import argparse
import json
import re
import shutil
import zipfile
from pathlib import Path

import numpy as np
import packed_page
import pytest
import tomli_w
import trimesh
from made_up_input import FUZZ
from places import ROBOTS

import ctrplan
from ctrplan.__main__ import main
from ctrplan.commands import view
from ctrplan.errors import InputError
from ctrplan.files.plan_inputs import INPUTS, MANIFEST, _packed, unpacked
from ctrplan.storage.output_folder import CHECKSUMS as SUMS

START = {"rotate outer": 0.0, "rotate inner": 0.0, "translate inner": 0.0}


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan past a mesh, of a robot outside the scenario's folder; what it was made from is gone afterwards."""
    home = tmp_path_factory.mktemp("home")
    (home / "task" / "meshes").mkdir(parents=True)
    shutil.copy(ROBOTS / "table_5_pair.toml", home / "pair.toml")
    trimesh.creation.box((5, 5, 5)).apply_translation((120, 0, 60)).export(home / "task" / "meshes" / "box.stl")
    part = {"kind": "mesh", "file": "meshes/box.stl", "unit": "mm"}
    goal = {"joints": START | {"rotate inner": 20.0}}
    content = {"name": "a task", "robot": "../pair.toml", "start": START, "goal": goal, "anatomy": [part]}
    (home / "task" / "task.toml").write_text(tomli_w.dumps(content))
    changes = ["planner.time_s=0.2", "margins.stability=0.05"]
    scenario = ctrplan.load_scenario(home / "task" / "task.toml", changes, allow_outside=True)
    plan = ctrplan.plan(scenario, seed=0)
    away = tmp_path_factory.mktemp("away")
    plan.save(away / "out")
    plan.save(away / "plan.ctrplan")
    shutil.rmtree(home)
    return away


@pytest.mark.parametrize("name", ["out", "out/plan.json", "plan.ctrplan"])
def test_it_opens_where_nothing_else_is(
    name: str, saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    written = ctrplan.load_plan(saved / name)
    assert written.scenario.name == "a task" and written.scenario.margins.stability == 0.05
    (part,) = written.scenario.anatomy
    np.testing.assert_allclose(np.array(part.box) * 1e3, [[117.5, -2.5, 57.5], [122.5, 2.5, 62.5]], atol=1e-4)
    assert written.content["scenario"]["sha256"] == written.scenario.sha256


@pytest.mark.parametrize("name", ["out", "plan.ctrplan"])
def test_commands_take_either(name: str, saved: Path, tmp_path: Path) -> None:
    assert main(["render", str(saved / name), "-o", str(tmp_path / "a.png"), "--size", "320x240", "--quiet"]) == 0
    assert (
        main(["export", str(saved / name), "--to", "slicer", "--frame", "RAS", "-o", str(tmp_path / "s"), "--quiet"])
        == 0
    )
    assert ctrplan.Plan.load(saved / name).scenario.name == "a task"
    assert ctrplan.check(saved / "out").kind == "plan"


def test_the_folder_is_whole_and_its_sums_say_so(saved: Path) -> None:
    sums = (saved / "out" / "SHA256SUMS").read_text()
    assert all(name in sums for name in ("plan.json", "trajectory.csv", "report.html", "plan.png", INPUTS))
    with zipfile.ZipFile(saved / "out" / INPUTS) as archive:
        names = set(archive.namelist())
        manifest = json.loads(archive.read(MANIFEST))
    assert names == {"scenario.toml", "meshes/box.stl", "elsewhere/1/pair.toml", MANIFEST}
    assert manifest["named"] == {"elsewhere/1/pair.toml": "../pair.toml"}
    with zipfile.ZipFile(saved / "plan.ctrplan") as archive:
        assert set(archive.namelist()) >= {"plan.json", "trajectory.csv", INPUTS, "SHA256SUMS"}


def changed(source: Path, target: Path, member: str, change: object) -> None:
    """A copy of an archive with one member changed."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            new.writestr(name, change(data) if name == member else data)  # type: ignore[operator]


def test_inputs_that_are_not_those_of_the_plan_are_refused(saved: Path, tmp_path: Path) -> None:
    shutil.copytree(saved / "out", tmp_path / "out")
    changed(saved / "out" / INPUTS, tmp_path / "out" / INPUTS, "scenario.toml", lambda d: d.replace(b"0.05", b"0.5"))
    with pytest.raises(InputError, match="is that of another scenario.*margins differs"):
        ctrplan.load_plan(tmp_path / "out")
    changed(
        saved / "out" / INPUTS,
        tmp_path / "out" / INPUTS,
        "elsewhere/1/pair.toml",
        lambda d: d.replace(b"poisson_ratio = -0.2", b"poisson_ratio = -0.1"),
    )
    with pytest.raises(InputError, match="is that of another robot.*tube.2 differs"):
        ctrplan.load_plan(tmp_path / "out")
    (tmp_path / "out" / INPUTS).write_bytes(b"PK nonsense")
    with pytest.raises(InputError, match=r"inputs.zip: is damaged"):
        ctrplan.load_plan(tmp_path / "out")


def test_no_damage_to_an_archive_ends_in_a_bare_error(tmp_path: Path) -> None:
    """Every byte changed, and every length cut off: unpacked all the same, or refused in a sentence."""
    whole, source = tmp_path / "whole.zip", b"tubes and joints " * 8
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("scenario.toml", source)
    data, refused = whole.read_bytes(), 0
    for k in range(len(data)):
        for changed_data in (data[:k], data[:k] + bytes([data[k] ^ 0xFF]) + data[k + 1 :]):
            whole.write_bytes(changed_data)
            try:
                unpacked(whole)
            except InputError:
                refused += 1
    assert refused > len(data)


@pytest.mark.parametrize(("place", "value", "words"), [(6, 1, "password"), (8, 97, "not supported")])
def test_an_archive_that_nothing_here_unpacks_says_why(tmp_path: Path, place: int, value: int, words: str) -> None:
    """Bytes of its headers say that it is encrypted, or packed in a way that nobody knows."""
    path = tmp_path / "odd.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("scenario.toml", b"x")
    data = bytearray(path.read_bytes())
    data[place] = data[data.index(b"PK\x01\x02") + place + 2] = value
    path.write_bytes(data)
    with pytest.raises(InputError, match=f"can't be unpacked.*{words}"):
        unpacked(path)


def test_an_archive_that_leads_elsewhere_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "evil.ctrplan", "w") as archive:
        archive.writestr("../plan.json", "{}")
    with pytest.raises(InputError, match="leads out of it"):
        ctrplan.load_plan(tmp_path / "evil.ctrplan")
    assert not (tmp_path.parent / "plan.json").exists()


def test_the_command_writes_one_file(tmp_path: Path) -> None:
    assert (
        main(
            ["init", "robot", str(tmp_path / "r.toml"), "--tube", "2.64x2.39,0,100,265", "--tube", "1.825x1.6,60,90,55"]
        )
        == 0
    )
    assert main(["init", "scenario", str(tmp_path / "s.toml"), "--robot", str(tmp_path / "r.toml")]) == 0
    output = tmp_path / "plan.ctrplan"
    quick = ["--time", "0.3", "--quiet", "--formats", "csv"]
    assert main(["plan", str(tmp_path / "s.toml"), "-o", str(output), *quick]) in (0, 3)
    assert output.is_file() and [p.name for p in tmp_path.iterdir() if p.is_dir()] == []
    assert ctrplan.load_plan(output).scenario.name == "my task"


def test_two_plans_side_by_side(saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = ["compare", str(saved / "out"), str(saved / "plan.ctrplan")]
    assert main([*said, "-o", str(tmp_path / "c")]) == 0
    told = capsys.readouterr().out
    assert "the same robot" in told and "the same scenario" in told and "Duration of the motion" in told
    differences = [line.split()[-2] for line in told.splitlines()[5:] if line.endswith("mm")]
    assert differences and set(differences) <= {"+0"}
    assert (tmp_path / "c" / "compare.png").stat().st_size > 20_000
    page = (tmp_path / "c" / "compare.html").read_text(encoding="utf-8")
    scene = json.loads(packed_page.unpacked(re.findall(r'drawn\("scene", "([^"]+)"', page)[0]))
    names = {trace.get("name") for trace in scene["data"]}
    assert {"plan A", "plan B", "envelope of friction of A", "envelope of friction of B"} <= names
    assert len(scene["frames"]) == 40 and "now_A" in page and "now_B" in page and "Duration of the motion" in page
    assert main([*said, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert all(row["a"] == row["b"] for row in rows.values()) and len(rows) > 6


@pytest.mark.parametrize("missing", ["plan.json", "trajectory.csv", INPUTS])
def test_a_member_that_is_missing_is_named_by_the_file_that_was_given(
    missing: str, saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(saved / "out", tmp_path / "out")
    (tmp_path / "out" / missing).unlink()
    one = tmp_path / "one.ctrplan"
    with zipfile.ZipFile(saved / "plan.ctrplan") as whole, zipfile.ZipFile(one, "w") as archive:
        for member in whole.infolist():
            if member.filename != missing:
                archive.writestr(member, whole.read(member))
    for given in (tmp_path / "out", one):
        for command in ("check", "verify"):
            assert main([command, str(given), *(["--quiet"] if command == "verify" else [])]) == 2
            told = capsys.readouterr().err
            assert told.startswith(f"ctrplan: {given}") and missing in told, told


def test_check_takes_one_file_as_well(saved: Path) -> None:
    assert ctrplan.check(saved / "plan.ctrplan").lines == ctrplan.check(saved / "out").lines


def test_voxels_beside_a_header_are_packed_whatever_they_are_called(tmp_path: Path) -> None:
    header = "NDims = 3\nDimSize = 2 2 2\nElementType = MET_UCHAR\nOffset = 0 0 0\nElementSpacing = 1 1 1\n"
    (tmp_path / "scan.mhd").write_text(header + "ElementDataFile = voxels/other.raw\n")
    (tmp_path / "voxels").mkdir()
    (tmp_path / "voxels" / "other.raw").write_bytes(bytes(8))
    (tmp_path / "scan.txt").write_text("notes of a person")
    packed = _packed(tmp_path / "scan.mhd", "scans/scan.mhd")
    assert set(packed) == {"scans/scan.mhd", "scans/voxels/other.raw"}


def spoil(folder: Path, name: str) -> None:
    """Changes a file as a person does who looks into it: what it says stays the same."""
    path = folder / name
    if name == INPUTS:
        changed(path, folder / "other.zip", "scenario.toml", lambda data: data + b"# looked at\n")
        (folder / "other.zip").replace(path)
    else:
        path.write_bytes(path.read_bytes() + b"\n")


MEANING = {
    "trajectory.csv": "the certificate is of the motion that was in it; ctrplan verify judges the one that is",
    "plan.json": "its figures may not be those that were computed; verifying it computes them anew",
    INPUTS: "scenario and robot have the plan's hashes all the same",
    "trajectory.yaml": "it may drive another motion than trajectory.csv; ctrplan plan writes it again",
    "report.html": "it may show another plan than plan.json; ctrplan plan writes it again",
}


PACKED = [(name, packed) for packed in (False, True) for name in MEANING if FUZZ or not packed or name == INPUTS]


@pytest.mark.parametrize(("name", "packed"), PACKED)
def test_a_file_that_was_changed_after_it_was_written_is_named(
    name: str, packed: bool, saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ctrplan.load_plan(saved / "out").warnings == ctrplan.load_plan(saved / "plan.ctrplan").warnings == ()
    place = tmp_path / "out"
    shutil.copytree(saved / "out", place)
    spoil(place, name)
    if packed:
        place = tmp_path / "plan.ctrplan"
        with zipfile.ZipFile(place, "w") as archive:
            for part in sorted((tmp_path / "out").iterdir()):
                archive.write(part, part.name)
    (warning,) = ctrplan.load_plan(place).warnings
    assert warning == f"{place / name}: was changed after it was written, by {SUMS}: {MEANING[name]}."
    assert warning in ctrplan.check(place).flags
    assert main(["compare", str(place), str(saved / "out"), "--json"]) == 0
    assert warning in capsys.readouterr().err
    assert main(["render", str(place), "-o", str(tmp_path / "a.png"), "--size", "64x64", "--quiet"]) == 0
    assert warning in capsys.readouterr().err
    if name == "plan.json":
        with pytest.raises(InputError, match="was changed after it was written"):
            ctrplan.Plan.load(place)
    else:
        assert warning in ctrplan.Plan.load(place).notes


def test_another_trajectory_in_place_of_the_changed_one_is_no_matter(saved: Path, tmp_path: Path) -> None:
    shutil.copytree(saved / "out", tmp_path / "out")
    spoil(tmp_path / "out", "trajectory.csv")
    assert ctrplan.load_plan(tmp_path / "out", trajectory=saved / "out" / "trajectory.csv").warnings == ()


@pytest.mark.parametrize("sums", [b"", b"nonsense", b"\xff\xfe", b"0" * 64 + b"  ../plan.json\n", None])
def test_sums_that_say_nothing_are_no_matter(sums: bytes | None, saved: Path, tmp_path: Path) -> None:
    shutil.copytree(saved / "out", tmp_path / "out")
    (tmp_path / "out" / SUMS).unlink()
    if sums is not None:
        (tmp_path / "out" / SUMS).write_bytes(sums)
    assert ctrplan.load_plan(tmp_path / "out").warnings == ()


@pytest.mark.parametrize("name", ["out", "out/plan.json", "plan.ctrplan"])
def test_the_live_page_takes_either(name: str, saved: Path) -> None:
    parser = argparse.ArgumentParser()
    view.add_options(parser)
    scenario, plan = view.loaded(parser.parse_args([str(saved / name)]))
    assert plan is not None and plan.scenario is scenario
