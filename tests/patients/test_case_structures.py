"""Structures as targets, structures that move, and images that lie beside what is meant."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import case_phantom as phantom
import numpy as np
import phantoms
import pytest
import SimpleITK
import trimesh

import ctrplan
from ctrplan.anatomy import image_file
from ctrplan.anatomy.parts import Phases
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.anatomy.shapes.volume import Volume
from ctrplan.errors import InputError
from ctrplan.patients.case import case
from ctrplan.patients.draft import middle_m
from ctrplan.patients.work import SCENARIO
from ctrplan.scenario.scenario import Scenario

NODULE = phantom.ENTRY + phantoms.OBLIQUE @ (15.0, -20.0, 120.0)
CLEAR = phantom.ENTRY + phantoms.OBLIQUE @ (10.0, 5.0, 60.0)
RAS = np.array([-1.0, -1.0, 1.0])
RADIUS_MM = 12.0


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The lumen, the vessel, and a nodule in the lumen."""
    labels = phantom.labels()
    voxels = SimpleITK.GetArrayFromImage(labels)
    nodule = phantoms.image(
        phantoms.capsule(NODULE - 0.01 * phantom.WAY, NODULE + 0.01 * phantom.WAY, RADIUS_MM),
        (phantom.ENTRY + phantom.FAR) / 2,
        200.0,
        phantom.VOXEL_MM,
    )
    voxels[SimpleITK.GetArrayFromImage(nodule) > 0] = 3
    found = SimpleITK.GetImageFromArray(voxels)
    found.CopyInformation(labels)
    return phantoms.written(found, tmp_path_factory.mktemp("patient") / "labels.nii.gz")


def scenario_of(output: Path, *inputs: Path, **keys: Any) -> tuple[Scenario, list[str]]:
    notes: list[str] = []
    said = {
        "robot": phantom.ROBOT,
        "frame": "LPS",
        "until": "scenario",
        "entries": [phantom.ENTRY],
        "note": notes.append,
    }
    case(output, inputs, **(said | keys))
    return ctrplan.load_scenario(output / SCENARIO, allow_outside=True), notes


def test_a_structure_is_gone_to_in_its_middle_and_not_avoided(image: Path, tmp_path: Path) -> None:
    keys: dict[str, Any] = {"lumens": ["1"], "avoids": ["2"], "targets": ["labels.nii.gz:3"]}
    with pytest.raises(InputError, match="target .* lies 1[0-9.]* mm outside"):  # of the lumen, whose labels it takes
        scenario_of(tmp_path / "alone", image, **keys)
    keys["lumens"].append("3")
    for frame, turned in (("LPS", np.ones(3)), ("RAS", RAS)):
        entry = [phantom.ENTRY * turned]
        scenario, notes = scenario_of(tmp_path / frame, image, **keys | {"frame": frame, "entries": entry})
        assert scenario.goal.tip_m is not None
        np.testing.assert_allclose(scenario.goal.tip_m * 1e3, NODULE * turned, atol=0.3 * phantom.VOXEL_MM)
        assert any("is a target: its middle" in note and frame in note for note in notes)
        assert [part.role for part in scenario.anatomy] == ["inside", "inside", "avoid"]
    with pytest.raises(InputError, match="two things"):
        scenario_of(tmp_path / "both", image, **keys | {"avoids": ["2", "3"]})


def test_a_segment_called_nodule_is_the_target_where_none_is_said(image: Path, tmp_path: Path) -> None:
    segmentation = SimpleITK.ReadImage(str(image))
    for k, name in enumerate(("Trachea", "Aorta", "Nodule")):
        for key, value in (("Name", name), ("LabelValue", str(k + 1)), ("Layer", "0"), ("ID", f"S{k}")):
            segmentation.SetMetaData(f"Segment{k}_{key}", value)
    phantoms.written(segmentation, tmp_path / "patient.seg.nrrd")
    scenario, _ = scenario_of(tmp_path / "case", tmp_path / "patient.seg.nrrd", ignored=["Trachea"])
    assert [part.shape.name for part in scenario.anatomy] == ["Aorta"]
    assert scenario.goal.name == "Nodule" and scenario.goal.tip_m is not None
    np.testing.assert_allclose(scenario.goal.tip_m * 1e3, NODULE, atol=0.3 * phantom.VOXEL_MM)
    with pytest.raises(InputError, match="--target: is needed"):
        scenario_of(tmp_path / "none", tmp_path / "patient.seg.nrrd", ignored=["Trachea", "Nodule"])


