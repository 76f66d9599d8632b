"""What arguments of public functions may be, stated once at the boundary: kinds of values, and a decorator.

    @checked(refinement=Number(0.25, 16), accuracy=Choice("search", "certificate"))
    def solve(self, theta_b, *, refinement=1.0, accuracy="search"): ...

A value of another kind is refused in one sentence before anything runs. The command line reads its numbers by the same
kinds. Arrays are read by `ctrplan.base.arrays.numbers`.

Where a function and a command have many options in common, a TypedDict says each of them once. The decorator spells its
keys out in the signature, and `ctrplan.commands.options.add_options` makes the command's options of them:

    class Options(TypedDict, total=False):
        margin_mm: Annotated[float, Option(Number(0, 10, "mm"), "kept from every structure", "D")]

    @checked(Options)
    def case(output, **options: Unpack[Options]): ...
"""

from __future__ import annotations

import difflib
import functools
import inspect
import math
import numbers
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ParamSpec, TypeVar, get_type_hints

from ctrplan.errors import InputError

P = ParamSpec("P")
T = TypeVar("T")

# What people may write, in files and on the command line: beyond it a value is in another unit.
LONGEST_MM = 1e5
MOST_STARTS = 100_000  # of a search for configurations
MOST_TURNS_DEG = 360e3  # a thousand turns


class Kind(ABC):
    """What a value may be."""

    unit: str | None = None

    @abstractmethod
    def fits(self, value: Any) -> bool:
        """Whether the value is of this kind."""

    @property
    @abstractmethod
    def rule(self) -> str:
        """What must be, as the end of a sentence."""


@dataclass(frozen=True)
class Number(Kind):
    """A real number from `low` to `high`; `above`: the lower end itself is none."""

    low: float
    high: float
    unit: str | None = None
    above: bool = False

    def fits(self, value: Any) -> bool:
        is_real = isinstance(value, numbers.Real) and not isinstance(value, bool)  # numpy's are real ones too
        return is_real and bool(self.low < value <= self.high if self.above else self.low <= value <= self.high)

    @property
    def rule(self) -> str:
        if self.above:
            return f"must be a number above {self.low:g} and at most {self.high:g}"
        if math.isinf(self.low) and math.isinf(self.high):
            return "must be a number"
        return f"must be a number from {self.low:g} to {self.high:g}"


def percent_hint(value: object, most: float) -> str:
    """The end of a rule about a share of at most 1, where the value is most likely in %; empty otherwise."""
    return ", a share: is it in %?" if most == 1 and isinstance(value, (int, float)) and 2 <= value <= 100 else ""


class Limited(Number):
    """A number within limits; its rule is worded as those of files are, without the kind."""

    @property
    def rule(self) -> str:
        if self.above:
            return f"must be above {self.low:g} and at most {self.high:g}"
        return f"must be from {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class Whole(Kind):
    """A whole number from `low` to `high`."""

    low: int
    high: int
    note: str = ""

    def fits(self, value: Any) -> bool:
        is_whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
        return is_whole and self.low <= value <= self.high

    @property
    def rule(self) -> str:
        return f"must be a whole number from {self.low} to {self.high}{self.note}"


class Choice(Kind):
    """One of some texts."""

    def __init__(self, *options: str) -> None:
        """options: the texts."""
        self.options = options

    def fits(self, value: Any) -> bool:
        return isinstance(value, str) and value in self.options

    @property
    def rule(self) -> str:
        *most, last = [f'"{option}"' for option in self.options]
        return f"must be {', '.join(most)} or {last}"


READERS = {
    "Scenario": "load_scenario",
    "Robot": "load_robot",
    "Measurements": "load_measurements",
    "Study": "load_study",
}


class Made(Kind):
    """An object of a class of ctrplan or of a library, by the name of the class: nothing is imported for a check."""

    def __init__(self, name: str) -> None:
        """name: of the class, without its module."""
        self.name = name

    def fits(self, value: Any) -> bool:
        return any(made.__name__ == self.name for made in type(value).__mro__)

    @property
    def rule(self) -> str:
        return f"must be a {self.name}"


@dataclass(frozen=True)
class Having(Kind):
    """Whatever has a method, as `what` says it in a sentence."""

    method: str
    what: str

    def fits(self, value: Any) -> bool:
        return callable(getattr(value, self.method, None))

    @property
    def rule(self) -> str:
        return f"must {self.what}"


class Flag(Kind):
    """True or False."""

    rule = "must be True or False"

    def fits(self, value: Any) -> bool:
        return type(value).__name__ in ("bool", "bool_")  # Python's or numpy's


