"""The pair of Table I at the settings of Section IV, its contact regions, and what figures of the paper share."""

import itertools
import json
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import common
import numpy as np
from common import ROBOTS, ROOT
from common import save as save_picture
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from ctrplan import Robot, Shape, load_robot
from ctrplan.base.arrays import Array
from ctrplan.mechanics.shapes import TubeShape
from ctrplan.reports import looks

EXACT = json.loads((ROOT / "tests" / "reference" / "pair_values.json").read_text(encoding="utf-8"))["table_I_pair"]

CLEARANCES_MM = (0.01, 0.05, 0.25, 1.0, 3.0)  # the paper names the range and that there are five
FRICTIONS = (0.0, 0.1, 0.2, 0.3, 0.5)  # likewise
OUTER_LENGTH_M, TRANSMISSION_MM = 0.15, 17.0
SMALL_MM = 1e-3  # a transmission that is none


@cache
def pair(clearance_mm: float, mu: float = 0.0, transmission_mm: float = TRANSMISSION_MM) -> Robot:
    """Table I."""
    return load_robot(
        ROBOTS / "table_1_pair.toml",
        [
            f"tube.1.inner_diameter_mm={1 + 2 * clearance_mm}",
            f"tube.1.outer_diameter_mm={1.2 + 2 * clearance_mm}",
            f"contact.1.friction_coefficient={mu}",
            f"tube.2.section.1.length_mm={transmission_mm}",
            "tube.2.collar_length_mm=0",
            f"home.l_mm=[0, {-transmission_mm}]",
        ],
    )


def joints(angle_deg: float, transmission_mm: float = TRANSMISSION_MM) -> tuple[Array, Array]:
    return np.deg2rad([0.0, angle_deg]), 1e-3 * np.array([0.0, -transmission_mm])


def turned(clearance_mm: float, angle_deg: float) -> Shape:
    return pair(clearance_mm).solve(*joints(angle_deg), accuracy="certificate")


def opposed(clearance_mm: float, mu: float = 0.0, transmission_mm: float = TRANSMISSION_MM, phi: float = 1.0) -> Shape:
    robot = pair(clearance_mm, mu, transmission_mm)
    return robot.solve(*joints(180, transmission_mm), phi, accuracy="certificate")


def table_3_joints() -> list[tuple[tuple[float, float, float], tuple[Array, Array]]]:
    """A grid of 4 x 4 x 4, which the paper gives in part: tubes 2 to 1, 3 to 2 [deg], l_3b [mm], and the collars."""
    rows = itertools.product((0, 90, 180, 270), (0, 90, 180, 270), np.linspace(-120.4, -34, 4))
    return [((a, b, l_3), (np.deg2rad([0, a, a + b]), 1e-3 * np.array([0, -17, l_3]))) for a, b, l_3 in rows]


def angle_deg(u: Array, v: Array) -> float:
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v)))


def exact(section: str, **keys: float) -> list[dict[str, Any]]:
    return [row for row in EXACT[section] if all(np.isclose(row[key], value) for key, value in keys.items())]


CONTACT = 0.01  # share of the largest force at which a contact point counts


class Region(NamedTuple):
    """Neighbouring contact points that push the same way."""

    s_m: float
    begin_m: float
    end_m: float
    force_N: float  # normal
    angle_rad: float


def regions(shape: Shape) -> list[Region]:
    """The contact regions of a pair, base to tip."""
    (s,), (force,), (angle,) = shape.contact_s_m, shape.contact_force_N, shape.contact_angle_rad
    loaded = np.flatnonzero(force > CONTACT * force.max())
    new = (np.diff(s[loaded]) > 4e-3) | (np.cos(np.diff(angle[loaded])) < 0)
    cores = np.split(loaded, np.flatnonzero(new) + 1)
    nearest = np.argmin([np.abs(s - s[core] @ force[core] / force[core].sum()) for core in cores], axis=0)
    return [_region(core, nearest == k, s, force, angle) for k, core in enumerate(cores)]


