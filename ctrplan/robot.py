"""Robot: tubes, contacts and drive, read from a robot file (TOML)."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.drive import Array, Drive, Joint, read_only
from ctrplan.drive_file import HomeEntry, build_drive
from ctrplan.errors import InputError
from ctrplan.loads import Loads
from ctrplan.nesting import nesting_violation, never_nests
from ctrplan.robot_file import MeasurementEntry, RobotEntry, build_contacts, build_tubes
from ctrplan.toml_input import Document, read_document
from ctrplan.tube import Contact, Tube, TubeSection

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from ctrplan.batch import Progress
    from ctrplan.friction_law import FrictionLaw
    from ctrplan.history import History, HistoryOptions, Start
    from ctrplan.mechanics import Accuracy, Bound, Bounds, Mechanics, Shape

__all__ = [
    "Contact",
    "Drive",
    "Joint",
    "Measurement",
    "Robot",
    "Tube",
    "TubeSection",
    "load_robot",
    "nesting_violation",
    "robot_from_dict",
]

LARGEST_CLEARANCE_RATIO = 0.02  # of the smallest radius of curvature (Ha et al. 2019, section I)
SMALLEST_CLEARANCE_M = 5e-6  # the meshes do not resolve the contact forces of smaller ones (docs/model.md)
ROUNDING_M = 0.05e-3  # of diameters in drawings and tables


@dataclass(frozen=True)
class Measurement:
    """Standard deviations of each coordinate of the tip and of a small rotation of its tangent about each axis."""

    position_sigma_m: float
    tangent_sigma_rad: float


@dataclass(frozen=True, eq=False)
class Robot:
    """n concentric tubes, outermost first, their n - 1 contacts and the drive; SI units."""

    name: str
    tubes: tuple[Tube, ...]
    contacts: tuple[Contact, ...]
    drive: Drive
    model_error_m: float = 0.0
    measurement: Measurement | None = None
    loads: Loads = Loads()  # beyond the paper, set by [effects.*]
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # [effects.*] as in the file
    provenance: Mapping[str, Any] = field(default_factory=dict)  # as in the file
    content: Mapping[str, Any] = field(default_factory=dict)  # of the file after overrides
    path: str | None = None
    sha256: str = ""  # of the file's content after overrides
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raises InputError unless neighbouring tubes have a contact each."""
        if len(self.contacts) != max(len(self.tubes) - 1, 0):
            rule = f"must be {max(len(self.tubes) - 1, 0)}, one for each pair of neighbouring tubes"
            raise InputError(rule, key="contacts", value=len(self.contacts))

    @property
    def n(self) -> int:
        """Number of tubes."""
        return len(self.tubes)

    @cached_property
    def clearance_m(self) -> Array:
        """(n - 1,) radial clearance [m] of each pair: half the difference of diameters unless the contact gives one."""
        return read_only(np.array([self._clearance(i) for i in range(self.n - 1)], dtype=np.float64))

    @cached_property
    def friction(self) -> Array:
        """(n - 1, 2) lowest and highest friction coefficient of each pair."""
        return read_only(np.array([c.friction_coefficient for c in self.contacts], dtype=np.float64).reshape(-1, 2))

    @cached_property
    def mechanics(self) -> Mechanics:
        """The compiled model; where friction is an interval it uses the upper end, whose corners enclose the rest."""
        from ctrplan.mechanics import Mechanics

        return Mechanics(self.tubes, self.clearance_m, self.friction[:, 1], self.loads)

    @cached_property
    def friction_law(self) -> FrictionLaw:
        """How rotations load and translations release each pair, calibrated on simulated histories of this robot."""
        from ctrplan.friction_calibration import friction_law

        return friction_law(self)

    def zero_clearance(self, theta_b: ArrayLike, l_b: ArrayLike) -> Shape:
        """Zero-clearance, frictionless shape at base rotations (n,) [rad] and translations (n,) [m], (2)-(3)."""
        return self.mechanics.zero_clearance(theta_b, l_b)

    def solve(
        self, theta_b: ArrayLike, l_b: ArrayLike, phi: ArrayLike = 0.0, *, accuracy: Accuracy = "search"
    ) -> Shape:
        """Shape with clearance and friction; phi in [-1, 1], scalar or (n - 1,). See `Mechanics.solve`."""
        return self.mechanics.solve(theta_b, l_b, phi, accuracy=accuracy)

    def bound(self, theta_b: ArrayLike, l_b: ArrayLike, *, accuracy: Accuracy = "search") -> Bound:
        """Largest friction-induced deviations at (n,) [rad], (n,) [m]. See `Mechanics.bound`."""
        return self.mechanics.bound(theta_b, l_b, accuracy=accuracy)

    def bound_many(
        self,
        theta_b: ArrayLike,
        l_b: ArrayLike,
        *,
        accuracy: Accuracy = "search",
        threads: int = 0,
        progress: Progress | None = None,
        executor: Executor | None = None,
    ) -> Bounds:
        """Bounds of K configurations, (K, n) [rad], (K, n) [m], on every core or on an executor's workers.

        `progress` is told the finished share, 0 to 1. See `Mechanics.bound_many`.
        """
        return self.mechanics.bound_many(
            theta_b, l_b, accuracy=accuracy, threads=threads, progress=progress, executor=executor
        )

    def history(
        self, start: Start = "released", *, accuracy: Accuracy = "search", options: HistoryOptions | None = None
    ) -> History:
        """A simulation along a joint path, friction included: advance it waypoint by waypoint. See `History`."""
        from ctrplan.history import History

        return History(self.mechanics, start, accuracy=accuracy, options=options)

    def _clearance(self, i: int) -> float:
        given = self.contacts[i].clearance_m
        return _gap_m(self.tubes, i) if given is None else given


