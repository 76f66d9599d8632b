"""Files for 3D Slicer, read back by other means: all comes out where it is in the patient, in both frames."""

from __future__ import annotations

import io
import json
import re
import xml.etree.ElementTree as ET
import zipfile
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import trimesh
from jsonschema import validate
from scipy.spatial.transform import Rotation

from ctrplan.anatomy.patient_frame import Frame
from ctrplan.base.surface import Surface
from ctrplan.errors import InputError
from ctrplan.files.slicer_markups import patient_frame
from ctrplan.reports.slicer_case import itk_transform_text, markups_text, model_sequence, ply_model
from ctrplan.scenario.scenario import Scenario

# Nothing of it looks the same from another side. In the patient: P is 10 mm left of the origin, 20 behind, 30 above.
POINTS_LPS_MM = np.array([[10, 20, 30], [-1, 0, 0], [0, 2.5, -7], [40.25, -3, 11]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
BOTH = pytest.mark.parametrize("frame", ["RAS", "LPS"])
NUMBERS = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
COLOUR = {**NUMBERS, "items": {"type": "number", "minimum": 0, "maximum": 1}}
# The facts of markups-schema-v1.0.3 that such files depend on, and what of them Slicer would take for granted.
MARKUPS_SCHEMA: dict[str, Any] = {
    "type": "object",
    "required": ["@schema", "markups"],
    "properties": {
        "@schema": {"type": "string", "pattern": r"/markups-schema-v1\.0\.3\.json#$"},
        "markups": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["type", "coordinateSystem", "coordinateUnits", "controlPoints"],
                "properties": {
                    "type": {"enum": ["Fiducial", "Line", "Angle", "Curve", "ClosedCurve", "Plane", "ROI"]},
                    "coordinateSystem": {"enum": ["LPS", "RAS"]},
                    "coordinateUnits": {"enum": ["mm", "um"]},
                    "locked": {"type": "boolean"},
                    "labelFormat": {"type": "string"},
                    "controlPoints": {
                        "type": "array",
                        "items": {
                            "type": "object",
                            "required": ["id", "position"],
                            "properties": {
                                "id": {"type": "string"},
                                "label": {"type": "string"},
                                "position": NUMBERS,
                                "selected": {"type": "boolean"},
                                "locked": {"type": "boolean"},
                                "visibility": {"type": "boolean"},
                                "positionStatus": {"enum": ["undefined", "preview", "defined"]},
                            },
                        },
                    },
                    "display": {
                        "type": "object",
                        "properties": {
                            "visibility": {"type": "boolean"},
                            "opacity": {"type": "number", "minimum": 0, "maximum": 1},
                            "color": COLOUR,
                            "selectedColor": COLOUR,
                            "pointLabelsVisibility": {"type": "boolean"},
                            "propertiesLabelVisibility": {"type": "boolean"},
                            "glyphScale": {"type": "number", "minimum": 0},
                        },
                    },
                },
            },
        },
    },
}


def given(frame: Frame) -> np.ndarray:
    """The points as a scenario of that frame has them, in m."""
    return POINTS_LPS_MM * ([1, 1, 1] if frame == "LPS" else [-1, -1, 1]) * 1e-3


def in_lps(points: np.ndarray, said: str) -> np.ndarray:
    """What a reader makes of a file's coordinates in the frame that the file says."""
    return points * {"LPS": [1, 1, 1], "RAS": [-1, -1, 1]}[said]


@BOTH
@pytest.mark.parametrize("kind", ["Curve", "Fiducial"])
def test_markups_keep_the_schema_and_come_back(frame: Frame, kind: Any) -> None:
    labels = ("a", 'b "quoted" <', "c", "ü") if kind == "Fiducial" else ()
    content = json.loads(markups_text(kind, given(frame), frame, colour="#FF8000", labels=labels))
    validate(content, MARKUPS_SCHEMA)
    (markup,) = content["markups"]
    points = np.array([point["position"] for point in markup["controlPoints"]])
    np.testing.assert_allclose(in_lps(points, markup["coordinateSystem"]), POINTS_LPS_MM, atol=1e-6)
    assert markup["type"] == kind and markup["coordinateUnits"] == "mm"
    assert tuple(point["label"] for point in markup["controlPoints"]) == (labels or ("",) * 4)
    assert len({point["id"] for point in markup["controlPoints"]}) == 4


