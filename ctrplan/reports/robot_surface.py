"""The robot at one place and the space that it sweeps, as triangle surfaces in the anatomy's frame.

A tube is shown from the front plate to its tip; its part behind the plate is the drive's business.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import igl
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from ctrplan.anatomy.surface_file import collapsed
from ctrplan.base.arrays import Array
from ctrplan.base.surface import Rod, Surface, rod_faces, rod_vertices
from ctrplan.errors import SolverError

if TYPE_CHECKING:
    from ctrplan.anatomy.parts import AnatomyPart
    from ctrplan.mechanics.shapes import Bound, TubeShape
    from ctrplan.scenario.scenario import Scenario


def anatomy_surface(part: AnatomyPart, triangles: int = 12_000) -> Surface:
    """The surface of a part in no more than `triangles`; coarser ones as they are."""
    return thinned(part.shape.surface(), triangles)


def thinned(surface: Surface, triangles: int) -> Surface:
    """The surface in no more than `triangles`: to look at, not to measure.

    Edges collapse where the package for that is there, which keeps thin vessels whole; then vertices merge in cells of
    a grid.
    """
    if len(surface.faces) > triangles and (fewer := collapsed(surface.vertices_m, surface.faces, triangles)):
        surface = Surface(*fewer)
    cell = float(np.sqrt(2 * _area(surface) / triangles))
    while len(surface.faces) > triangles:
        surface = _merged(surface, cell)
        cell *= 1.2
    return surface


def _area(surface: Surface) -> float:
    a, b, c = np.moveaxis(surface.vertices_m[surface.faces], 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _merged(surface: Surface, cell_m: float) -> Surface:
    """Every vertex at the mean of its cell, triangles that collapse left out."""
    cells = np.floor(surface.vertices_m / cell_m).astype(np.int64)
    _, label, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    label = label.reshape(-1)  # numpy 2.0 returns it as a column
    mean = np.stack([np.bincount(label, column) / count for column in surface.vertices_m.T], axis=1)
    faces = label[surface.faces]
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return Surface(mean, faces[distinct])


STATIONS = 40
STEP_M = 1e-5  # over which the outline drops from one tube's radius to the next one's
PLATE_THICKNESS_M = 0.8e-3


@dataclass(frozen=True, eq=False)
class RobotPose:
    """The robot at one place of its path, anatomy's frame; S stations per line, the same for every pose."""

    time_s: float
    tubes: tuple[Rod, ...]  # frictionless, outermost first
    envelope: Rod  # the outline with everything friction, as bounded, and the model error may add
    corners_m: Array  # (2**(n - 1), S, 3) innermost centreline of the corner shapes
    bound_m: float
    ends_R: Array  # (n, 3, 3) frames of the tubes where they end, third column along the tube

    @property
    def tip_m(self) -> Array:
        """(3,) tip without friction."""
        tip: Array = self.tubes[-1].centreline_m[-1]
        return tip


def pose(scenario: Scenario, joints: ArrayLike, time_s: float = 0.0) -> RobotPose:
    """The robot at commanded joints (m,) [rad, m]; solves one bound. Raises SolverError where there is no solution."""
    bound = scenario.robot.mechanics.bound(*scenario.robot.drive.collars(joints))
    if not np.isfinite(bound.position_m):
        raise SolverError("The model has no solution at these joints.")
    return _posed(scenario, bound, time_s)


def _posed(scenario: Scenario, bound: Bound, time_s: float) -> RobotPose:
    robot, tubes = scenario.robot, bound.frictionless.tubes
    radii = [tube.outer_diameter_m / 2 for tube in robot.tubes]
    rods = [_rod(tube, _stations(tube), radius) for tube, radius in zip(tubes, radii, strict=True)]
    return RobotPose(
        time_s,
        tuple(_in_anatomy(scenario, rod) for rod in rods),
        _in_anatomy(scenario, _envelope(bound, radii, robot.model_error_m)),
        np.array([scenario.located(_line(c.tubes[-1], _stations(c.tubes[-1]))[0]) for c in bound.corners]),
        bound.position_m,
        scenario.base_R @ np.array([tube.frames[-1] for tube in tubes]),
    )


def plate(scenario: Scenario) -> Rod:
    """The front plate, a disc that ends where the robot begins."""
    z = np.array([[0, 0, -PLATE_THICKNESS_M], [0, 0, 0]])
    radius = 4 * max(tube.outer_diameter_m for tube in scenario.robot.tubes) / 2
    return _in_anatomy(scenario, Rod(z, np.tile([0.0, 0.0, 1.0], (2, 1)), np.full(2, radius)))


