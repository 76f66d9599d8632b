"""What a case is given: the same in either frame, roles said or recognised, and one sentence for what can't be used."""

from __future__ import annotations

import gzip
import inspect
import json
import re
from pathlib import Path
from typing import Any

import case_phantom as phantom
import numpy as np
import phantoms
import pytest
import SimpleITK
import trimesh
from dicom_series import write_series

import ctrplan
from ctrplan.__main__ import main
from ctrplan.anatomy.parts import exact_clearance
from ctrplan.commands.program import parser
from ctrplan.errors import CtrplanError, InputError
from ctrplan.files.slicer_markups import read_markups
from ctrplan.patients.case import STEPS, case
from ctrplan.patients.request import OPTIONS, STEP_NAMES, over, request_of
from ctrplan.patients.steps import robot_file
from ctrplan.patients.structures import by_name
from ctrplan.patients.work import SCENARIO
from ctrplan.scenario.joint_space import retracted
from ctrplan.scenario.scenario import Scenario
from ctrplan.storage.toml_document import read_document, toml_text

TARGET = phantom.ENTRY + phantoms.OBLIQUE @ (20.0, -30.0, 120.0)
LOOK = phantom.ENTRY + phantoms.OBLIQUE @ (10.0, 5.0, 100.0)
SIGNS = {"LPS": np.ones(3), "RAS": np.array([-1.0, -1.0, 1.0])}
SAID = ["--lumen", "1", "--avoid", "2"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one patient as NIfTI and as NRRD, and target points in both frames."""
    folder = tmp_path_factory.mktemp("patient")
    made = phantom.labels()
    phantoms.written(made, folder / "ras.nii.gz")
    phantoms.written(made, folder / "lps.nrrd")
    for frame, ending in (("RAS", "fcsv"), ("LPS", "mrk.json")):
        phantom.write_markups(folder / f"target_{frame}.{ending}", frame, {"T": TARGET})
        phantom.write_markups(folder / f"line_{frame}.mrk.json", frame, {"1": phantom.ENTRY, "2": LOOK}, "Line")
    return folder


def made(output: Path, *inputs: Path, **keys: Any) -> Scenario:
    said: dict[str, Any] = {"lumens": ["1"], "avoids": ["2"], "robot": phantom.ROBOT, "until": "scenario"}
    case(output, inputs, **(said | keys))
    return ctrplan.load_scenario(output / SCENARIO, allow_outside=True)


def test_files_in_ras_and_in_lps_give_the_same_scenario(folder: Path, tmp_path: Path) -> None:
    found = {}
    for image, markups, own in (("ras.nii.gz", "RAS", "LPS"), ("lps.nrrd", "LPS", "RAS"), ("ras.nii.gz", "LPS", "RAS")):
        places = {
            "targets": [str(next(folder.glob(f"target_{markups}.*")))],
            "entries": [str(folder / f"line_{markups}.mrk.json")],
        }
        found[image, markups] = made(tmp_path / f"{image}_{markups}", folder / image, frame=own, **places)
    numbers = {"targets": [TARGET * SIGNS["RAS"]], "entries": [phantom.ENTRY * SIGNS["RAS"]]}
    found["said"] = made(tmp_path / "said", folder / "lps.nrrd", frame="RAS", **numbers)
    rng = np.random.default_rng(0)
    points = (phantom.ENTRY + phantom.FAR) / 2 + rng.uniform(-90, 90, (300, 3))
    for name, scenario in found.items():
        turned = SIGNS[str(scenario.frame)]
        assert scenario.goal.tip_m is not None
        np.testing.assert_allclose(scenario.goal.tip_m * 1e3, TARGET * turned, atol=1e-5)
        np.testing.assert_allclose(scenario.base_position_m * 1e3, phantom.ENTRY * turned, atol=1e-5)
        look = (LOOK if name != "said" else TARGET) - phantom.ENTRY
        np.testing.assert_allclose(scenario.base_R[:, 2], look / np.linalg.norm(look) * turned, atol=1e-6)
        for part, body in zip(scenario.anatomy, (phantom.lumen, phantom.vessel), strict=True):
            off = part.shape.distance(points * turned * 1e-3) * 1e3 - body(points)
            far = phantom.vessel(points) > 30 if body is phantom.lumen else np.full(len(points), True)  # a hole in it
            assert np.sqrt(np.mean(off[far] ** 2)) < 0.3 * phantom.VOXEL_MM


def test_markups_obey_the_frame_that_they_say(folder: Path) -> None:
    for path in sorted(folder.glob("target_*")):
        (markup,) = read_markups(path)
        assert markup.frame is not None and markup.frame in path.name and markup.labels == ("T",)
        np.testing.assert_allclose(markup.points_mm[0], TARGET * SIGNS[markup.frame], atol=1e-9)
    old = folder / "old.fcsv"  # 3D Slicer 4.10 and before wrote numbers
    for number, frame in (("0", "RAS"), ("1", "LPS")):
        old.write_text(f"# CoordinateSystem = {number}\nid,1,2,3,0,0,0,1,1,1,0,T,,\n")
        assert read_markups(old)[0].frame == frame
    old.unlink()


def markups(path: Path, *points: dict[str, object]) -> Path:
    body = {"type": "Fiducial", "coordinateSystem": "LPS", "coordinateUnits": "mm", "controlPoints": list(points)}
    path.write_text(json.dumps({"markups": [body]}))
    return path


@pytest.mark.parametrize("status", ["undefined", "preview", "missing"])
def test_points_that_were_not_placed_are_left_out_and_said(status: str, tmp_path: Path) -> None:
    placed = {"label": "a", "position": [1, 2, 3], "positionStatus": "defined"}
    open_point = {"label": "b", "position": "", "positionStatus": status}
    (markup,) = read_markups(markups(tmp_path / "m.mrk.json", open_point, placed, {"position": [4, 5, 6]}))
    np.testing.assert_array_equal(markup.points_mm, [[1, 2, 3], [4, 5, 6]])
    assert markup.labels == ("a", "")
    assert markup.notes == (f"m.mrk.json: point 1 (b) is left out, it has no place (positionStatus is {status})",)
    with pytest.raises(InputError, match=r"markups.1.controlPoints.2.position = \[1, 2, None\]: must have three"):
        read_markups(markups(tmp_path / "m.mrk.json", open_point, placed | {"position": [1, 2, None]}))
    with pytest.raises(InputError, match="markups.1: has no points that were placed"):
        read_markups(markups(tmp_path / "m.mrk.json", open_point))


def test_an_fcsv_point_that_was_not_placed_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "m.fcsv"
    rows = ["0,0,0,0,0,0,0,1,1,1,0,u,,,0,0", "1,1,2,3,0,0,0,1,1,1,0,a,,,2,0"]
    path.write_text(
        "# CoordinateSystem = LPS\n# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
        + "\n".join(rows)
    )
    (markup,) = read_markups(path)
    assert markup.labels == ("a",) and markup.notes == (
        "m.fcsv: point 1 (u) is left out, it has no place (its status is undefined)",
    )


HIDDEN = "is hidden or not selected in 3D Slicer, and is taken all the same"


def test_points_that_are_hidden_or_not_selected_are_said(tmp_path: Path) -> None:
    point = {"label": "a", "position": [1, 2, 3]}
    for keys, is_said in (({}, False), ({"visibility": False}, True), ({"selected": False}, True)):
        (markup,) = read_markups(markups(tmp_path / "m.mrk.json", point | keys))
        assert markup.notes == ((f"m.mrk.json: point 1 (a) {HIDDEN}",) if is_said else ())
        assert markup.labels == ("a",)
    path = tmp_path / "m.fcsv"
    for cells, is_said in (("1,1", False), ("0,1", True), ("1,0", True)):
        path.write_text(f"# CoordinateSystem = LPS\n1,1,2,3,0,0,0,1,{cells},0,a,,,2,0\n")
        assert read_markups(path)[0].notes == ((f"m.fcsv: point 1 (a) {HIDDEN}",) if is_said else ())


def written(path: Path, **keys: object) -> Path:
    body = {"type": "Fiducial", "coordinateSystem": "LPS", "controlPoints": [{"position": [1, 2, 3]}]} | keys
    path.write_text(json.dumps({"markups": [body]}))
    return path


@pytest.mark.parametrize(
    ("said", "factor"),
    [("mm", 1), ("cm", 10), ("m", 1e3), ("um", 1e-3), (["mm", "UCUM"], 1), (["cm", "UCUM"], 10)],
)
def test_units_of_markups_are_those_that_they_say(said: object, factor: float, tmp_path: Path) -> None:
    far = [{"position": [40.0 / factor, 2.0 / factor, -3.0 / factor]}]
    (markup,) = read_markups(written(tmp_path / "m.mrk.json", coordinateUnits=said, controlPoints=far))
    np.testing.assert_allclose(markup.points_mm, [[40, 2, -3]])


WRONG: list[tuple[dict[str, object], str]] = [
    ({"coordinateUnits": "inch"}, "markups.1.coordinateUnits = 'inch': must be one of mm, cm, m, um"),
    ({"coordinateUnits": []}, r"markups.1.coordinateUnits = \[\]: must be one of"),
    ({"coordinateUnits": [["mm"]]}, "markups.1.coordinateUnits = .*: must be one of"),
    ({"coordinateUnits": {"unit": "mm"}}, "markups.1.coordinateUnits.*: must be one of"),
    ({"coordinateUnits": None}, "markups.1.coordinateUnits = None: must be one of"),
    ({"coordinateSystem": 0}, r"coordinateSystem = 0: must be RAS or LPS \(of numbers 0 is RAS and 1 is LPS in .fcsv"),
    ({"coordinateSystem": "1"}, "coordinateSystem = '1': must be RAS or LPS .of numbers"),
    ({"coordinateSystem": "lps"}, "coordinateSystem = 'lps': must be RAS or LPS"),
    ({"coordinateSystem": "IJK"}, "coordinateSystem = 'IJK': must be RAS or LPS"),
    ({"type": "Line"}, "markups.1: is a Line of one point that was placed: it needs two"),
    ({"type": "Curve"}, "markups.1: is a Curve of one point that was placed: it needs two"),
    ({"type": "ClosedCurve"}, "markups.1.type = 'ClosedCurve': must be one of"),
    ({"controlPoints": [{"position": [0, 0, float("nan")]}]}, "must lie from"),
    ({"controlPoints": [{"position": [0, "1", 0]}]}, "must have three numbers"),
    ({"controlPoints": [7]}, "is no file of markups"),
    ({"coordinateUnits": "m", "controlPoints": [{"position": [40, 2, 3e3]}]}, "must lie from -100000 to 100000 mm"),
]


@pytest.mark.parametrize(("keys", "phrase"), WRONG)
def test_wrong_markups_are_refused_by_name(keys: dict[str, object], phrase: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=phrase) as caught:
        read_markups(written(tmp_path / "m.mrk.json", **keys))
    assert "\n" not in str(caught.value)


def test_markups_that_say_a_thing_twice_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "m.mrk.json")
    text = path.read_text()
    path.write_text(text.replace('"coordinateSystem"', '"coordinateSystem": "RAS", "coordinateSystem"'))
    with pytest.raises(InputError, match="says coordinateSystem twice, and differently"):
        read_markups(path)
    path.write_text(text.replace('"coordinateSystem"', '"coordinateSystem": "LPS", "coordinateSystem"'))
    assert read_markups(path)[0].frame == "LPS"
    path.write_text(text.replace('"coordinateSystem"', '"length": NaN, "coordinateSystem"'))
    assert read_markups(path)[0].frame == "LPS"
    old = tmp_path / "m.fcsv"
    old.write_text("# CoordinateSystem = LPS\n# CoordinateSystem = RAS\n1,1,2,3\n")
    with pytest.raises(InputError, match="CoordinateSystem = 'RAS': says another frame than the line before, LPS"):
        read_markups(old)
    old.write_text("# CoordinateSystem = LPS\n# CoordinateSystem = 1\n1,1,2,3\n")
    assert read_markups(old)[0].frame == "LPS"


def test_an_fcsv_file_of_other_columns_and_signs_between_them(tmp_path: Path) -> None:
    path = tmp_path / "m.fcsv"  # of 3D Slicer 3
    path.write_text("# name = F\n# columns = label,x,y,z,sel,vis\nT,1,2,3,1,1\n")
    (markup,) = read_markups(path)
    assert markup.frame is None and markup.labels == ("T",) and markup.points_mm.tolist() == [[1, 2, 3]]
    path.write_text("# CoordinateSystem = LPS\n1;1,5;2;3;0;0;0;1;1;1;0;T;;\n")
    with pytest.raises(
        InputError, match="point 1 = '.*': must have three numbers .commas between them, points in them."
    ):
        read_markups(path)


def test_a_case_tells_of_points_that_were_left_out(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points = [
        {"label": "target 1", "position": TARGET.tolist()},
        {"label": "target 2", "position": "", "positionStatus": "missing"},
        {"label": "entry", "position": phantom.ENTRY.tolist()},
    ]
    path = markups(tmp_path / "points.mrk.json", *points)
    said = ["case", str(folder / "lps.nrrd"), str(path), *SAID, "--robot", str(phantom.ROBOT), "--until", "scenario"]
    assert main([*said, "-o", str(tmp_path / "case")]) == 0
    assert "point 2 (target 2) is left out" in capsys.readouterr().err


def test_points_are_found_by_their_labels(folder: Path, tmp_path: Path) -> None:
    points = {"entry": phantom.ENTRY, "target 2": TARGET, "landmark": TARGET + 5, "target 1": LOOK}
    path = phantom.write_markups(tmp_path / "points.fcsv", "RAS", points)
    scenario = made(tmp_path / "case", folder / "lps.nrrd", path)
    assert [goal.name for goal in scenario.targets] == ["target 2", "target 1"]
    np.testing.assert_allclose(scenario.base_position_m * 1e3, phantom.ENTRY * SIGNS["RAS"], atol=1e-5)
    one = made(tmp_path / "one", folder / "lps.nrrd", path, targets=["points.fcsv:landmark"], entries=["entry"])
    assert one.goal.tip_m is not None
    np.testing.assert_allclose(one.goal.tip_m * 1e3, (TARGET + 5) * SIGNS["RAS"], atol=1e-5)


def test_names_that_leave_no_doubt_are_recognised_and_told(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    segmentation = SimpleITK.ReadImage(str(folder / "lps.nrrd"))
    for k, name in enumerate(("Trachea", "Aorta")):
        for key, value in (("Name", name), ("LabelValue", str(k + 1)), ("Layer", "0"), ("ID", f"S{k}")):
            segmentation.SetMetaData(f"Segment{k}_{key}", value)
    phantoms.written(segmentation, tmp_path / "patient.seg.nrrd")
    where = ["--frame", "LPS", "--target", *map(str, TARGET), "--entry", *map(str, phantom.ENTRY)]
    said = ["case", str(tmp_path / "patient.seg.nrrd"), *where, "--robot", str(phantom.ROBOT), "--until", "scenario"]
    assert main([*said, "-o", str(tmp_path / "both")]) == 0
    told = capsys.readouterr().err
    assert "Trachea" in told and "taken for a lumen" in told and "Aorta" in told and "to be avoided" in told
    parts = read_document(tmp_path / "both" / SCENARIO).content["anatomy"]
    assert [(part["segment"], part["role"]) for part in parts] == [("Trachea", "inside"), ("Aorta", "avoid")]
    assert main([*said, "-o", str(tmp_path / "one"), "--ignore", "Aorta"]) == 0
    assert len(read_document(tmp_path / "one" / SCENARIO).content["anatomy"]) == 1
    assert by_name("bronchial_vessels") is None and by_name("liver") is None  # two roles, and none


def test_the_robot_of_cases_is_the_shipped_one_and_begins_drawn_back() -> None:
    shipped = phantom.ROBOT.with_name("three_tube_insertion.toml")
    assert robot_file(None).read_bytes() == shipped.read_bytes()
    robot = ctrplan.load_robot(shipped)
    joints = retracted(robot)
    back = [k for k, joint in enumerate(robot.drive.joints) if joint.unit == "mm"]
    np.testing.assert_allclose(joints[back], robot.drive.lower[back])
    _, l_b = robot.drive.collars(joints)
    tips = l_b + [tube.length_m for tube in robot.tubes]
    assert 0 < tips.max() < 2e-3  # a stub before the plate


def test_a_sheath_joins_the_entry_to_the_lumen(folder: Path, tmp_path: Path) -> None:
    outside = phantom.ENTRY - 110 * phantom.WAY
    scenario = made(
        tmp_path / "case", folder / "lps.nrrd", frame="LPS", targets=[TARGET], entries=[outside], sheath_mm=4.0
    )
    along = outside + np.linspace(0, 1, 50)[:, None] * (TARGET - outside)
    lumens = [part for part in scenario.anatomy if part.role == "inside"]
    assert exact_clearance(lumens, along * 1e-3).min() > 1e-3  # all along the straight way
    beside = outside + 5 * phantoms.OBLIQUE[:, 0]
    assert exact_clearance(lumens, beside[None] * 1e-3)[0] < 0


def _refused(arguments: list[str], output: Path, capsys: pytest.CaptureFixture[str]) -> str:
    code = main(["case", *arguments, "--robot", str(phantom.ROBOT), "--until", "scenario", "-o", str(output)])
    told = capsys.readouterr().err.strip().splitlines()[-1]
    assert code == 2 and told.startswith("ctrplan: ") and told.endswith((".", "?")), told
    assert not output.exists()  # nothing half-written
    return told


def test_what_cannot_be_planned_in_is_refused_in_a_sentence(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image, target = str(folder / "lps.nrrd"), ["--target", *map(str, TARGET)]
    entry, frame = ["--entry", *map(str, phantom.ENTRY)], ["--frame", "LPS"]
    away = ["--target", *map(str, phantom.ENTRY + 85.0 * phantoms.OBLIQUE[:, 0])]
    far = ["--target", *map(str, phantom.ENTRY + (900.0, 0, 0))]
    metres = ["--target", *(f"{x / 1e3:.5f}" for x in TARGET), "--entry", *(f"{x / 1e3:.5f}" for x in phantom.ENTRY)]
    blocked = ["--entry", *map(str, phantom.ENTRY - 110 * phantom.WAY)]
    cases = {
        "labels that are not there": (
            [image, *SAID[:2], "--avoid", "7", *target, *entry, *frame],
            "1 .* ml in lps.nrrd",
        ),
        "no role": ([image, *target, *entry, *frame], "--lumen: is needed, or --avoid.*1 .*, 2 .* ml in lps.nrrd"),
        "no frame": ([image, *SAID, *target, *entry], "--frame: is needed"),
        "no target": ([image, *SAID, *entry, *frame], "--target: is needed"),
        "no entry": ([image, *SAID, *target, *frame], "--entry: is needed"),
        "target in tissue": (
            [image, *SAID, *away, *entry, *frame],
            r"target \[.*lies .* mm outside.*nearest place",
        ),
        "target outside all": ([image, *SAID, *far, *entry, *frame], "outside all images"),
        "metres": ([image, *SAID, *metres, *frame], "in metres"),
        "entry in tissue": ([image, *SAID, *target, *blocked, *frame], r"entry \[.*lies .* mm outside"),
        "no file": (["nowhere.nrrd", *SAID, *target, *entry, *frame], "nowhere.nrrd: does not exist"),
        "two numbers": (
            [image, *SAID, "--target", "1", "2", *entry, *frame],
            "--target = '1 2': must be three numbers",
        ),
        "no markup": ([image, *SAID, "--target", "liver", *entry, *frame], "no label of a point"),
    }
    for name, (arguments, rule) in cases.items():
        told = _refused(arguments, tmp_path / name, capsys)
        assert re.search(rule, told), (name, told)


def test_damaged_files_are_refused_by_their_names(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = ["--target", *map(str, TARGET), "--entry", *map(str, phantom.ENTRY), "--frame", "LPS", *SAID]
    whole = (folder / "ras.nii.gz").read_bytes()
    (tmp_path / "cut.nii.gz").write_bytes(whole[: len(whole) // 2])
    unpacked = bytearray(gzip.decompress(whole))
    unpacked[70:74] = (64).to_bytes(2, "little") * 2  # doubles, of 64 bits
    unpacked[40:48] = b"".join(n.to_bytes(2, "little") for n in (3, 1500, 1500, 600))
    (tmp_path / "huge.nii").write_bytes(unpacked)
    trimesh.creation.icosphere(radius=0.06).export(tmp_path / "metres.stl")
    (tmp_path / "no_frame.fcsv").write_text("id,1,2,3,0,0,0,1,1,1,0,T,,\n")
    plane = {"type": "Plane", "coordinateSystem": "LPS", "controlPoints": []}
    (tmp_path / "plane.mrk.json").write_text(json.dumps({"markups": [plane]}))
    (tmp_path / "ijk.fcsv").write_text("# CoordinateSystem = IJK\nid,1,2,3\n")
    colour = SimpleITK.GetImageFromArray(np.zeros((4, 4, 4, 3), np.uint8), isVector=True)
    SimpleITK.WriteImage(colour, str(tmp_path / "colour.nrrd"))
    (tmp_path / "empty").mkdir()
    cases = {
        "cut.nii.gz": "cut.nii.gz: is damaged or cut short",
        "huge.nii": "huge.nii: holds 1500 x 1500 x 600 voxels, .* GB: crop",
        "metres.stl": "metres.stl: .*metres",
        "no_frame.fcsv": "no_frame.fcsv: does not say whether",
        "plane.mrk.json": "plane.mrk.json: markups.1.type = 'Plane': must be one of",
        "ijk.fcsv": "ijk.fcsv: CoordinateSystem = 'IJK': must be RAS or LPS",
        "colour.nrrd": "colour.nrrd: has 3 values a voxel",
        "empty": "empty: holds no files",
    }
    for name, rule in cases.items():
        arguments = [str(folder / "lps.nrrd"), str(tmp_path / name), *where]
        if name == "metres.stl":
            arguments += ["--avoid", "metres", "--file-frame", "LPS"]
        if name == "no_frame.fcsv":
            arguments += ["--target", str(tmp_path / name)]
        told = _refused(arguments, tmp_path / f"of {name}", capsys)
        assert re.search(rule, told), (name, told)


def test_of_several_dicom_series_one_is_said(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "ct").mkdir()
    grey = phantoms.image(phantom.lumen, (phantom.ENTRY + phantom.FAR) / 2, 200.0, 20.0, grey=True)
    for uid in ("11", "12"):
        write_series(tmp_path / "ct", grey, uid)
    where = ["--target", *map(str, TARGET), "--entry", *map(str, phantom.ENTRY), "--frame", "LPS"]
    said = [str(tmp_path / "ct"), *where, "--lumen", "ct:above=-500"]
    told = _refused(said, tmp_path / "both", capsys)
    assert re.search(r"ct: holds 2 series: .*1.2.826.11 \(CT 'series 11', .* images\); 1.2.826.12", told), told
    told = _refused([*said[:-1], "ct"], tmp_path / "no range", capsys)
    assert "ct has grey values" in told and "ct:below=-500" in told
    output = tmp_path / "one"
    scenario = made(
        output,
        tmp_path / "ct",
        frame="LPS",
        targets=[TARGET],
        entries=[phantom.ENTRY],
        series="1.2.826.12",
        lumens=["ct:above=-500"],
        avoids=None,
    )
    off = scenario.anatomy[0].shape.distance(TARGET[None] * 1e-3)[0] * 1e3 - phantom.lumen(TARGET[None])[0]
    assert abs(off) < 5.0


def test_toml_is_written_as_it_is_read(tmp_path: Path) -> None:
    content = {
        "name": 'a "quoted" \\ name\n',
        "frame": "RAS",
        "start": {"rotate all": 1.5, "l": -3},
        "anatomy": [{"kind": "mesh", "files": ["a", "b"], "p": [1.0, 2.0]}, {"kind": "x", "deep": {"k": [{"j": 1}]}}],
        "empty": [],
    }
    (tmp_path / "a.toml").write_text(toml_text(content))
    assert read_document(tmp_path / "a.toml").content == content


def test_the_command_lists_the_steps_that_there_are() -> None:
    assert tuple(step.name for step in STEPS) == STEP_NAMES  # written down twice, so that --help imports no planner


def test_what_is_said_is_the_same_when_it_was_written_as_json() -> None:
    said = request_of(
        {"seed": np.int64(3), "margin_mm": np.float64(0.25), "robot": Path("r.toml"), "lumens": ["1"], "unit": None}
    )
    assert said == {"seed": 3, "margin_mm": 0.25, "robot": "r.toml", "lumens": ("1",)}
    assert request_of(json.loads(json.dumps(said))) == said
    assert over(request_of({"seed": 4}), said) == {**said, "seed": 4}
    assert over(request_of({"inputs": ("a",)}), said) == {"inputs": ("a",)}


def test_every_option_is_a_keyword_of_the_function_and_an_option_of_the_command() -> None:
    keywords = inspect.signature(case).parameters
    assert set(OPTIONS) <= set(keywords) and all(keywords[name].default is None for name in OPTIONS)
    parsed = vars(parser().parse_args(["case", "-o", "case", "--time", "5", "--lumen", "a", "--lumen", "b"]))
    assert set(OPTIONS) <= set(parsed) and parsed["time_s"] == 5 and parsed["lumens"] == ["a", "b"]
    with pytest.raises(TypeError, match=r"case\(\) got an unexpected keyword argument 'lumen'"):
        case("case", lumen=["a"])


def test_a_case_raises_what_the_command_says(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(CtrplanError, match="must be three numbers"):
        case(tmp_path / "case", [folder / "lps.nrrd"], targets=[[1.0, 2.0]])
    with pytest.raises(CtrplanError, match="from_step"):
        case(tmp_path / "case", from_step="report")
    with pytest.raises(CtrplanError, match="FILES: are needed"):
        case(tmp_path / "case")
    assert not (tmp_path / "case").exists()
