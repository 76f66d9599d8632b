"""A picture of the place for which a mesh is refused: its open edges in red, seen from outside."""

from __future__ import annotations

import io
import os
import sys
import tempfile
from contextlib import suppress

import numpy as np
from PIL import Image

from ctrplan.anatomy.mesh_repair import MeshDefect
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.surface import Surface, capsule
from ctrplan.reports.render.camera import look_at
from ctrplan.reports.render.film import SKY, rgb, write_caption
from ctrplan.reports.render.rasteriser import Body, Camera, Picture, Stage, vertex_normals

WIDTH, HEIGHT, SAMPLES = 900, 700, 2
TISSUE, EDGE = rgb("#C9B3A6"), "#D62222"
HALF_VIEW = float(np.tan(np.radians(18)))
UP = np.array([0.0, 0.0, 1.0])
MOST_EDGES = 1500  # that are drawn, the nearest ones
LEAST_SHARE, ROOM = 0.12, 2.0  # of the mesh that is seen at least, and how much more than the edges near the place


def tell_picture(defect: MeshDefect) -> None:
    """Draws the place into a file that whoever reads the refusal can open, and says where that is."""
    with suppress(OSError):  # the sentence has been said, a picture that can't be written is no failure
        png = mesh_defect_png(defect)
        number, name = tempfile.mkstemp(prefix=f"ctrplan_{defect.file.stem[:40]}_", suffix=".png")
        with os.fdopen(number, "wb") as file:
            file.write(png)
        print(f"ctrplan: a picture of the place: {name}", file=sys.stderr)


def mesh_defect_png(defect: MeshDefect) -> bytes:
    """The picture, as PNG."""
    surface, edges = defect.surface, defect.surface.vertices_m[defect.edges]
    order = np.argsort(np.linalg.norm(edges.mean(axis=1) - defect.place_m, axis=1))[:MOST_EDGES]
    across = _seen_m(defect, edges[order])
    thick = 0.006 * across
    marks = [Body(_joined([capsule(a, b, thick, 6) for a, b in edges[order]]), rgb(EDGE))] if len(order) else []
    place = Body(capsule(defect.place_m, defect.place_m, 2.5 * thick, 24), rgb(EDGE), 0.5, 1.0)
    camera = _camera(defect, across)
    stage = Stage([Body(surface, TISSUE), *marks, place], camera, WIDTH, HEIGHT, SAMPLES, SKY)
    return _labelled(stage.with_moving([]), defect)


def _joined(surfaces: list[Surface]) -> Surface:
    """One of many, which is drawn much faster."""
    before = np.cumsum([0, *(len(surface.vertices_m) for surface in surfaces)])
    faces = [surface.faces + count for surface, count in zip(surfaces, before, strict=False)]
    return Surface(np.concatenate([surface.vertices_m for surface in surfaces]), np.concatenate(faces))


def _seen_m(defect: MeshDefect, edges: Array) -> float:
    """Half of what the picture shows of the mesh's size."""
    extent = float(np.linalg.norm(np.ptp(defect.surface.vertices_m, axis=0)))
    near = edges.reshape(-1, 3)[:400]
    reach = float(np.linalg.norm(near - defect.place_m, axis=1).max(initial=0.0))
    return min(max(ROOM * reach, LEAST_SHARE * extent), extent)


def _camera(defect: MeshDefect, across_m: float) -> Camera:
    """Along the mean normal of what is near the place; where there is none, from the mesh's middle outward."""
    vertices = defect.surface.vertices_m
    near = np.argsort(np.linalg.norm(vertices - defect.place_m, axis=1))[:200]
    outward = defect.place_m - vertices.mean(axis=0)
    normal = vertex_normals(defect.surface)[near].mean(axis=0)
    normal = normal if normal @ outward >= 0 else -normal  # winding says nothing in a mesh that is not closed
    toward = normal if np.linalg.norm(normal) > 0.2 else outward
    toward = toward / np.linalg.norm(toward) if np.any(toward) else UP
    apart = across_m / HALF_VIEW
    return look_at(defect.place_m + apart * toward, defect.place_m, UP, HALF_VIEW, near_m=0.05 * apart)


def _labelled(picture: Picture, defect: MeshDefect) -> bytes:
    image = Image.fromarray(picture)
    place = ", ".join(f"{x:.1f}" for x in defect.place_m * MM_PER_M)
    count = len(defect.edges)
    text = f"{defect.file.name}: ({place}) mm in the file's frame, {count} open edges"
    stream = io.BytesIO()
    write_caption(image, text)
    image.save(stream, "PNG")
    return stream.getvalue()