class Text(Kind):
    """A text."""

    rule = "must be a text"

    def fits(self, value: Any) -> bool:
        return isinstance(value, str)


class FilePath(Kind):
    """A path as text or as an object of pathlib."""

    rule = "must be a path"

    def fits(self, value: Any) -> bool:
        return isinstance(value, (str, os.PathLike))


class Texts(Kind):
    """A list of texts; one text is none."""

    rule = "must be a list of texts"

    def fits(self, value: Any) -> bool:
        is_list = isinstance(value, (Sequence, set, frozenset)) and not isinstance(value, (str, bytes))
        return is_list and all(isinstance(item, str) for item in value)


@dataclass(frozen=True)
class Table(Kind):
    """A mapping of texts to values of a kind."""

    kind: Kind

    def fits(self, value: Any) -> bool:
        return isinstance(value, Mapping) and all(
            isinstance(key, str) and self.kind.fits(item) for key, item in value.items()
        )

    @property
    def rule(self) -> str:
        return f"must be a mapping of names, each of which {self.kind.rule}"


class Interval(Kind):
    """Two numbers, lower and upper, of which either may be infinite."""

    rule = "must be two numbers, the lower one first"

    def fits(self, value: Any) -> bool:
        ends = Number(-math.inf, math.inf)
        is_pair = hasattr(value, "__len__") and not isinstance(value, (str, Mapping)) and len(value) == 2
        return is_pair and all(map(ends.fits, value)) and bool(value[0] <= value[1])


MEMBERS = Whole(1, 1000)  # histories that an observer follows
SEED = Whole(0, 2**31 - 10**5 - 1)  # searches add to it
SEARCH_TIME = Number(0, 3600, "s", above=True)

# What holds where nothing is said.
CANDIDATES, CONFIRMED = 256, 8  # base poses of a placement that are looked at, and that are bounded in all corners
DIRECTION_TOLERANCE_DEG = 5.0
PROGRESS = Having("__call__", "be a function")
EVENT = Having("is_set", "be an event, as threading.Event")
EXECUTOR = Having("submit", "have the interface of concurrent.futures.Executor")


def in_plain_digits(text: str, whole: bool = False) -> float | None:
    """The number that a person wrote; None where it is none, or has thousands of digits.

    Python alone takes 1_0 and digits of other scripts for numbers.
    """
    try:
        return None if "_" in text or not text.isascii() else int(text) if whole else float(text)
    except ValueError:
        return None


@dataclass(frozen=True)
class Option:
    """An option of a function and of a command: a key of a TypedDict, whose annotation this is."""

    kind: Kind
    help: str
    metavar: str | None = None
    flag: str = ""  # on the command line, where it is not the key


def options_of(keys: type) -> dict[str, Option]:
    """The options that a TypedDict declares, by key, in their order."""
    hints = get_type_hints(keys, include_extras=True)
    return {name: hint.__metadata__[0] for name, hint in hints.items() if hasattr(hint, "__metadata__")}


def checked(options: type | None = None, /, **kinds: Kind) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """The decorator that refuses arguments of other kinds than those stated by name; what defaults to None may be None.

    Of a class it checks what it is made of. `options` is the TypedDict of the function's further keywords, each of
    which may be None. The function raises InputError that names the argument.
    """

    def decorated(function: Callable[P, T]) -> Callable[P, T]:
        if isinstance(function, type):
            function.__init__ = _guarded(function.__init__, kinds)  # type: ignore[misc]
            return function
        return _guarded(function, kinds, options)

    return decorated


def require(key: str, value: Any, kind: Kind) -> None:
    """Raises InputError that names `key` unless the value is of the kind."""
    try:
        fits = kind.fits(value)
    except (TypeError, ValueError, ArithmeticError):  # of what calls itself a number and compares with none
        fits = False
    if not fits:
        reader = READERS.get(kind.name) if isinstance(kind, Made) and isinstance(value, (str, os.PathLike)) else None
        rule = f"{kind.rule}; ctrplan.{reader} reads one from a file" if reader else kind.rule
        rule += percent_hint(value, kind.high) if isinstance(kind, Limited) else ""
        raise InputError(rule, key=key, value=value, unit=kind.unit)


PLAIN: dict[str, tuple[Kind, type]] = {
    "float": (Number(-math.inf, math.inf), float), "str": (Text(), str), "bool": (Flag(), bool),
}  # fmt: skip