def read_ply(content: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices in LPS and triangles, by a reader that is not ours; the frame by the comment, as Slicer takes it."""
    mesh = trimesh.load(io.BytesIO(content), file_type="ply", process=False)
    (said,) = re.findall(rb"^comment SPACE=(RAS|LPS)$", content.split(b"end_header")[0], re.M)
    return in_lps(np.array(mesh.vertices), said.decode()), np.array(mesh.faces)


@BOTH
def test_models_come_back_and_stay_turned_outward(frame: Frame) -> None:
    vertices, faces = read_ply(ply_model(Surface(given(frame), FACES), frame))
    np.testing.assert_allclose(vertices, POINTS_LPS_MM, atol=1e-5)
    np.testing.assert_array_equal(faces, FACES)


@BOTH
def test_what_stands_under_the_base_transform_comes_to_its_place(frame: Frame) -> None:
    R, position = Rotation.from_euler("xyz", [20, -50, 110], degrees=True).as_matrix(), np.array([0.011, -0.02, 0.3])
    text = itk_transform_text(position, R, frame)
    assert text.startswith("#Insight Transform File V1.0\n")
    (parameters,) = re.findall(r"^Parameters: (.*)$", text, re.M)
    (fixed,) = re.findall(r"^FixedParameters: (.*)$", text, re.M)
    values = np.array(parameters.split(), dtype=float)
    assert fixed == "0 0 0" and values.shape == (12,)
    # ITK's affine map of a centre at 0 is A x + t, from the patient (LPS) to the robot; what is moved goes back.
    A, t = values[:9].reshape(3, 3), values[9:]
    of_robot = np.array([[0.0, 0, 0], [0, 0, 100], [7, 0, 0], [0, -3, 1]])
    moved = np.linalg.solve(A, (of_robot - t).T).T
    anatomy_mm = of_robot @ R.T + position * 1e3
    np.testing.assert_allclose(moved, in_lps(anatomy_mm, frame), atol=1e-8)


@BOTH
def test_a_sequence_holds_a_model_for_each_time(frame: Frame) -> None:
    times = [0.0, 0.5, 1.25]
    surfaces = [Surface(given(frame) * (k + 1), FACES) for k in range(3)]
    bundle = zipfile.ZipFile(io.BytesIO(model_sequence("tube_1", times, surfaces, frame)))
    (scene,) = [name for name in bundle.namelist() if name.endswith(".mrml")]
    root = ET.fromstring(bundle.read(scene))
    nodes = {node.get("id"): node for node in root}
    assert len(nodes) == len(root)
    index = nodes["vtkMRMLSequenceNodeSequenceIndex"]
    assert index.get("singletonTag") == "SequenceIndex" and index.get("indexUnit") == "s"
    entries = [entry.split(":") for entry in index.get("indexValues", "").split(";")]
    assert [float(time) for _, time in entries] == times
    for k, (model, _) in enumerate(entries):
        (storage,) = re.findall(r"storage:(\w+)", nodes[model].get("references", ""))
        file = f"{scene.rsplit('/', 1)[0]}/{nodes[storage].get('fileName')}"
        vertices, _ = read_ply(bundle.read(file))
        np.testing.assert_allclose(vertices, POINTS_LPS_MM * (k + 1), atol=1e-4)


@pytest.mark.parametrize("value", [None, "", "ras", "LAS", "RAS "])
def test_a_frame_is_never_guessed(value: str | None) -> None:
    with pytest.raises(InputError, match="must be RAS or LPS"):
        patient_frame(cast(Scenario, SimpleNamespace(frame=None)), value)


@BOTH
def test_a_scenario_that_says_its_frame_is_not_overruled(frame: Frame) -> None:
    scenario, other = cast(Scenario, SimpleNamespace(frame=frame)), "LPS" if frame == "RAS" else "RAS"
    assert patient_frame(scenario, None) == patient_frame(scenario, frame) == frame
    with pytest.raises(InputError, match=f"contradicts the scenario, which says {frame}"):
        patient_frame(scenario, other)
