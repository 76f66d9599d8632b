"""Processes that multiprocessing starts, without running the user's script again in each of them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType


@contextmanager
def no_main_module() -> Iterator[None]:
    """Meanwhile such processes import no main module, so that scripts need no guard of theirs.

    They would run a script without `if __name__ == "__main__":` from its beginning, and the study in it once more.
    """
    own = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = own