def stand(scenario: Scenario) -> Surface:
    """The front plate and the fixtures at it."""
    surfaces = [plate(scenario).surface(32), *(fixture.shape.surface() for fixture in scenario.fixtures)]
    vertices = [surfaces[0].vertices_m, *(scenario.located(surface.vertices_m) for surface in surfaces[1:])]
    before = np.cumsum([0, *map(len, vertices[:-1])])
    faces = [surface.faces + count for surface, count in zip(surfaces, before, strict=True)]
    return Surface(np.concatenate(vertices), np.concatenate(faces))


def _in_anatomy(scenario: Scenario, rod: Rod) -> Rod:
    return Rod(scenario.located(rod.centreline_m), rod.tangent @ scenario.base_R.T, rod.radius_m)


def _stations(tube: TubeShape) -> Array:
    """Arc lengths (S,) from the plate to the tip; all at the tip of a tube that is behind the plate."""
    return np.linspace(min(0.0, tube.s_m[-1]), tube.s_m[-1], STATIONS)


def _rod(tube: TubeShape, s_m: Array, radius_m: float) -> Rod:
    return Rod(*_line(tube, s_m), np.full(len(s_m), radius_m if tube.s_m[-1] > 0 else 0.0))


def _line(tube: TubeShape, s_m: Array) -> tuple[Array, Array]:
    """Points and unit tangents (S, 3), (S, 3) of a tube at s_m: of the cubic through two nodes with their tangents."""
    points, tangents, before = tube.centreline_m, tube.frames[:, :, 2], np.searchsorted(tube.s_m, s_m, side="right") - 1
    k = np.clip(before, 0, len(points) - 2)
    h = (tube.s_m[k + 1] - tube.s_m[k])[:, None]
    t = (s_m[:, None] - tube.s_m[k][:, None]) / h
    way, m, n = points[k + 1] - points[k], h * tangents[k], h * tangents[k + 1]
    bend, turn = 3 * way - 2 * m - n, m + n - 2 * way
    tangent = m + t * (2 * bend + 3 * t * turn)
    line: Array = points[k] + t * (m + t * (bend + t * turn))
    return line, tangent / np.linalg.norm(tangent, axis=1, keepdims=True)


def _envelope(bound: Bound, radii_m: list[float], model_error_m: float) -> Rod:
    """The outline of all tubes, thicker by the deviation of its station; a ring at each side of a tube's end."""
    shape = bound.frictionless
    end = max(float(shape.s_m[-1]), 0.0)
    tube_ends = np.array([tube.s_m[-1] for tube in shape.tubes])
    steps = np.concatenate([tube_ends[:-1], tube_ends[:-1] + STEP_M]).clip(0.0, end)
    s_m = np.sort(np.concatenate([np.linspace(0.0, end, STATIONS), steps]))
    reaches: NDArray[np.bool_] = s_m[:, None] <= tube_ends + STEP_M / 2
    outline = np.where(reaches, radii_m, 0.0).max(axis=1)
    deviation = np.interp(s_m, shape.s_m, bound.envelope_m)
    return Rod(*_line(shape.tubes[-1], np.minimum(s_m, shape.s_m[-1])), outline + deviation + model_error_m)


WIDTH, STANDS_OUT = 0.018, 1.35  # share of the robot's length, and of the outermost radius


def tube_surface(pose: RobotPose, tube: int, sides: int) -> Surface:
    """The tube with the ring at its end, which has no size where the tube can be seen; 0 the outermost."""
    rod = rod_faces(len(pose.tubes[tube].radius_m), sides)
    ring = rod_faces(2, sides) + len(pose.tubes[tube].radius_m) * sides + 2
    return Surface(tube_vertices([pose], sides)[0, tube], np.concatenate([rod, ring]))


def tube_vertices(poses: Sequence[RobotPose], sides: int) -> Array:
    """(P, n, V, 3) [m] vertices of every tube's surface, its ring included, at each pose."""
    tubes = rod_vertices([rod for pose in poses for rod in pose.tubes], sides)
    rings = rod_vertices([ring for pose in poses for ring in end_rings(pose)], sides)
    both = np.concatenate([tubes, rings], axis=1)
    return both.reshape(len(poses), -1, *both.shape[1:])


def end_rings(pose: RobotPose) -> list[Rod]:
    """A ring a tube, outermost first; those of tubes that end at the same place stand behind each other."""
    places = [_arc_lengths(rod.centreline_m) for rod in pose.tubes]
    lengths = [float(s_m[-1]) for s_m in places]
    width, thickest = WIDTH * max(lengths), max(float(rod.radius_m.max()) for rod in pose.tubes)
    results = []
    for tube, (rod, s_m) in enumerate(zip(pose.tubes, places, strict=True)):
        hidden = tube > 0 and lengths[tube] < max(lengths[:tube]) + width and rod.radius_m[0] > 0
        last = lengths[tube] - width * sum(abs(length - lengths[tube]) < width for length in lengths[:tube])
        ends = np.maximum([last - width, last], 0.0)
        line = np.stack([np.interp(ends, s_m, column) for column in rod.centreline_m.T], axis=1)
        radius = STANDS_OUT * thickest if hidden else 0.0
        results.append(Rod(line, np.repeat(rod.tangent[-1:], 2, axis=0), np.full(2, radius)))
    return results


