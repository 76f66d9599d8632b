"""Tables of numbers in CSV files. Every fault is one sentence with file, row, column, value and rule."""

from __future__ import annotations

import codecs
import csv
import hashlib
import io
import os
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ctrplan.base.arguments import in_plain_digits, refuse_other_text
from ctrplan.base.arrays import Array
from ctrplan.errors import InputError


def file_name(path: str | os.PathLike[str], what: str) -> str:
    """The path as text. Raises InputError for what is none: it must be the path of `what`, such as "a TOML file"."""
    try:
        name = os.fspath(path)
    except TypeError:
        name = None
    if not isinstance(name, str):
        raise InputError(f"must be the path of {what}", value=path)
    refuse_other_text(name)
    return name


PACKED = {b"\x1f\x8b": "gzip", b"BZh": "bzip2", b"PK\x03\x04": "zip", b"\xfd7zXZ": "xz", b"\x28\xb5\x2f\xfd": "zstd"}
HEAD_BYTES = 64  # by which a file is told that is not what its name says


def packed_by(head: bytes) -> str | None:
    """The program that packed a file with these first bytes; None for one that is not packed."""
    return next((name for mark, name in PACKED.items() if head.startswith(mark)), None)


def other_than_named(head: bytes) -> str | None:
    """What a file with these first bytes is, whatever its name, as the end of a sentence; None where they may be it.

    Nothing, a page that a server sent in the place of a file, a pointer to a file that was not fetched, text of two
    bytes a letter.
    """
    start = head.removeprefix(codecs.BOM_UTF8).lstrip().lower()
    if not start:
        return "is empty"
    if start.startswith((b"<!doctype html", b"<html")):
        return "is a web page, not the file itself: was it downloaded without signing in?"
    if start.startswith(b"version https://git-lfs"):
        return "is a pointer of Git LFS in the place of the file: git lfs pull fetches it"
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "is not UTF-8 text, but UTF-16: save it as UTF-8"
    return None


def file_bytes(file: str, largest_bytes: int, kind: str, what: str) -> bytes:
    """Everything in `file`; its kind is "CSV" or so.

    Raises InputError if it is unreadable, too large a `what`, or by its first bytes something else.
    """
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
    if (program := packed_by(data)) is not None:
        more = " (a spreadsheet is exported as CSV)" if (program, kind) == ("zip", "CSV") else ""
        raise InputError(f"is packed by {program}: unpack it first{more}", file=file)
    if (other := other_than_named(data[:HEAD_BYTES])) is not None:
        raise InputError(other, file=file)
    return data


