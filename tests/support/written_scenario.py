"""A scenario as somebody might write it, with every key, and the files that it names."""

from __future__ import annotations

import shutil
from pathlib import Path

from places import ROBOTS

SCENARIO = """
name = "past the ribs"
robot = "robots/three_tube.toml"
[base]
position_mm = [1, 2, 3]
quaternion_wxyz = [0.7071067811865476, 0, 0, 0.7071067811865476]
[start]
"rotate outer" = 0
"rotate middle" = 90
"rotate inner" = -720
"translate inner" = -86.4
[goal]
tip_mm = [12, 40, 190]
tolerance_mm = 0.5
direction = [0, 3, 4]
direction_tolerance_deg = 10
[[anatomy]]
kind = "sphere"
center_mm = [10, 20, 30]
radius_mm = 5
[[anatomy]]
kind = "capsule"
from_mm = [0, 0, -10]
to_mm = [0, 0, 200]
radius_mm = 60
role = "inside"
margin_mm = 1.5
[[anatomy]]
kind = "mesh"
file = "meshes/wedge.stl"
unit = "cm"
[margins]
stability = 0.2
max_strain = 0.05
[cost]
path = 2
mm_per_rad = 10
error_along = 3
error_goal = 4
max_error_goal_mm = 1.5
[planner]
name = "RRT*"
time_s = 2.5
settle = "oscillate"
goal_bias = 0.2
"""


def wedge() -> str:
    """A closed tetrahedron of 1 unit as ASCII STL."""
    corners = ("0 0 0", "1 0 0", "0 1 0", "0 0 1")
    facets = [[corners[i] for i in face] for face in ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))]
    loops = "".join(
        "facet normal 0 0 0\nouter loop\n" + "".join(f"vertex {c}\n" for c in f) + "endloop\nendfacet\n" for f in facets
    )
    return f"solid wedge\n{loops}endsolid wedge\n"


def place(folder: Path) -> None:
    """Everything that SCENARIO names."""
    for name in ("robots", "meshes"):
        (folder / name).mkdir(parents=True)
    shutil.copy(ROBOTS / "three_tube.toml", folder / "robots")
    (folder / "meshes" / "wedge.stl").write_text(wedge())
    (folder / "scenario.toml").write_text(SCENARIO)
