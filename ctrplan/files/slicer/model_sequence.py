"""A surface that changes over time as a bundle (.seq.mrb): a zip file of models, and a scene with the time of each."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Sequence

from ctrplan.anatomy.patient_frame import Frame
from ctrplan.base.surface import Surface
from ctrplan.files.slicer.mrml import Node, model_nodes, scene_text
from ctrplan.files.slicer.ply_model import ply_model

MADE = (1980, 1, 1, 0, 0, 0)  # the same plan makes the same file


def model_sequence(name: str, times_s: Sequence[float], surfaces: Sequence[Surface], frame: Frame) -> bytes:
    """The content of a .seq.mrb file; surfaces in m, in the anatomy's frame. `name` is of letters, digits and _."""
    content = io.BytesIO()
    models = [model_nodes(k, f"{name}_{k}", f"Data/{name}_{k}.ply", "#808080")[::2] for k in _numbers(times_s)]
    index = sequence_node("SequenceIndex", name, times_s, {"singletonTag": "SequenceIndex"})
    files = {f"{name}.mrml": scene_text([index, *(node for pair in models for node in _bare(*pair))]).encode()}
    for k, surface in zip(_numbers(times_s), surfaces, strict=True):
        files[f"Data/{name}_{k}.ply"] = ply_model(surface, frame)
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as bundle:
        for path, data in files.items():
            bundle.writestr(zipfile.ZipInfo(f"{name}/{path}", MADE), data, zipfile.ZIP_DEFLATED)
    return content.getvalue()


def sequence_node(
    number: int | str, name: str, times_s: Sequence[float], attributes: dict[str, str], storage: Node | None = None
) -> Node:
    """The node that says the time of each model of a bundle."""
    values = ";".join(f"vtkMRMLModelNode{k}:{time:.4f}" for k, time in zip(_numbers(times_s), times_s, strict=True))
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


def _numbers(times_s: Sequence[float]) -> range:
    return range(1, len(times_s) + 1)


def _bare(model: Node, storage: Node) -> Iterator[Node]:
    """A model without looks, which are those of the model that shows it."""
    yield Node(model.kind, model.number, model.name, model.attributes, {"storage": [storage]})
    yield storage
