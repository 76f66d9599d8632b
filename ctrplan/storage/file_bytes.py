"""The bytes of an input file, or one sentence about why they can't be had."""

from __future__ import annotations

import os

from ctrplan.errors import InputError


def file_name(path: str | os.PathLike[str], what: str) -> str:
    """The path as text. Raises InputError for what is none: it must be the path of `what`, such as "a TOML file"."""
    try:
        name = os.fspath(path)
    except TypeError:
        name = None
    if not isinstance(name, str):
        raise InputError(f"must be the path of {what}", value=path)
    return name


def file_bytes(file: str, largest_bytes: int, kind: str, what: str) -> bytes:
    """Everything in `file`; its kind is "CSV" or so. Raises InputError if it is unreadable or too large a `what`."""
    try:
        with open(file, "rb") as stream:
            size = os.fstat(stream.fileno()).st_size  # a file that is much too large is not read at all
            data = stream.read(largest_bytes + 1) if size <= largest_bytes else b""
    except FileNotFoundError:
        raise InputError("does not exist", file=file) from None
    except IsADirectoryError:
        raise InputError(f"is a folder, not a {kind} file", file=file) from None
    except (OSError, ValueError) as error:
        raise InputError(f"can't be read ({getattr(error, 'strerror', None) or error})", file=file) from None
    if max(size, len(data)) > largest_bytes:
        raise InputError(f"is larger than {largest_bytes // 10**6} MB, no {what}", file=file)
    return data
