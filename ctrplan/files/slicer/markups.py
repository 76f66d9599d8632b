"""Curves, lines and points as .mrk.json: Slicer's markups, by its schema of version 1.0.3."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from ctrplan.anatomy.patient_frame import Frame
from ctrplan.base.arrays import Array
from ctrplan.files.slicer.colour import rgb
from ctrplan.files.slicer.slicer_space import SPACE, lps_mm

SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)
MarkupType = Literal["Curve", "Line", "Fiducial"]
DIGITS = 6  # of a mm


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
    rows = zip(np.round(lps_mm(points_m, frame), DIGITS).tolist(), names, strict=True)
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
