"""A plan's motion -> contents of the files of a case folder, by name; the scene that loads them comes last.

Files that 3D Slicer reads, made without it: scenes, models, markups, transforms and sequences.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal
from xml.sax.saxutils import quoteattr

import numpy as np

from ctrplan.anatomy.patient_frame import Frame
from ctrplan.base.arrays import MM_DIGITS, Array
from ctrplan.base.surface import Surface
from ctrplan.files.slicer_markups import SCENE, SPACE, lps_mm, to_lps
from ctrplan.reports import looks
from ctrplan.reports.plan_scene import WrittenMotion
from ctrplan.reports.robot_surface import stand, swept_surface
from ctrplan.reports.words import millimetres


def rgb(colour: str) -> list[float]:
    """Red, green and blue in [0, 1] of "#RRGGBB"."""
    return [round(int(colour[k : k + 2], 16) / 255, 4) for k in (1, 3, 5)]


def itk_transform_text(position_m: Array, R: Array, frame: Frame) -> str:
    """A rigid motion x -> R x + position from the robot's frame to the anatomy's, as ITK writes it.

    ITK's transforms go the way that resampling needs, from the parent to what is moved, in LPS and mm: the file holds
    x -> A' (x - t) with A, t of the motion to LPS. Slicer turns that round when it reads, so that what is put under
    the transform, in files that it takes for LPS, moves from the robot's frame to the patient.
    """
    A, t = to_lps(frame) @ R, lps_mm(position_m, frame)
    parameters = [*(A.T).ravel().tolist(), *(-A.T @ t).tolist()]
    return (
        "#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\n"
        f"Parameters: {' '.join(f'{value + 0.0:.12g}' for value in parameters)}\nFixedParameters: 0 0 0\n"
    )


SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)
MarkupType = Literal["Curve", "Line", "Fiducial"]


def markups_text(
    kind: MarkupType,
    points_m: Array,
    frame: Frame,
    *,
    colour: str = "#808080",
    labels: Sequence[str] = (),
    visible: bool = True,
) -> str:
    """A file with one markup through points (K, 3) [m] of the anatomy's frame, locked; colour as "#RRGGBB".

    `labels` name the points, and are shown where there are any.
    """
    names = labels or [""] * len(points_m)
    rows = zip(np.round(lps_mm(points_m, frame), MM_DIGITS).tolist(), names, strict=True)
    markup = {
        "type": kind,
        "coordinateSystem": SPACE,
        "coordinateUnits": "mm",
        "locked": True,
        "labelFormat": "%N-%d",
        "controlPoints": [_point(k, place, name) for k, (place, name) in enumerate(rows, start=1)],
        "display": _display(kind, colour, bool(labels), visible),
    }
    return json.dumps({"@schema": SCHEMA, "markups": [markup]}, indent=1) + "\n"


def _point(number: int, place: list[float], label: str) -> dict[str, Any]:
    return {
        "id": str(number),
        "label": label,
        "position": place,
        "selected": True,
        "locked": True,
        "visibility": True,
        "positionStatus": "defined",
    }


def _display(kind: MarkupType, colour: str, labelled: bool, visible: bool) -> dict[str, Any]:
    shown = {"color": rgb(colour), "selectedColor": rgb(colour), "visibility": visible, "opacity": 1.0}
    size = 1.2 if kind == "Fiducial" else 0.2  # points of a curve would hide it
    return shown | {"pointLabelsVisibility": labelled, "propertiesLabelVisibility": False, "glyphScale": size}


@dataclass(frozen=True)
class Node:
    """An element: its id is made of `kind` and `number` as Slicer makes it."""

    kind: str  # "Model" of vtkMRMLModelNode
    number: int | str
    name: str
    attributes: Mapping[str, str] = field(default_factory=dict)
    references: Mapping[str, Sequence[Node]] = field(default_factory=dict)  # by role

    @property
    def id(self) -> str:
        """What other nodes call it."""
        return f"vtkMRML{self.kind}Node{self.number}"


def scene_text(nodes: Iterable[Node]) -> str:
    """The content of a .mrml file."""
    return '<MRML version="Slicer5.0.0" userTags="">\n' + "".join(map(_element, nodes)) + "</MRML>\n"


def model_nodes(number: int, name: str, file: str, colour: str, *, opacity: float = 1.0) -> tuple[Node, Node, Node]:
    """A model with its file and its looks; the first one is the model."""
    look = {"color": _numbers(colour), "opacity": f"{opacity:g}", "visibility": "true"}
    storage = storage_node("ModelStorage", number, file)
    display = Node("ModelDisplay", number, f"{name} display", look)
    return Node("Model", number, name, {}, {"display": [display], "storage": [storage]}), display, storage


def markup_nodes(kind: str, number: int, name: str, file: str, visible: bool = True) -> tuple[Node, Node, Node]:
    """A markup ("Curve", "Line", "Fiducial") with its file; colours come with the file. The first one is the markup."""
    display_kind = "MarkupsFiducialDisplay" if kind == "Fiducial" else "MarkupsDisplay"
    storage = storage_node("MarkupsJsonStorage", number, file)
    display = Node(display_kind, number, f"{name} display", {"visibility": "true" if visible else "false"})
    references = {"display": [display], "storage": [storage]}
    return Node(f"Markups{kind}", number, name, {}, references), display, storage


def storage_node(kind: str, number: int, file: str) -> Node:
    """Where a node's data are, in a file of the scene's folder."""
    return Node(kind, number, file, {"fileName": file, "coordinateSystem": SPACE})


def _element(node: Node) -> str:
    references = "".join(f"{role}:{' '.join(to.id for to in nodes)};" for role, nodes in node.references.items())
    own = {"id": node.id, "name": node.name, **node.attributes} | ({"references": references} if references else {})
    return f" <{node.kind} {' '.join(f'{key}={quoteattr(value)}' for key, value in own.items())}></{node.kind}>\n"


def _numbers(colour: str) -> str:
    return " ".join(f"{value:g}" for value in rgb(colour))


FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def ply_model(surface: Surface, frame: Frame) -> bytes:
    """The file's content: vertices in mm, in single precision; Slicer takes the frame from the comment."""
    vertices = lps_mm(surface.vertices_m, frame).astype("<f4")
    faces = np.empty(len(surface.faces), FACE)
    faces["count"], faces["corners"] = 3, surface.faces
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment SPACE={SPACE}",
        "comment unit mm",
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    return "\n".join(header).encode() + b"\n" + vertices.tobytes() + faces.tobytes()


