"""Files of one's own beside those of the package: a folder laid out like ctrplan/, named by CTRPLAN_EXTENSIONS.

A package that collects files (effects of a stage, planners, obstacles, output formats) imports its own modules and
those in the folder of the same name below each extension folder. A new effect of the drive is one new file,
EXTENSIONS/effects/drive/my_effect.py; nothing of the package changes and nothing is installed.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
from pathlib import Path
from types import ModuleType
from typing import Any

from ctrplan.base.catalogue import Catalogue
from ctrplan.errors import InputError

VARIABLE = "CTRPLAN_EXTENSIONS"  # folders, separated as in PATH
PLACES = (
    *("effects/clock", "effects/drive", "effects/mechanics", "effects/sensor"),
    *("planning/search/planners", "anatomy/shapes", "files/trajectory_formats"),
)


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


def _misplaced(folder: Path) -> list[Path]:
    """Python files beside the places for them: loose in the folder, or elsewhere in a room that has such a place."""
    rooms = {place.partition("/")[0] for place in PLACES}
    files = [*folder.glob("*.py"), *(file for room in rooms for file in (folder / room).rglob("*.py"))]
    return sorted(file for file in files if file.parent.relative_to(folder).as_posix() not in PLACES)


def import_modules(package: ModuleType, catalogue: Catalogue[Any]) -> list[ModuleType]:
    """The modules of a package, its own and then those of extension folders, in the order of their names.

    Raises InputError, with the file, where a file of an extension folder can't be imported, registers nothing in
    `catalogue`, or has the name of another file.
    """
    own = {module.name for module in pkgutil.iter_modules(package.__path__[:1])}
    added: dict[str, Path] = {}
    for folder in extension_folders():
        place = folder.joinpath(*package.__name__.split(".")[1:])
        for module in pkgutil.iter_modules([str(place)]):
            if module.name in own:
                raise InputError("has the name of a file of the package", file=str(place / f"{module.name}.py"))
            if added.setdefault(module.name, place) != place:
                file = str(place / f"{module.name}.py")
                raise InputError(f"has the name of a file in {added[module.name]}", file=file)
        if place.is_dir() and str(place) not in package.__path__:
            package.__path__.append(str(place))
    importlib.invalidate_caches()
    return [_imported(package, name, added.get(name), catalogue) for name in [*sorted(own), *sorted(added)]]


def _imported(package: ModuleType, name: str, place: Path | None, catalogue: Catalogue[Any]) -> ModuleType:
    full_name = f"{package.__name__}.{name}"
    if place is None:
        return importlib.import_module(full_name)
    file = str(place / f"{name}.py")
    try:
        module = importlib.import_module(full_name)
    except Exception as error:  # whatever the file does when it is imported
        sentence = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise InputError(f"can't be imported: {sentence}", file=file) from error
    if full_name not in catalogue.homes.values():
        raise InputError(f"registers no {catalogue.thing}: @register is missing", file=file)
    return module
