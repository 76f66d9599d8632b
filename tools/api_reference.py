"""Writes the reference of the Python interface as HTML: `make api`, or python tools/api_reference.py FOLDER.

Every public module. Warnings are errors: a docstring or an annotation that pdoc cannot read ends it with 1.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
import warnings
from pathlib import Path
from types import ModuleType

import pdoc

import ctrplan


def modules() -> list[str]:
    """Public modules, but for those that come with a package that does not say what is in it."""
    found = [ctrplan.__name__]
    for info in pkgutil.walk_packages(ctrplan.__path__, "ctrplan."):
        parent = importlib.import_module(info.name.rpartition(".")[0])
        if not info.name.rpartition(".")[2].startswith("_") and not comes_along(parent, info.name):
            found.append(info.name)
    return found


def comes_along(parent: ModuleType, name: str) -> bool:
    """Whether pdoc documents a submodule with its parent."""
    listed = getattr(parent, "__all__", None)
    return listed is None or name.rpartition(".")[2] in listed


def main(folder: str) -> None:
    """Writes the pages."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", DeprecationWarning)
        pdoc.pdoc(*modules(), output_directory=Path(folder))


if __name__ == "__main__":
    main(*sys.argv[1:])
