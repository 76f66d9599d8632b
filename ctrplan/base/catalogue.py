"""Catalogues: effects, planners, obstacles, output formats and kinds of tasks by name, a file each.

A catalogue knows the packages whose files register with it, and imports them when it is first looked into. Files of
one's own come beside those of the package: a folder laid out like ctrplan/, named by CTRPLAN_EXTENSIONS. A new effect
of the drive is one new file, EXTENSIONS/effects/drive/my_effect.py; nothing of the package changes, nothing is
installed.
"""

from __future__ import annotations

import copy
import functools
import hashlib
import importlib
import inspect
import os
import pkgutil
import sys
from abc import ABCMeta
from collections.abc import Callable, Iterable, Iterator, MutableMapping
from dataclasses import is_dataclass
from pathlib import Path
from threading import RLock
from typing import Any, TypeVar

import numpy as np
from msgspec import StructMeta

from ctrplan.base.arrays import to_be_read
from ctrplan.base.package import __version__
from ctrplan.errors import InputError, of_the_user

VARIABLE = "CTRPLAN_EXTENSIONS"  # folders, separated as in PATH
PLACES = (
    *("effects/clock", "effects/drive", "effects/mechanics", "effects/sensor"),
    *("planning/search/planners", "anatomy/shapes", "files/trajectory_formats"),
)
T = TypeVar("T")


class AbstractStruct(StructMeta, ABCMeta):
    """The metaclass of a msgspec struct whose subclasses have to define what it declares with `abc.abstractmethod`."""


class Catalogue(MutableMapping[str, T]):
    """Entries by name, in the order of packages and files; a name belongs to the file that took it first.

    The files of `packages` are imported at the first look into the catalogue, and those of extension folders after
    them. Raises InputError then, with the file, for a file of an extension folder that can't be imported, registers
    nothing, or has the name of another file.
    """

    def __init__(self, thing: str, *packages: str) -> None:
        """thing: what the entries are, for messages; packages: full names of those whose files register entries."""
        self.thing = thing
        self.homes: dict[str, str] = {}  # name -> module that registered it
        self._packages = packages
        self._entries: dict[str, T] = {}
        self._pending, self._lock = bool(packages), RLock()

    def add(self, name: object, entry: T, home: str) -> None:
        """Adds an entry that module `home` defines. Raises InputError for a name that is none or taken."""
        if not isinstance(name, str) or not name:
            raise InputError(f"the name of a {self.thing} must be text", value=name)
        if name in self._entries and self.homes.get(name, home) != home:
            raise InputError(f"is the name of another {self.thing} already, in {self.homes[name]}", value=name)
        self._entries[name] = entry
        self.homes[name] = home

    def require(self, what: object, attributes: Iterable[str]) -> None:
        """Raises InputError that names the attributes which `what`, a class to be registered, lacks."""
        missing = sorted(name for name in attributes if not hasattr(what, name))
        missing += sorted(getattr(what, "__abstractmethods__", ()))
        if missing:
            raise InputError(f"{getattr(what, '__name__', what)} lacks {', '.join(missing)}")

    @property
    def names(self) -> str:
        """The names in alphabetical order, for messages."""
        return ", ".join(sorted(self))

    @property
    def registered(self) -> dict[str, T]:
        """The entries registered so far, without importing anything: for files that register themselves."""
        return self._entries

    def __getitem__(self, name: str) -> T:
        """The entry of a name; KeyError where there is none."""
        self._import()
        return self._entries[name]

    def __setitem__(self, name: str, entry: T) -> None:
        """Replaces or adds an entry that no file registers, as tests do."""
        self._import()
        self._entries[name] = entry

    def __delitem__(self, name: str) -> None:
        """Takes an entry out."""
        self._import()
        del self._entries[name]
        self.homes.pop(name, None)

    def __iter__(self) -> Iterator[str]:
        """Names in the order of packages and files."""
        self._import()
        return iter(self._entries)

    def __len__(self) -> int:
        """Number of entries."""
        self._import()
        return len(self._entries)

    def _import(self) -> None:
        if not self._pending:
            return
        with self._lock:
            if not self._pending:
                return
            self._pending = False  # files that look into the catalogue while they register see what is there
            try:
                order = [module for package in self._packages for module in _import_files(package, self)]
            except BaseException:
                self._pending = True
                raise
            place = {module: i for i, module in enumerate(order)}
            names = sorted(self._entries, key=lambda name: place.get(self.homes[name], len(order)))
            self._entries = {name: self._entries[name] for name in names}