def model_sequence(name: str, times_s: Sequence[float], surfaces: Sequence[Surface], frame: Frame) -> bytes:
    """The content of a .seq.mrb file; surfaces in m, in the anatomy's frame. `name` is of letters, digits and _."""
    content = io.BytesIO()
    models = [model_nodes(k, f"{name}_{k}", f"Data/{name}_{k}.ply", "#808080")[::2] for k in _index_values(times_s)]
    index = sequence_node("SequenceIndex", name, times_s, {"singletonTag": "SequenceIndex"})
    files = {f"{name}.mrml": scene_text([index, *(node for pair in models for node in _bare(*pair))]).encode()}
    for k, surface in zip(_index_values(times_s), surfaces, strict=True):
        files[f"Data/{name}_{k}.ply"] = ply_model(surface, frame)
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as bundle:
        for path, data in files.items():
            member = zipfile.ZipInfo(f"{name}/{path}")  # of 1980: the same plan makes the same file
            bundle.writestr(member, data, zipfile.ZIP_DEFLATED)
    return content.getvalue()


def sequence_node(
    number: int | str, name: str, times_s: Sequence[float], attributes: dict[str, str], storage: Node | None = None
) -> Node:
    """The node that says the time of each model of a bundle."""
    values = ";".join(
        f"vtkMRMLModelNode{k}:{time:.4f}" for k, time in zip(_index_values(times_s), times_s, strict=True)
    )
    index = {
        "indexName": "time",
        "indexUnit": "s",
        "indexType": "numeric",
        "numericIndexValueTolerance": "0.00001",
        "indexValues": values,
    }
    return Node("Sequence", number, name, index | attributes, {"storage": [storage]} if storage else {})


def browser_node(name: str, fps: float, pairs: Sequence[tuple[Node, Node]]) -> Node:
    """Plays sequences together: pairs of a sequence and the model that shows it, the first one with the time."""
    references: dict[str, list[Node]] = {}
    for k, (sequence, shown) in enumerate(pairs):
        references |= {f"sequenceNodeRef{k}": [sequence], f"dataNodeRef{k}": [shown]}
    attributes = {
        "playbackActive": "false",
        "playbackRateFps": f"{fps:.3g}",
        "playbackItemSkippingEnabled": "true",
        "playbackLooped": "true",
        "selectedItemNumber": "0",
        "virtualNodePostfixes": " ".join(str(k) for k in range(len(pairs))),
    }
    return Node("SequenceBrowser", 1, name, attributes, references)


def _index_values(times_s: Sequence[float]) -> range:
    return range(1, len(times_s) + 1)


def _bare(model: Node, storage: Node) -> Iterator[Node]:
    """A model without looks, which are those of the model that shows it."""
    yield Node(model.kind, model.number, model.name, model.attributes, {"storage": [storage]})
    yield storage


PERCENTS = tuple(range(0, 101, 10))  # of the motion's time, at which centrelines are written
MOST_POINTS = 300  # of a curve: Slicer draws each of them
SIDES, ENVELOPE_SIDES = 16, 14


def case_files(motion: WrittenMotion, frame: Frame) -> dict[str, str | bytes]:
    """The content of each file; frame is that of the anatomy."""
    case = _Case(frame)
    _anatomy(case, motion)
    _robot(case, motion)
    _curves(case, motion)
    scenario = motion.scenario
    case.files["base.tfm"] = itk_transform_text(scenario.base_position_m, scenario.base_R, frame)
    storage = storage_node("TransformStorage", 1, "base.tfm")
    case.nodes += [Node("LinearTransform", 1, "robot base", {}, {"storage": [storage]}), storage]
    return {**case.files, SCENE: scene_text(case.nodes)}


