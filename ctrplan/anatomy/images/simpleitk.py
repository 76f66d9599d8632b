"""SimpleITK, which reads images: an extra, imported where one is named and nowhere else."""

from __future__ import annotations

import importlib
import locale
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ctrplan.anatomy.images.image import ImageRefusal


def simpleitk() -> Any:
    """The package, its warnings off. Raises ImageRefusal where it is not installed."""
    try:
        package: Any = importlib.import_module("SimpleITK")
    except ImportError as error:
        raise ImageRefusal("needs SimpleITK: pip install ctrplan[images]") from error
    package.ProcessObject.SetGlobalWarningDisplay(False)
    return package


@contextmanager
def quiet() -> Iterator[None]:
    """What its parts print of damaged files besides raising an error is not shown."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


@contextmanager
def kept_locale() -> Iterator[None]:
    """What its reader of DICOM does to the locale is undone: it sets C, after which files are opened as ASCII."""
    kept = locale.setlocale(locale.LC_ALL)
    try:
        yield
    finally:
        locale.setlocale(locale.LC_ALL, kept)


def reason(error: Exception) -> str:
    """The last thing that the package says of a failure, in a line."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return " ".join((lines[-1] if lines else type(error).__name__).split())[-160:]
