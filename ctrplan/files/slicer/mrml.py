"""Scenes (.mrml): XML with an element per node of Slicer's scene, which refer to each other by their ids."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from xml.sax.saxutils import quoteattr

from ctrplan.files.slicer.colour import rgb
from ctrplan.files.slicer.slicer_space import SPACE


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


def model_nodes(
    number: int, name: str, file: str, colour: str, *, opacity: float = 1.0, visible: bool = True
) -> tuple[Node, Node, Node]:
    """A model with its file and its looks; the first one is the model."""
    look = {"color": _numbers(colour), "opacity": f"{opacity:g}", "visibility": _flag(visible)}
    storage = storage_node("ModelStorage", number, file)
    display = Node("ModelDisplay", number, f"{name} display", look)
    return Node("Model", number, name, {}, {"display": [display], "storage": [storage]}), display, storage


def markup_nodes(kind: str, number: int, name: str, file: str, visible: bool = True) -> tuple[Node, Node, Node]:
    """A markup ("Curve", "Line", "Fiducial") with its file; colours come with the file. The first one is the markup."""
    display_kind = "MarkupsFiducialDisplay" if kind == "Fiducial" else "MarkupsDisplay"
    storage = storage_node("MarkupsJsonStorage", number, file)
    display = Node(display_kind, number, f"{name} display", {"visibility": _flag(visible)})
    references = {"display": [display], "storage": [storage]}
    return Node(f"Markups{kind}", number, name, {}, references), display, storage


def storage_node(kind: str, number: int, file: str) -> Node:
    """Where a node's data are, in a file of the scene's folder."""
    return Node(kind, number, file, {"fileName": file, "coordinateSystem": SPACE})


def _element(node: Node) -> str:
    references = "".join(f"{role}:{' '.join(to.id for to in nodes)};" for role, nodes in node.references.items())
    own = {"id": node.id, "name": node.name, **node.attributes} | ({"references": references} if references else {})
    return f" <{node.kind} {' '.join(f'{key}={quoteattr(value)}' for key, value in own.items())}></{node.kind}>\n"


def _flag(value: bool) -> str:
    return "true" if value else "false"


def _numbers(colour: str) -> str:
    return " ".join(f"{value:g}" for value in rgb(colour))