class _Case:
    """Files and nodes that were made so far."""

    def __init__(self, frame: Frame) -> None:
        self.frame = frame
        self.files: dict[str, str | bytes] = {}
        self.nodes: list[Node] = []
        self.models = self.markups = 0

    def model(self, file: str, name: str, surface: Surface, colour: str, opacity: float = 1.0) -> Node:
        """Adds a surface; returns its node."""
        self.models += 1
        self.files[file] = ply_model(surface, self.frame)
        nodes = model_nodes(self.models, name, file, colour, opacity=opacity)
        self.nodes += nodes
        return nodes[0]

    def markup(
        self,
        kind: MarkupType,
        file: str,
        name: str,
        points_m: Array,
        colour: str,
        labels: tuple[str, ...] = (),
        visible: bool = True,
    ) -> None:
        """Adds points or a line through them."""
        self.markups += 1
        self.files[file] = markups_text(kind, points_m, self.frame, colour=colour, labels=labels, visible=visible)
        self.nodes += markup_nodes(kind, self.markups, name, file, visible)

    def sequence(self, number: int, name: str, times_s: list[float], surfaces: list[Surface]) -> Node:
        """Adds a surface over time; returns the node that holds it."""
        file = f"{name}.seq.mrb"
        self.files[file] = model_sequence(name, times_s, surfaces, self.frame)
        storage = storage_node("SequenceStorage", number, file)
        node = sequence_node(number, name, times_s, {}, storage)
        self.nodes += [node, storage]
        return node


def _anatomy(case: _Case, motion: WrittenMotion) -> None:
    for k, part in enumerate(motion.scenario.anatomy, start=1):
        look, opacity = looks.ANATOMY_LOOK[part.role], looks.ANATOMY_OPACITY[part.role]
        name = f"anatomy {k}: {part.shape.name}, {look.name}"
        case.model(f"anatomy_{k}.ply", name, part.shape.surface(), look.colour, opacity)
    case.model("plate.ply", looks.PLATE_LOOK.name, stand(motion.scenario), looks.PLATE_LOOK.colour)


def _robot(case: _Case, motion: WrittenMotion) -> None:
    """Tubes and envelope over time, shown where they start; and all the space that the envelope sweeps."""
    swept = swept_surface(motion.path)
    case.model("swept_envelope.ply", "space the envelope sweeps", swept, looks.ENVELOPE_LOOK.colour, 0.15)
    bodies = [
        (f"tube_{k + 1}", looks.tube_look(k), 1.0, [pose.tubes[k].surface(SIDES) for pose in motion.path])
        for k in range(motion.scenario.robot.n)
    ]
    envelope = [pose.envelope.surface(ENVELOPE_SIDES) for pose in motion.path]
    pairs = []
    for k, (name, look, opacity, surfaces) in enumerate([*bodies, ("envelope", looks.ENVELOPE_LOOK, 0.3, envelope)], 1):
        shown = case.model(f"{name}.ply", look.name, surfaces[0], look.colour, opacity)
        pairs.append((case.sequence(k, name, motion.times_s, surfaces), shown))
    fps = (len(motion.path) - 1) / max(motion.times_s[-1], 1e-3)
    case.nodes.append(browser_node("motion", max(fps, 1e-3), pairs))


def _curves(case: _Case, motion: WrittenMotion) -> None:
    every = max(1, -(-len(motion.tip_m) // MOST_POINTS))
    tips = np.concatenate([motion.tip_m[:-1:every], motion.tip_m[-1:]])
    case.markup("Curve", "tip_path.mrk.json", looks.TIP_PATH.name, tips, looks.TIP_PATH.colour)
    last = max(len(motion.path) - 1, 1)
    for k in sorted({min(round(percent / 100 * last), len(motion.path) - 1) for percent in PERCENTS}):
        pose, (_, percent) = motion.path[k], min((abs(p / 100 - k / last), p) for p in PERCENTS)
        name = f"centreline at {pose.time_s:.1f} s"
        ends = percent in (0, 100)
        file = f"centreline_{percent:03}.mrk.json"
        case.markup("Curve", file, name, pose.tubes[-1].centreline_m, looks.CORNERS.colour, visible=ends)
    places = {"entry": motion.scenario.base_position_m, **motion.targets}
    points = np.array(list(places.values()))
    case.markup("Fiducial", "targets.mrk.json", "targets", points, looks.GOAL_LOOK.colour, tuple(places))
    if motion.narrowest is not None:
        name = f"{looks.NARROWEST.name}: {millimetres(motion.narrowest.place.clearance_m)} beyond the margin"
        case.markup("Line", "closest.mrk.json", name, motion.narrowest.gap_m, looks.NARROWEST.colour)
