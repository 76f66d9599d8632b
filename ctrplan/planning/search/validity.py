"""Validity of states and motions as OMPL asks for it; one `MotionChecker` answers, and remembers, for both."""

from __future__ import annotations

from typing import Any

from ompl import base as ob

from ctrplan.planning.motion import MotionChecker
from ctrplan.planning.search.ompl_space import StateReader


class Validity(ob.StateValidityChecker):  # type: ignore[misc]
    """Limits, nesting, stability, strain and clearance of a state."""

    def __init__(self, space_information: Any, checker: MotionChecker, read: StateReader) -> None:
        """read: of the space that the space information is about."""
        super().__init__(space_information)
        self.checker, self.read = checker, read

    def isValid(self, state: Any) -> bool:  # noqa: N802, OMPL's name
        """Whether the robot may stand there."""
        self.checker.watch.ask()
        return self.checker.state(self.read(state)).valid


class MotionValidity(ob.MotionValidator):  # type: ignore[misc]
    """The whole motion in the direction driven; OMPL's own interpolation is never asked."""

    def __init__(self, space_information: Any, checker: MotionChecker, read: StateReader) -> None:
        """read: of the space that the space information is about."""
        super().__init__(space_information)
        self.checker, self.read = checker, read

    def checkMotion(self, a: Any, b: Any, *_: Any) -> bool:  # noqa: N802, OMPL's name
        """Whether the robot may go from a to b, rotations first; valid motions back may not be."""
        self.checker.watch.ask()
        return self.checker.motion(self.read(a), self.read(b)).valid