def read_plain_fields(made: object) -> None:
    """Turns numbers of numpy among the fields of a dataclass into Python's, by the fields' annotations.

    Raises InputError that names a field annotated as a number, a text or a flag which is none.
    """
    made_of: Any = type(made)
    for name, plain, kind, may_be_none in _plain_fields(made_of):
        value = getattr(made, name)
        if type(value) is not plain and not (may_be_none and value is None):
            require(name, value, kind)
            try:
                object.__setattr__(made, name, plain(value))
            except OverflowError:
                raise InputError("must be a number that a float can hold", key=name) from None


@functools.cache
def _plain_fields(made: type[Any]) -> tuple[tuple[str, type, Kind, bool], ...]:
    """Fields that hold one plain value: name, class and kind, and whether it may be None."""
    rows = [(each.name, *str(each.type).partition(" | None")[:2]) for each in fields(made)]
    return tuple((name, *PLAIN[plain][::-1], bool(none)) for name, plain, none in rows if plain in PLAIN)


def refuse_other_text(text: str, key: str | None = None) -> None:
    """Raises InputError for text that came from the system in another encoding than UTF-8: no file could hold it."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise InputError("is not UTF-8 text: rename it, or choose a UTF-8 locale", key=key, value=text) from None


def or_meant(name: object, known: Iterable[str]) -> str:
    """The end of a rule that lists names: the known one that is nearest to another, if one is near."""
    close = difflib.get_close_matches(str(name), [*known], n=1)
    return f"; did you mean {close[0]}?" if close else ""


def no_such_number(name: str, keys: Iterable[str]) -> InputError:
    """The refusal of a name that is no number of a robot, with the nearest of the `keys` that such names end with."""
    *place, last = name.split(".")
    if close := difflib.get_close_matches(last, keys, n=1):
        meant = (
            f": is {'.'.join([*place, close[0]])} meant?" if close[0] != last else ": which tube, section or contact?"
        )
    else:
        meant = ": names are as tube.1.poisson_ratio, tube.2.section.1.length_m and contact.1.clearance_m"
    return InputError(f"no such parameter of the robot{meant}", key=name)


def require_made(whole: object, classes: Mapping[str, str]) -> None:
    """Raises InputError that names a field of an object which is neither None nor of its class, by name."""
    for name, made_of in classes.items():
        if getattr(whole, name) is not None:
            require(name, getattr(whole, name), Made(made_of))


def refuse_idle(parameters: Sequence[str], *, gradient: bool) -> None:
    """Raises InputError for parameters by which nothing is differentiated."""
    if parameters and not gradient:
        raise InputError("need gradient=True", key="parameters", value=parameters)


def rows_of(key: str, values: Any, kind: type[T]) -> tuple[T, ...]:
    """Objects of one class as a tuple. Raises InputError that names `key` for anything else."""
    rule = f"must be a list of {kind.__name__} objects"
    if not isinstance(values, (list, tuple)):
        raise InputError(rule, key=key, value=values)
    for wrong in (value for value in values if not isinstance(value, kind)):
        raise InputError(rule, key=key, value=wrong)
    return tuple(values)


def _guarded(function: Callable[..., T], kinds: Mapping[str, Kind], keys: type | None = None) -> Callable[..., T]:
    signature = inspect.signature(function)
    if keys is not None:
        signature = _spelled_out(signature, keys)
        kinds = {**kinds, **{name: option.kind for name, option in options_of(keys).items()}}
    parameters = signature.parameters
    names = tuple(parameters)
    optional = {name for name, parameter in parameters.items() if parameter.default is None}
    unknown = kinds.keys() - parameters.keys()
    if unknown:
        raise TypeError(f"{function.__qualname__} has no parameter {', '.join(sorted(unknown))}")

    @functools.wraps(function)
    def guarded(*arguments: Any, **keywords: Any) -> T:
        for name, value in (*zip(names, arguments, strict=False), *keywords.items()):
            if keys is not None and name not in parameters:  # Python's own sentence
                raise TypeError(f"{function.__name__}() got an unexpected keyword argument {name!r}")
            if name in kinds and not (value is None and name in optional):
                require(name, value, kinds[name])
        return function(*arguments, **keywords)

    guarded.__signature__ = signature  # type: ignore[attr-defined]
    return guarded


def _spelled_out(signature: inspect.Signature, keys: type) -> inspect.Signature:
    """The signature with the keys of a TypedDict in the place of its last parameter, **options."""
    *named, _ = signature.parameters.values()
    kind, types = inspect.Parameter.KEYWORD_ONLY, get_type_hints(keys)
    more = [inspect.Parameter(name, kind, default=None, annotation=types[name] | None) for name in options_of(keys)]
    return signature.replace(parameters=[*named, *more])