def _region(core: NDArray[np.intp], nearest: NDArray[np.bool_], s: Array, force: Array, angle: Array) -> Region:
    """What the core of a region pushes together with the faint forces around it; from 5 to 95 % of the force."""
    middle = float(np.angle(force[core] @ np.exp(1j * angle[core])))
    own = np.where(nearest & (np.cos(angle - middle) > 0), force, 0)
    begin, end = (float(s[np.searchsorted(np.cumsum(own), share * own.sum())]) for share in (0.05, 0.95))
    return Region(float(own @ s / own.sum()), begin, end, float(own.sum()), middle)


def couple(shape: Shape) -> tuple[float, float, float]:
    """At 180 deg: force on the tip of tube 1 [N], arm [m] of the opposite forces before it, and their couple [N m]."""
    (s,), (force,), (angle,) = shape.contact_s_m, shape.contact_force_N, shape.contact_angle_rad
    against = np.where((np.cos(angle - angle[-1]) < 0) & (s > OUTER_LENGTH_M / 3), force, 0)
    moment = float(against @ (OUTER_LENGTH_M - s))
    return float(force[-1]), moment / float(against.sum()), moment


def offset_m(shape: Shape) -> tuple[Array, Array]:
    """Arc length (N,) and offset (N,) [m, complex] of the inner tube in the outer one, the unknown d of docs/model.md.

    Integrated twice from the difference of curvatures: the two centrelines, each integrated in space by itself, differ
    from it in second order.
    """
    outer, inner = shape.tubes
    plate = int(np.searchsorted(inner.s_m, 0.0))
    s = inner.s_m[: plate + len(outer.s_m)]
    bend = curvature_vector(inner)[: len(s)]
    bend[plate + 1 :] -= curvature_vector(outer)[1:]
    near, far = bend[:-1].copy(), bend[1:]
    near[plate] = far[plate]  # the curved section begins at the plate: the value there is of the straight one
    h = np.diff(s)
    slope = np.concatenate([[0], np.cumsum(h * (near + far) / 2)])
    return s, np.concatenate([[0], np.cumsum(h * slope[:-1] + h**2 * (2 * near + far) / 6)])


def curvature_vector(tube: TubeShape) -> Array:
    """(N,) complex, twist-free frame."""
    u = tube.curvature_per_m
    vector: Array = np.exp(1j * tube.theta_rad) * (u[:, 1] - 1j * u[:, 0])
    return vector


COLOURS = (*looks.SERIES, looks.ENVELOPE)


def figure(panels: int, height_in: float = 3.7) -> tuple[Figure, list[Axes]]:
    fig, axes = common.panels(1, panels, (9.6 if panels > 1 else 6.4, height_in))
    return fig, list(axes[0])


def label(ax: Axes, title: str, x: str, y: str) -> None:
    ax.set_title(title, loc="left", fontsize=10.5, color=looks.INK)
    ax.set_xlabel(x, fontsize=9.5, color=looks.INK)
    ax.set_ylabel(y, fontsize=9.5, color=looks.INK)


def legend(ax: Axes, title: str, checked: bool = False, **options: Any) -> None:
    """`checked`: there are values of the exact-geometry solver too."""
    handles, _ = ax.get_legend_handles_labels()
    if checked:
        handles.append(Line2D([], [], linestyle="", label="exact geometry", **hollow(looks.INK)))
    ax.legend(handles=handles, title=title, frameon=False, fontsize=8.5, title_fontsize=8.5, labelspacing=0.3,
              alignment="left", **options)  # fmt: skip


def hollow(colour: str) -> dict[str, Any]:
    return {"marker": "o", "ms": 4.5, "markerfacecolor": "white", "markeredgecolor": colour, "markeredgewidth": 1.1}


def points(ax: Axes, x: Sequence[float], y: Sequence[float], colour: str) -> None:
    ax.plot(x, y, linestyle="", zorder=3, **hollow(colour))


def save(fig: Figure, name: str) -> None:
    save_picture(fig, f"validation/{name}", 128)