def test_the_middle_of_a_body_lies_within_it() -> None:
    cone = trimesh.creation.cone(radius=0.01, height=0.04)
    np.testing.assert_allclose(middle_m(Mesh(cone.vertices, cone.faces)), cone.center_mass, atol=1e-9)
    ring = trimesh.creation.torus(major_radius=0.03, minor_radius=0.008)
    shape = Mesh(ring.vertices, ring.faces)
    middle = middle_m(shape)
    assert shape.distance(middle[None])[0] < -0.005  # not in the hole, and deep within


def test_phases_of_a_structure_are_kept_clear_of_together(image: Path, tmp_path: Path) -> None:
    far = phantom.ENTRY + phantoms.OBLIQUE @ (-30.0, 35.0, 80.0)
    for name, shift in (("heart_in", 0.0), ("heart_out", 7.3)):
        ball = trimesh.creation.icosphere(subdivisions=2, radius=10)
        ball.apply_translation(far + shift * phantoms.OBLIQUE[:, 0])
        ball.export(tmp_path / f"{name}.stl")
    keys: dict[str, Any] = {"lumens": ["1"], "avoids": ["2", "heart_in"], "targets": [CLEAR], "file_frame": "LPS"}
    keys["phases"] = [[tmp_path / "heart_in.stl", tmp_path / "heart_out.stl"]]
    scenario, notes = scenario_of(tmp_path / "case", image, **keys)
    moving = scenario.anatomy[2]
    assert isinstance(moving.shape, Phases) and [len(part.shape.surface().faces) for part in scenario.anatomy][2] == 640
    assert 7.2 / 2 < moving.shape.motion_margin_m * 1e3 < 7.3 / 2 + 0.1  # half of the way, rounded up
    assert moving.margin_m == pytest.approx(0.5e-3 + moving.shape.motion_margin_m)
    assert any("between phases" in note for note in notes) and not any("more than motion_margin" in n for n in notes)
    halfway = far + 3.65 * phantoms.OBLIQUE[:, 0]
    assert moving.shape.distance(np.array([far, halfway, far + 7.3 * phantoms.OBLIQUE[:, 0]]) * 1e-3).max() < 0
    said, _ = scenario_of(tmp_path / "said", image, **keys, motion_margin_mm=2.0)
    assert said.anatomy[2].margin_m == pytest.approx(2.5e-3)
    still, other = tmp_path / "heart_in.stl", tmp_path / "heart_out.stl"
    third = tmp_path / "heart_back.stl"
    third.write_bytes(still.read_bytes())
    beat, _ = scenario_of(tmp_path / "beat", image, **keys | {"phases": [[still, other, third, still]]})
    assert isinstance(beat.anatomy[2].shape, Phases) and len(beat.anatomy[2].shape.shapes) == 4
    for files, rule in (
        ([still], "two files at least"),
        ([still, other, still], "said twice"),
        ([still, tmp_path], "folder"),
    ):
        with pytest.raises(InputError, match=f"--phases = .*{rule}"):
            scenario_of(tmp_path / "refused", image, **keys | {"phases": [files]})


def kept(output: Path, **keys: Any) -> tuple[bool, Any]:
    """Whether a case that goes on keeps its scenario as it is, and where it goes."""
    (step,) = case(output, until="scenario", **keys).steps
    return not step.is_made, ctrplan.load_scenario(output / SCENARIO, allow_outside=True).goal.tip_m


@pytest.mark.parametrize("where", ["apart", "below"])
def test_a_target_that_was_moved_is_gone_to_wherever_its_file_lies(where: str, image: Path, tmp_path: Path) -> None:
    """Once a case went on to the old target where the file was no input itself."""
    (tmp_path / "patient" / "points").mkdir(parents=True)
    (tmp_path / "patient" / "labels.nii.gz").symlink_to(image)
    file = tmp_path / ("points" if where == "apart" else "patient/points") / "target.mrk.json"
    file.parent.mkdir(exist_ok=True)
    phantom.write_markups(file, "LPS", {"target": CLEAR})
    targets = {"targets": [str(file)]} if where == "apart" else {}
    scenario_of(tmp_path / "case", tmp_path / "patient", lumens=["1"], avoids=["2"], **targets)
    assert kept(tmp_path / "case")[0]
    phantom.write_markups(file, "LPS", {"target": CLEAR + (1.0, 0.0, 0.0)})
    is_kept, tip_m = kept(tmp_path / "case")
    assert not is_kept and tip_m == pytest.approx((CLEAR + (1.0, 0.0, 0.0)) / 1e3)


