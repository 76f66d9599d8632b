"""A plan's motion -> contents of the files of a case folder, by name; the scene that loads them comes last."""

from __future__ import annotations

import numpy as np

from ctrplan.anatomy.patient_frame import Frame
from ctrplan.base.arrays import Array
from ctrplan.base.surface import Surface
from ctrplan.files.slicer_markups import SCENE
from ctrplan.files.slicer_scene import (
    MarkupType,
    Node,
    browser_node,
    itk_transform_text,
    markup_nodes,
    markups_text,
    model_nodes,
    model_sequence,
    ply_model,
    scene_text,
    sequence_node,
    storage_node,
)
from ctrplan.reports import looks as looks
from ctrplan.reports.plan_scene import WrittenMotion
from ctrplan.reports.robot_surface import stand, swept_surface
from ctrplan.reports.words import millimetres

PERCENTS = tuple(range(0, 101, 10))  # of the motion's time, at which centrelines are written
MOST_POINTS = 300  # of a curve: Slicer draws each of them
SIDES, ENVELOPE_SIDES = 16, 14
OPACITY = {"avoid": 0.6, "inside": 0.3}


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
        name = f"anatomy {k}: {part.shape.name}, {looks.ANATOMY_LOOK[part.role].name}"
        case.model(
            f"anatomy_{k}.ply", name, part.shape.surface(), looks.ANATOMY_LOOK[part.role].colour, OPACITY[part.role]
        )
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
    for percent in sorted(set(PERCENTS)):
        pose = motion.path[round(percent / 100 * (len(motion.path) - 1))]
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
