"""Validity of states and motions as OMPL asks for it; one `MotionChecker` answers, and remembers, for both."""

from __future__ import annotations

from typing import Any

from ompl import base as ob

from ctrplan.planning.motion import MotionChecker
from ctrplan.planning.search.ompl_space import StateReader
from ctrplan.planning.search.search_watch import SearchWatch


class Validity(ob.StateValidityChecker):  # type: ignore[misc]
    """Limits, nesting, stability, strain and clearance of a state."""

    def __init__(
        self, space_information: Any, checker: MotionChecker, read: StateReader, watch: SearchWatch | None = None
    ) -> None:
        """read: of the space that the space information is about; watch: ends the search when its time is over."""
        super().__init__(space_information)
        self.checker, self.read, self.watch = checker, read, watch or SearchWatch()

    def isValid(self, state: Any) -> bool:  # noqa: N802, OMPL's name
        """Whether the robot may stand there."""
        self.watch.ask()
        return self.checker.state(self.read(state)).valid


class MotionValidity(ob.MotionValidator):  # type: ignore[misc]
    """The whole motion in the direction driven; OMPL's own interpolation is never asked."""

    def __init__(
        self, space_information: Any, checker: MotionChecker, read: StateReader, watch: SearchWatch | None = None
    ) -> None:
        """read: of the space that the space information is about; watch: ends the search when its time is over."""
        super().__init__(space_information)
        self.checker, self.read, self.watch = checker, read, watch or SearchWatch()

    def checkMotion(self, a: Any, b: Any, *_: Any) -> bool:  # noqa: N802, OMPL's name
        """Whether the robot may go from a to b, rotations first; valid motions back may not be."""
        self.watch.ask()
        return self.checker.motion(self.read(a), self.read(b)).valid