def test_voxels_beside_their_header_count(image: Path, tmp_path: Path) -> None:
    SimpleITK.WriteImage(SimpleITK.ReadImage(str(image)), str(tmp_path / "labels.mhd"))
    scenario_of(tmp_path / "case", tmp_path / "labels.mhd", lumens=["1"], avoids=["2"], targets=[CLEAR])
    assert kept(tmp_path / "case")[0]
    other = SimpleITK.ReadImage(str(image))
    other[other.GetSize()[0] // 2, 1, 1] = 2
    SimpleITK.WriteImage(other, str(tmp_path / "b.mhd"))
    (tmp_path / "labels.raw").write_bytes((tmp_path / "b.raw").read_bytes())
    assert not kept(tmp_path / "case")[0]


def test_a_case_goes_on_from_any_folder(image: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names of files are as seen from where the case began; another patient's file of the same name is none of it."""
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "labels.nii.gz").symlink_to(image)
        phantom.write_markups(
            tmp_path / name / "a.mrk.json", "LPS", {"target": CLEAR + (5.0 * (name == "other"), 0, 0)}
        )
    monkeypatch.chdir(tmp_path / "one")
    keys: dict[str, Any] = {"targets": ["a.mrk.json"], "avoids": ["./labels.nii.gz:2"], "lumens": ["1"]}
    scenario_of(tmp_path / "case", Path("labels.nii.gz"), **keys)
    for folder in ("other", "case", "one"):
        monkeypatch.chdir(tmp_path / folder)
        is_kept, tip_m = kept(Path("../case"))
        assert is_kept and tip_m == pytest.approx(CLEAR / 1e3)
        case("../case", until="scenario", from_step="scenario")
        assert kept(Path("../case"))[1] == pytest.approx(CLEAR / 1e3)


def test_an_image_is_read_once_for_all_that_is_taken_from_it(
    image: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[Path] = []

    def counted(path: Path) -> Any:
        read.append(path)
        return own(path)

    own = image_file.read_image
    monkeypatch.setattr(image_file, "read_image", counted)
    keys: dict[str, Any] = {"lumens": ["1", "3"], "avoids": ["2"], "targets": ["labels.nii.gz:3"], "sheath_mm": 4.0}
    case(tmp_path, [image], robot=phantom.ROBOT, frame="LPS", entries=[phantom.ENTRY], until="scenario", **keys)
    assert read == [image]
    scenario = ctrplan.load_scenario(tmp_path / SCENARIO, allow_outside=True)
    assert len(read) == 2 and sum(isinstance(part.shape, Volume) for part in scenario.anatomy) == 3


def test_what_is_too_large_beside_a_patient_is_left_out_with_a_note(
    image: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "patient"
    folder.mkdir()
    (folder / "labels.nii.gz").symlink_to(image)
    series = SimpleITK.GetImageFromArray(np.zeros((2, 3, 4, 5), np.int16), isVector=False)
    SimpleITK.WriteImage(series, str(folder / "beats.nii.gz"))
    large = SimpleITK.GetImageFromArray(np.zeros((90, 90, 90), np.float64))
    SimpleITK.WriteImage(large, str(folder / "ct.nrrd"), True)
    monkeypatch.setattr(image_file, "MOST_BYTES", 5_000_000)  # as much as the labels need
    keys: dict[str, Any] = {"lumens": ["1"], "avoids": ["2"], "targets": [CLEAR]}
    _, notes = scenario_of(tmp_path / "case", folder, **keys)
    assert any("ct.nrrd is left out, since it holds 90 x 90 x 90 voxels" in note for note in notes)
    assert any("beats.nii.gz is left out, since it is a time series" in note for note in notes)
    for name, said in (("ct.nrrd", [folder / "ct.nrrd"]), ("used", [])):  # who names it is refused
        used = keys | ({} if said else {"lumens": ["1", "ct.nrrd:above=3"]})
        with pytest.raises(InputError, match=r"ct\.nrrd: holds 90 x 90 x 90 voxels"):
            scenario_of(tmp_path / name, folder, *said, **used)