def guarded(kind: type[Any], called: str) -> None:
    """Errors that methods of a class of one's own raise become sentences with its name, the method and the line.

    Arrays are handed to them read-only: whoever asked goes on with them. A class of the package stays as it is.
    """
    if (file := file_of_ones_own(kind)) is None:
        return
    for name, value in list(vars(kind).items()):
        if inspect.isfunction(value) and not name.startswith("__"):
            setattr(kind, name, guarded_function(value, f"{called}: {name}", file))


def guarded_function(function: Callable[..., Any], called: str, file: str) -> Callable[..., Any]:
    """A function whose errors are sentences; a generator's too, which is gone through at once."""
    is_generator = inspect.isgeneratorfunction(function)

    @functools.wraps(function)
    def call(*arguments: Any, **keywords: Any) -> Any:
        with of_the_user(called, file):
            result = function(*map(_handed, arguments), **keywords)
            return iter(list(result)) if is_generator else result

    return call


def _handed(given: Any) -> Any:
    """What a function of one's own is given: arrays, also as entries of tables and fields, that it can't write into."""
    if isinstance(given, np.ndarray):
        return to_be_read(given)
    if isinstance(given, dict):
        return {key: _handed(value) for key, value in given.items()}
    held = vars(given) if is_dataclass(given) and hasattr(given, "__dict__") else {}
    shown = {name: _handed(value) for name, value in held.items() if isinstance(value, (np.ndarray, dict))}
    if all(shown[name] is held[name] for name in shown):
        return given
    result = copy.copy(given)
    for name, value in shown.items():
        object.__setattr__(result, name, value)
    return result


def file_of_ones_own(thing: Any) -> str | None:
    """The file of a class or function that is none of the package's."""
    file: str | None = getattr(sys.modules.get(thing.__module__), "__file__", None)
    return file if file and not Path(file).is_relative_to(Path(__file__).parents[1]) else None


def extension_folders() -> list[Path]:
    """The folders that the environment names.

    Raises InputError for one that does not exist, and for a file in it that no package would ever look at.
    """
    folders = [Path(name) for name in os.environ.get(VARIABLE, "").split(os.pathsep) if name]
    for folder in folders:
        if not folder.is_dir():
            raise InputError("is not a folder that exists", key=VARIABLE, value=str(folder))
        for file in _misplaced(folder):
            raise InputError(f"is read by nothing: must lie in one of {', '.join(PLACES)}", file=str(file))
    return folders


@functools.lru_cache
def code_version() -> str:
    """What this process computes with: the package's version, and a hash of files of one's own where there are any."""
    own = [file for folder in extension_folders() for place in PLACES for file in sorted((folder / place).glob("*.py"))]
    content = b"".join(file.read_bytes() for file in own)
    return f"{__version__} with extensions {hashlib.sha256(content).hexdigest()[:8]}" if own else __version__


def _misplaced(folder: Path) -> list[Path]:
    """Python files beside the places for them: loose in the folder, or elsewhere in a package that has such a place."""
    packages = {place.partition("/")[0] for place in PLACES}
    files = [*folder.glob("*.py"), *(file for package in packages for file in (folder / package).rglob("*.py"))]
    return sorted(file for file in files if file.parent.relative_to(folder).as_posix() not in PLACES)


def _import_files(package_name: str, catalogue: Catalogue[Any]) -> list[str]:
    """Imports the files of a package, then those of extension folders: their modules' names in the order of files."""
    package = importlib.import_module(package_name)
    own = {module.name for module in pkgutil.iter_modules(package.__path__[:1])}
    added: dict[str, Path] = {}
    for folder in extension_folders():
        place = folder.joinpath(*package_name.split(".")[1:])
        for module in pkgutil.iter_modules([str(place)]):
            if module.name in own:
                raise InputError("has the name of a file of the package", file=str(place / f"{module.name}.py"))
            if added.setdefault(module.name, place) != place:
                file = str(place / f"{module.name}.py")
                raise InputError(f"has the name of a file in {added[module.name]}", file=file)
        if place.is_dir() and str(place) not in package.__path__:
            package.__path__.append(str(place))
    importlib.invalidate_caches()
    return [_imported(package_name, name, added.get(name), catalogue) for name in [*sorted(own), *sorted(added)]]


def _imported(package_name: str, name: str, place: Path | None, catalogue: Catalogue[Any]) -> str:
    full_name = f"{package_name}.{name}"
    if place is None:
        importlib.import_module(full_name)
        return full_name
    file = str(place / f"{name}.py")
    try:
        importlib.import_module(full_name)
    except Exception as error:  # whatever the file does when it is imported
        sentence = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise InputError(f"can't be imported: {sentence}", file=file) from error
    if full_name not in catalogue.homes.values():
        raise InputError(f"registers no {catalogue.thing}: @register is missing", file=file)
    return full_name