def load_robot(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Robot:
    """The robot of a TOML file after `overrides` such as "tube.2.poisson_ratio=0.28".

    Raises InputError, one sentence with file, key, value and rule, for anything malformed or contradictory.
    """
    return _build(read_document(path, overrides))


def robot_from_dict(content: Mapping[str, Any], *, file: str | None = None, overrides: Sequence[str] = ()) -> Robot:
    """The robot of a robot file's content, keys and units as in the file; `file` is what errors call it."""
    if not isinstance(content, Mapping):
        raise InputError("must be a mapping with the keys of a robot file", file=file, value=content)
    try:
        plain = _plain(content)
    except RecursionError:
        raise InputError("is nested too deeply", file=file) from None
    return _build(Document(plain, file).with_overrides(overrides))


def _plain(content: Any) -> Any:
    """The content with numbers of numpy as Python's, which a file would hold."""
    if isinstance(content, Mapping):
        return {key: _plain(value) for key, value in content.items()}
    if isinstance(content, (list, tuple, np.ndarray)):
        return [_plain(value) for value in content]
    return content.item() if isinstance(content, np.generic) else content


def _build(document: Document) -> Robot:
    entry = document.to(RobotEntry)
    if entry.name is not None and not entry.name.isprintable():
        raise document.fault("must be one line of printable text", "name")
    for effect, terms in entry.effects.items():
        if not isinstance(terms, dict):
            raise document.fault("must be a table", "effects", effect)
    tubes = build_tubes(entry, document)
    robot = Robot(
        name=entry.name or (Path(document.file).stem if document.file else "robot"),
        tubes=tubes,
        contacts=build_contacts(entry, document),
        drive=build_drive(entry.home or HomeEntry(), entry.joint, tubes, document),
        model_error_m=entry.model_error_mm * 1e-3,
        measurement=_measurement(entry.measurement),
        effects=entry.effects,
        provenance=entry.provenance,
        content=document.content,
        path=document.file,
        sha256=document.sha256,
    )
    if violation := never_nests(robot):
        raise document.fault(f"no joint values within limits nest the tubes, at home {violation}", "home", "l_mm")
    robot = replace(robot, warnings=tuple(_clearance_warnings(robot, document)))
    if not robot.effects:
        return robot
    from ctrplan.robot_effects import check_effects, with_effects

    check_effects(robot, document)
    return with_effects(robot)


def _measurement(entry: MeasurementEntry | None) -> Measurement | None:
    if entry is None:
        return None
    return Measurement(entry.position_sigma_mm * 1e-3, math.radians(entry.tangent_sigma_deg))


def _gap_m(tubes: Sequence[Tube], i: int) -> float:
    return (tubes[i].inner_diameter_m - tubes[i + 1].outer_diameter_m) / 2


def _clearance_warnings(robot: Robot, document: Document) -> Iterator[str]:
    for i, clearance in enumerate(robot.clearance_m.tolist()):
        shown, gap = f"radial clearance {clearance * 1e3:g} mm", _gap_m(robot.tubes, i)
        if abs(clearance - gap) > ROUNDING_M + 1e-9:
            yield str(document.fault(f"{shown} is used, but the diameters leave {gap * 1e3:g} mm", "contact", i))
        if clearance < SMALLEST_CLEARANCE_M:
            rule = f"{shown} is below {SMALLEST_CLEARANCE_M * 1e3:g} mm, bounds may be off by a quarter and more"
            yield str(document.fault(rule, "contact", i))
        curvature = max(section.curvature_per_m for tube in robot.tubes[i : i + 2] for section in tube.sections)
        if clearance * curvature > LARGEST_CLEARANCE_RATIO:
            radius = f"the smallest radius of curvature ({1e3 / curvature:g} mm)"
            rule = f"{shown} is above 2 % of {radius}, the model is less accurate there"
            yield str(document.fault(rule, "contact", i))
