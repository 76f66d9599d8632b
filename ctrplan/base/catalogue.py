"""What files have registered, by name: the effects, planners, obstacles and output formats there are."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

from ctrplan.errors import InputError

T = TypeVar("T")


class Catalogue(dict[str, T]):
    """Entries by name; a name belongs to the file that took it first."""

    def __init__(self, thing: str) -> None:
        """thing: what the entries are, for messages."""
        super().__init__()
        self.thing = thing
        self.homes: dict[str, str] = {}  # name -> module that registered it

    def add(self, name: object, entry: T, home: str) -> None:
        """Adds an entry that module `home` defines. Raises InputError for a name that is none or taken."""
        if not isinstance(name, str) or not name:
            raise InputError(f"the name of a {self.thing} must be text", value=name)
        if name in self and self.homes.get(name, home) != home:
            raise InputError(f"is the name of another {self.thing} already, in {self.homes[name]}", value=name)
        self[name] = entry
        self.homes[name] = home

    def require(self, what: object, attributes: Iterable[str]) -> None:
        """Raises InputError that names the attributes which `what`, a class to be registered, lacks."""
        missing = sorted(name for name in attributes if not hasattr(what, name))
        missing += sorted(getattr(what, "__abstractmethods__", ()))
        if missing:
            raise InputError(f"{getattr(what, '__name__', what)} lacks {', '.join(missing)}")

    @property
    def names(self) -> str:
        """The names in order, for messages."""
        return ", ".join(sorted(self))