def csv_text(header: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """The content of a CSV file: names of the columns and rows of numbers, with every digit, and texts."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


LARGEST_FILE_BYTES = 200_000_000
WHOLE = re.compile(r"\s*-?\d*(?:e-?\d+)?\s*")  # as the halves of numbers are that a comma divides
LARGEST_NUMBER = 1e20  # stamps in nanoseconds are smaller
UNIT_WORDS = ("rad", "deg", "m", "mm", "cm", "s", "ms", "-")
MISSING = ("nan", "na", "n/a", "null", "none", "-", "--", "missing", "#n/a", "-nan", "nan(ind)", "-nan(ind)", "1.#qnan")


class CsvTable:
    """Cells of a CSV file by column name; rows are counted from 1 below the header, as a person would.

    Blank rows, of commas alone too, are none, nor are lines that begin with #.
    """

    def __init__(self, file: str, what: str, *, separator: str = ",", header: bool = True) -> None:
        """Reads the whole file, which is a `what`; `separator` of the columns, " " for any blanks.

        Without a header columns are called 1, 2 and so on; a separator at the end of all rows ends no column. Raises
        InputError unless it is a table: readable, one header, all rows as long.
        """
        data = file_bytes(file, LARGEST_FILE_BYTES, "CSV", what)
        self.names: dict[str, str] = {}  # that a laboratory's file has for columns, by those that are read
        self.file, self.sha256 = file, hashlib.sha256(data).hexdigest()
        try:
            lines = _split(_uncommented(data.decode("utf-8-sig").splitlines(), separator, header=header), separator)
            filled = [row for row in lines if any(map(str.strip, row))]
        except UnicodeDecodeError as error:
            raise InputError(f"is not UTF-8 text (byte {error.start})", file=file) from None
        except csv.Error as error:
            raise InputError(f"is no readable CSV file ({error})", file=file) from None
        if len(filled) < 1 + header:
            raise InputError(f"must have {'a header and ' if header else ''}at least one row", file=file)
        if not header:
            filled = _numbered(filled)
        self.header = _column_names(filled[0], file)
        if header and any(self.header) and all(in_plain_digits(name or "0") is not None for name in self.header):
            raise self.fault(
                "is missing: the first row holds numbers, names of columns must stand above", column="header"
            )
        self.rows = filled[1:]
        for name, count in Counter(self.header).items():
            if count > 1:
                raise self.fault(f"the header has this column {count} times", column=name or "(no name)")
        for row, cells in enumerate(self.rows):
            if cells[0].strip() == self.header[0] and [cell.strip() for cell in cells] == self.header:
                raise self.fault("repeats the header, were files joined?", row)
            if len(cells) != len(self.header):
                there = f"has {len(cells)} values, the header has {len(self.header)} columns"
                hint = ": is its line a title? One begins with #" if len(self.header) == 1 and row == 0 else ""
                if len(cells) > len(self.header) and all(map(WHOLE.fullmatch, cells)):
                    hint = ": are there decimal commas? Numbers have a point"
                raise self.fault(there + hint, row)

    def fault(self, rule: str, row: int | None = None, column: str | None = None, value: object = ...) -> InputError:
        """The error that a cell, row (from 0) or column breaks `rule`."""
        place = ", ".join(part for part in (None if row is None else f"row {row + 1}", column) if part)
        return InputError(rule, file=self.file, key=place or None, value=value)

    def numbers(self, name: str, *, blanks: bool = False) -> Array:
        """(K,) finite numbers of a column; with `blanks` NaN where nothing stands, or a word of MISSING."""
        column = self.header.index(name)
        texts = [cells[column] for cells in self.rows]
        if (values := _plain_numbers(texts)) is not None:
            return values
        texts = [text.strip() for text in texts]
        if blanks:
            texts = ["" if text.lower() in MISSING else text for text in texts]
        given = np.fromiter(map(bool, texts), bool, len(texts))
        if blanks and (values := _plain_numbers(list(filter(None, texts)))) is not None:
            result = np.full(len(texts), np.nan)
            result[given] = values
            return result
        return np.array([self._number(row, name, text, blanks) for row, text in enumerate(texts)])

    def columns(self, names: Sequence[str]) -> Array:
        """(K, N) finite numbers of several columns. Raises InputError for one that there is not."""
        for name in names:
            if name not in self.header:
                raise self.fault("is missing in the header", column=name)
        return np.column_stack([self.numbers(name) for name in names])

    def others(self, known: set[str]) -> tuple[dict[str, Array], list[str]]:
        """Numeric columns besides the known ones; and sentences about those that hold text and are none."""
        results, texts, notes = dict[str, Array](), list[str](), list[str]()
        for name in self.header:
            if name in known:
                continue
            try:
                results[name] = self.numbers(name, blanks=True)
            except InputError as error:
                cells = [cells[self.header.index(name)].strip() for cells in self.rows]
                numbers = [in_plain_digits(cell) is not None for cell in cells if cell.lower() not in ("", *MISSING)]
                if sum(numbers) > len(numbers) / 2:
                    notes.append(f"{self.file}: column {name} is not read: {error.key} = {error.value!r} {error.rule}.")
                else:
                    texts.append(self.names.get(name, name))
        if texts:
            what = (
                f"columns {', '.join(texts)} hold text and are"
                if len(texts) > 1
                else f"column {texts[0]} holds text and is"
            )
            notes.append(f"{self.file}: {what} not read.")
        return {name: values for name, values in results.items() if np.isfinite(values).any()}, notes

    def _number(self, row: int, name: str, text: str, blanks: bool) -> float:
        if blanks and not text:
            return np.nan
        value = in_plain_digits(text)
        if value is None:
            raise self.fault(f"must be a number{_likely(text)}", row, name, text)
        if not np.isfinite(value):
            raise self.fault("must be a finite number", row, name, text)
        if abs(value) > LARGEST_NUMBER:
            rule = f"must be from {-LARGEST_NUMBER:g} to {LARGEST_NUMBER:g}, left empty where nothing was measured"
            raise self.fault(rule, row, name, text)
        return value


def _plain_numbers(texts: Sequence[str]) -> Array | None:
    """(K,) numbers of a whole column at once; None where a cell is none, is blank, or needs a second look."""
    together = "".join(texts)
    if "_" in together or not together.isascii():  # as in `in_plain_digits`
        return None
    try:
        values = np.array(list(map(float, texts)))
    except ValueError:
        return None
    return values if (np.abs(values) <= LARGEST_NUMBER).all() else None


def _likely(text: str) -> str:
    """What a text that is no number most likely is."""
    if in_plain_digits(text.replace(",", ".")) is not None:
        return ", with a point for the decimal comma"
    if text.strip("[]() ").lower() in UNIT_WORDS:
        return ", a row of units begins with #"
    return ", left empty where nothing was measured" if text.lower() in MISSING else ""


def _uncommented(lines: Sequence[str], separator: str, *, header: bool) -> list[str]:
    """The lines without comments, which begin with #; a header that does is one, as numpy.savetxt writes it."""
    if lines and re.fullmatch(r"sep=.", lines[0].strip()):  # which spreadsheets write
        lines = lines[1:]
    kept = [line for line in lines if not line.lstrip().startswith("#")]
    first = next((k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), 0)
    before = [line.lstrip("# ") for line in lines[:first] if line.strip()]
    if not header or not before:
        return kept
    (names,), (cells,) = _split(before[-1:], separator), _split(lines[first : first + 1], separator)
    are_numbers = all(in_plain_digits(cell.strip()) is not None for cell in cells if cell.strip())
    are_names = all(in_plain_digits(name.strip()) is None for name in names)
    return [before[-1], *kept] if are_numbers and are_names and len(names) == len(cells) > 1 else kept


def _split(lines: Sequence[str], separator: str) -> Iterable[list[str]]:
    if separator == " ":
        return (line.split() for line in lines)
    return csv.reader(lines, strict=True, delimiter=separator)


def _numbered(rows: list[list[str]]) -> list[list[str]]:
    """With numbers for names of the columns; without a last column that is empty throughout."""
    if len(rows[0]) > 1 and all(len(row) == len(rows[0]) and not row[-1].strip() for row in rows):
        rows = [row[:-1] for row in rows]
    return [[str(k + 1) for k in range(len(rows[0]))], *rows]


def _column_names(header: Sequence[str], file: str) -> list[str]:
    """Names of the columns. Raises InputError where something else than a comma stands between them."""
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and separator in header[0]:
            raise InputError(f"has its columns separated by {name}, must be commas", file=file)
    return [name.strip() for name in header]