def _arc_lengths(line_m: Array) -> Array:
    """(S,) along the line, 0 at its beginning."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line_m, axis=0), axis=1))])


NODES = 400_000
FINEST_M = 1.0e-3
THINNEST_CELLS = 0.9  # a thinner rod could slip between the nodes of the grid
STRIDES, FAR_CELLS = (4, 2, 1), 8
SPACING_CELLS = 0.5  # of the spheres that stand for a rod, or thin ones would be beads on a string
ALIKE_CELLS = SPACING_CELLS / 4  # spheres of neighbouring poses nearer to each other stand for each other


def swept_surface(poses: Sequence[RobotPose], nodes: int = NODES) -> Surface:
    """The union of all poses' envelopes, each a row of spheres along its centreline, from a grid of so many nodes.

    Which sphere a point is deepest in, or nearest to, is asked by its power |x - c|^2 - r^2: that is the nearest
    neighbour among the points (c, sqrt(R^2 - r^2)) in four dimensions, R being the largest radius.
    """
    rods = [pose.envelope for pose in poses]
    largest = max(float(rod.radius_m.max()) for rod in rods)
    centres = np.concatenate([rod.centreline_m for rod in rods])
    lower, upper = centres.min(axis=0) - largest - FINEST_M, centres.max(axis=0) + largest + FINEST_M
    cell = max(FINEST_M, float(np.cbrt((upper - lower).prod() / nodes)))
    places, counts = _grid(lower - cell, upper + cell, cell)
    centres, radii = _spheres(rods, cell)
    values = _depths(places, counts, centres, radii, cell)
    vertices, faces, *_ = igl.marching_cubes(values, places, *counts, 0.0)
    return Surface(
        np.asarray(vertices, dtype=np.float64).reshape(-1, 3), np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    )


def _depths(nodes: Array, counts: tuple[int, int, int], centres: Array, radii: Array, cell: float) -> Array:
    """(K,) distance [m] from the union of spheres, negative within; of nodes far from its surface the sign alone.

    Every fourth node along each axis is asked first, then every second, then all. Where one is farther from the surface
    than from a node of the next, that node is on the same side and not asked. Outside, the fourth dimension tells a
    distance that no sphere, however large, comes below.
    """
    largest, far = float(radii.max()), FAR_CELLS * cell
    tree = cKDTree(np.column_stack([centres, np.sqrt(largest**2 - radii**2)]))

    def depths(places: Array) -> tuple[Array, Array]:
        lifted, which = tree.query(np.pad(places, ((0, 0), (0, 1))), distance_upper_bound=largest + far)
        result, near = np.full(len(places), far), which < len(centres)
        result[near] = np.linalg.norm(places[near] - centres[which[near]], axis=1) - radii[which[near]]
        return result, np.where(result > 0, np.minimum(lifted - largest, far), result)

    grid, values = nodes.reshape(*counts[::-1], 3), np.zeros((1, 1, 1))
    for stride in STRIDES:
        places = grid[::stride, ::stride, ::stride]
        beside = [np.minimum((np.arange(n) + 1) // 2, m - 1) for n, m in zip(places.shape, values.shape, strict=False)]
        values = values[np.ix_(*beside)]
        close = np.abs(values) < (np.sqrt(3) * (2 * stride - 1) + 1) * cell
        values[close] = depths(places[close])[int(stride > 1)]
    return values.reshape(-1)


def _spheres(rods: Sequence[Rod], cell: float) -> tuple[Array, Array]:
    """Centres (K, 3) and radii (K,) along the rods, none thinner than the grid can hold."""
    results = []
    for rod in rods:
        s_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rod.centreline_m, axis=0), axis=1))])
        at = np.linspace(0.0, s_m[-1], int(s_m[-1] / (SPACING_CELLS * cell)) + 2)
        results.append(np.column_stack([np.interp(at, s_m, row) for row in (*rod.centreline_m.T, rod.radius_m)]))
    rows = np.concatenate(results)
    alike = np.round(rows / (ALIKE_CELLS * cell)).astype(np.int64)
    alike -= alike.min(axis=0)
    _, first = np.unique(np.ravel_multi_index(tuple(alike.T), tuple(alike.max(axis=0) + 1)), return_index=True)
    return rows[first, :3], np.maximum(rows[first, 3], THINNEST_CELLS * cell)


def _grid(lower: Array, upper: Array, cell: float) -> tuple[Array, tuple[int, int, int]]:
    """Nodes (K, 3), x running fastest, and their numbers along each axis."""
    axes = [np.arange(a, b + cell, cell) for a, b in zip(lower, upper, strict=True)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), (len(axes[0]), len(axes[1]), len(axes[2]))
