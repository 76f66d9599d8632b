"""The one tree of errors: each is a single sentence and carries the exit code of the command line."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

LONGEST_VALUE = 60  # characters of a value that a sentence shows
FEW = 6  # entries of an array or a list that are shown one by one


class CtrplanError(Exception):
    """Base of everything ctrplan raises on purpose."""

    exit_code = 1


class InputError(CtrplanError):
    """Input that is malformed or contradicts itself.

    `str()` is one sentence, "robots/a.toml: tube.2.poisson_ratio = 'x': must be a number."; the parts stay
    available as attributes `rule`, `file`, `key`, `value` (Ellipsis when there is none) and `unit`.
    """

    exit_code = 2

    def __init__(
        self,
        rule: str,
        *,
        file: str | os.PathLike[str] | None = None,
        key: str | None = None,
        value: Any = ...,
        unit: str | None = None,
    ) -> None:
        """rule: what must be, without the value. file, key, value, unit: what the rule is about, where known.

        A value is shown as a file spells it, at most LONGEST_VALUE characters of it; text without its unit.
        """
        self.rule, self.file, self.key, self.value, self.unit = rule, file, key, value, unit
        quantity = " = ".join(part for part in (key, _shown(value, unit)) if part)
        sentence = ": ".join(str(part) for part in (repr(file) if file == "" else file, quantity, rule) if part)
        super().__init__(_one_line(sentence))


class NoAnswerError(CtrplanError):
    """The input is well formed, but no answer exists or none was found."""


class SolverError(NoAnswerError):
    """The mechanics solver did not reach a solution it could check."""


@contextmanager
def said_of(key: str) -> Iterator[None]:
    """What is refused below is said of an argument by the name that whoever asked knows it by."""
    try:
        yield
    except InputError as error:
        raise InputError(error.rule, file=error.file, key=key, value=error.value, unit=error.unit) from error.__cause__


class UserFunctionError(CtrplanError):
    """What a function of the user's raised; that error is its cause."""


@contextmanager
def of_the_user(called: str, file: str = "") -> Iterator[None]:
    """Whatever a function of the user's raises as one sentence: what it is called, the error, the line in its file.

    Errors of ctrplan stay what they are. Raises UserFunctionError.
    """
    try:
        yield
    except (CtrplanError, KeyboardInterrupt):
        raise
    except BaseException as error:  # of whatever kind it is: workers end at some
        at, lines = error.__traceback__, list[tuple[str, int]]()
        while at is not None:
            lines.append((at.tb_frame.f_code.co_filename, at.tb_lineno))
            at = at.tb_next
        own = [place for place in lines[1:] if not file or place[0] == file]
        where = f" (line {own[-1][1]} of {os.path.basename(own[-1][0])})" if own else ""
        words = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise UserFunctionError(_one_line(f"{called}: {words}{where}")) from error


def _shown(value: Any, unit: str | None) -> str:
    if value is ...:
        return ""
    try:
        is_short = getattr(value, "size", 0) <= FEW  # a vector of numpy, or no array at all
        text = repr(_in_15_digits(value.tolist() if is_short and hasattr(value, "tolist") else value))
    except ValueError:  # an integer too long to print
        text = f"<{type(value).__name__}>"
    if hasattr(value, "tolist") and not is_short:
        text = f"<{type(value).__name__}>"
    elif isinstance(value, bool):  # as the file spells it
        text = text.lower()
    elif hasattr(value, "isoformat"):
        text = value.isoformat()
    if len(text) > LONGEST_VALUE:
        text = text[: LONGEST_VALUE - 3] + "..."
    return f"{text} {unit}" if unit and not isinstance(value, str) else text


def _in_15_digits(value: Any) -> Any:
    """Numbers without what a change of units leaves in the last digit: nobody wrote 2.5999999999999996."""
    if isinstance(value, list):
        return [_in_15_digits(each) for each in value]
    return float(f"{value:.15g}") if type(value) is float else value


def _one_line(text: str) -> str:
    """One sentence without line breaks or control characters, which a key or a file name may smuggle in."""
    text = "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))
    return text if text.endswith((".", "?")) else text + "."
