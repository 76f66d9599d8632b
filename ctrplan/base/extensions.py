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

from ctrplan.errors import InputError

VARIABLE = "CTRPLAN_EXTENSIONS"  # folders, separated as in PATH


def extension_folders() -> list[Path]:
    """The folders that the environment names. Raises InputError for one that does not exist."""
    folders = [Path(name) for name in os.environ.get(VARIABLE, "").split(os.pathsep) if name]
    for folder in folders:
        if not folder.is_dir():
            raise InputError("is not a folder that exists", key=VARIABLE, value=str(folder))
    return folders


def import_modules(package: ModuleType) -> list[ModuleType]:
    """The modules of a package, its own and those of extension folders, in the order of their names.

    Raises InputError, with the file, where a file of an extension folder can't be imported or has the name of one of
    the package's own.
    """
    own = {module.name for module in pkgutil.iter_modules(package.__path__[:1])}
    added: dict[str, Path] = {}
    for folder in extension_folders():
        place = folder.joinpath(*package.__name__.split(".")[1:])
        for module in pkgutil.iter_modules([str(place)]):
            added[module.name] = place
            if module.name in own:
                raise InputError("has the name of a file of the package", file=str(place / f"{module.name}.py"))
        if place.is_dir() and str(place) not in package.__path__:
            package.__path__.append(str(place))
    return [_imported(package, name, added.get(name)) for name in sorted({*own, *added})]


def _imported(package: ModuleType, name: str, place: Path | None) -> ModuleType:
    if place is None:
        return importlib.import_module(f"{package.__name__}.{name}")
    try:
        return importlib.import_module(f"{package.__name__}.{name}")
    except InputError:
        raise
    except Exception as error:  # whatever the file does when it is imported
        sentence = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"can't be imported: {sentence}", file=str(place / f"{name}.py")) from error
