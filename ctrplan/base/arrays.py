"""Arrays of all packages, units of files and screens in SI, directions as unit vectors, and hashes of contents."""

from __future__ import annotations

import copy
import hashlib
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from decimal import Decimal
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.base.arguments import LONGEST_MM as LONGEST_MM
from ctrplan.base.arguments import MOST_TURNS_DEG as MOST_TURNS_DEG
from ctrplan.base.package import warn_caller
from ctrplan.errors import InputError

Array = NDArray[np.float64]
NUMERIC = "iuf"  # kinds of numpy arrays that hold numbers: dates, texts, truth values and complex numbers are none


def read_only(values: ArrayLike) -> NDArray[Any]:
    """A copy of `values` that nobody can change: robots are shared between threads."""
    array = np.array(values)
    array.setflags(write=False)
    return array


def to_be_read(values: NDArray[Any]) -> NDArray[Any]:
    """A view of numbers for somebody who is not to change them; the same where nobody may."""
    if not values.flags.writeable:
        return values
    view = values.view()
    view.setflags(write=False)
    return view


def frozen_content(value: Any) -> Any:
    """A copy of a file's content, tables and lists in one another, that nobody can change."""
    if isinstance(value, (FrozenTable, FrozenList)):
        return value
    if isinstance(value, Mapping):
        return FrozenTable({key: frozen_content(entry) for key, entry in value.items()})
    return FrozenList(map(frozen_content, value)) if isinstance(value, (list, tuple)) else value


def _refuse_change(*_: Any, **__: Any) -> NoReturn:
    raise TypeError("The content of a robot or a scenario cannot be changed in place: with_(...) makes another one.")


class FrozenTable(dict[str, Any]):
    """A table that refuses changes, which would have no effect on what was read from it. A deep copy can be changed."""

    __setitem__ = __delitem__ = __ior__ = _refuse_change
    clear = pop = popitem = setdefault = update = _refuse_change

    def __deepcopy__(self, memo: dict[int, Any]) -> dict[str, Any]:
        """An ordinary dict."""
        return {key: copy.deepcopy(value, memo) for key, value in self.items()}

    def __reduce__(self) -> tuple[Any, ...]:
        """What it is made of again where it is unpickled."""
        return FrozenTable, (dict(self),)


class FrozenList(list[Any]):
    """A list that refuses changes. A deep copy can be changed."""

    __setitem__ = __delitem__ = __iadd__ = __imul__ = _refuse_change
    append = clear = extend = insert = pop = remove = reverse = sort = _refuse_change

    def __deepcopy__(self, memo: dict[int, Any]) -> list[Any]:
        """An ordinary list."""
        return [copy.deepcopy(value, memo) for value in self]

    def __reduce__(self) -> tuple[Any, ...]:
        """What it is made of again where it is unpickled."""
        return FrozenList, (list(self),)


def lengths(vectors: Array) -> Array:
    """(...) lengths of vectors (..., 3): as numpy.linalg.norm, in a fraction of the time for short vectors."""
    result: Array = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))
    return result


def numbers(values: ArrayLike, key: str) -> Array:
    """Whatever holds real numbers, as floats of the same shape.

    Raises InputError for what numpy would take silently or with a warning: texts, dates, truth values, complex
    numbers, masked entries, whole numbers too large for a float.
    """
    if type(values) is np.ndarray and values.dtype == np.float64:
        return values
    try:
        given = np.asarray(values)
        rows = values if isinstance(values, (list, tuple)) else [values]
        if any(map(np.ma.is_masked, rows)):
            raise InputError("must be numbers, some of these are masked", key=key)
        if given.dtype.kind not in NUMERIC and given.size:
            raise InputError(f"must be numbers, not {_kind_of(given)}", key=key)
        with np.errstate(over="ignore"):  # of a long double; infinite numbers are refused where they are used
            return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, ArithmeticError):
        raise InputError("must be numbers, the same count in every row", key=key) from None


def vector(key: str, values: ArrayLike, length: int | None = None) -> Array:
    """Finite numbers (K,), read-only. Raises InputError that names `key` for anything else or another length."""
    array: Array = read_only(numbers(values, key))
    if array.ndim != 1 or not np.isfinite(array).all() or length not in (None, len(array)):
        count = "finite numbers" if length is None else f"{length} finite numbers"
        raise InputError(f"must be a list of {count}", key=key, value=values)
    return array


def _kind_of(given: NDArray[Any]) -> str:
    names = {"M": "dates", "m": "durations", "U": "texts", "S": "texts", "b": "truth values", "c": "complex numbers"}
    return names.get(given.dtype.kind, "objects that a float can't hold")


MILLIMETRE = 1e-3  # m
MM_PER_M = 1 / MILLIMETRE
UNITS_M = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 25.4e-3, "um": 1e-6}  # the likeliest mistake first
UNIT_WORDS = {"m": "metres", "mm": "millimetres", "in": "inches", "cm": "centimetres", "um": "micrometres"}
DEGREE = math.pi / 180  # rad
HOUR_S = 3600.0
MM_DIGITS = 6  # of a length in mm that is written to files: a nanometre
ROUNDING_M = 1e-9  # by which rounding may change a length
NORM_TOLERANCE = 1e-3  # by which digits of a file may change the norm of a unit quaternion
ORIGIN = (0.0, 0.0, 0.0)
LEVEL = 0.95  # share of chance that intervals, radii and quantiles hold
CI95 = 1.959964  # standard deviations on both sides that hold 95 % of a normal number
CHI95 = 2.795483  # standard deviations within which 95 % of the lengths of three normal coordinates lie

Z = np.array([0.0, 0.0, 1.0])
TINY = 1e-12  # below which a sine, a weight or a translation [m] is none but for rounding


def unit(vector: ArrayLike) -> Array:
    """A vector (3,), not zero, divided by its length; squares neither overflow nor vanish. A unit vector stays."""
    given = np.asarray(vector, dtype=np.float64)
    if abs(np.linalg.norm(given) - 1) <= 4 * np.finfo(float).eps:
        return given
    scaled = given / np.abs(given).max()
    return np.asarray(scaled / np.linalg.norm(scaled))


def spread_directions(count: int) -> Array:
    """(count, 3) unit vectors spread evenly over the sphere, along a spiral of the golden ratio."""
    k = np.arange(count) + 0.5
    height, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    around = np.sqrt(1 - height**2)
    return np.column_stack([around * np.cos(turn), around * np.sin(turn), height])


def shortest_rotation(direction: ArrayLike) -> Array:
    """(3, 3) the rotation by the smallest angle that takes z to a direction (3,); for -z about x."""
    from scipy.spatial.transform import Rotation  # slow to import

    aim = unit(direction)
    axis = np.cross(Z, aim)
    sine = float(np.linalg.norm(axis))
    if sine < TINY:
        return np.asarray(Rotation.from_rotvec([0.0 if aim[2] > 0 else math.pi, 0.0, 0.0]).as_matrix())
    return np.asarray(Rotation.from_rotvec(axis / sine * math.atan2(sine, aim[2])).as_matrix())


WINDING_RAD = 2 * math.pi  # beyond which whole numbers of radians are degrees
MOST_DEGREES = 1e5  # beyond which a number is no angle of a tube in any unit
MOST_WINDING_RAD = 50 * math.pi  # beyond which any number is


def are_degrees(theta: ArrayLike) -> bool:
    """Whether angles that are meant to be radians are most likely degrees: whole wherever beyond a turn, or huge."""
    try:
        given = np.asarray(theta)
    except (TypeError, ValueError, OverflowError):
        return False
    if given.dtype.kind not in "iuf":  # no numbers, which is refused where they are read
        return False
    angles = given.astype(np.float64)
    if not angles.size or not np.isfinite(angles).all():
        return False
    largest = float(np.abs(angles).max())
    if largest > MOST_DEGREES:
        return False
    beyond = angles[np.abs(angles) > WINDING_RAD]
    return largest > MOST_WINDING_RAD or bool(beyond.size and (beyond == np.round(beyond)).all())


def warn_of_degrees(key: str, theta: ArrayLike) -> None:
    """Warns whoever called this package of angles that are meant to be radians and are most likely degrees."""
    if are_degrees(theta):
        shown = np.array2string(np.asarray(theta, dtype=np.float64), threshold=6)
        warn_caller(f"{key} = {shown} rad: are these degrees? numpy.radians turns them.")


CHANCE = 0.01  # by which digits that say radians would be a coincidence: about how often people mix the two up


def are_radians(angles_deg: Iterable[float]) -> bool:
    """Whether angles that are meant to be degrees are most likely radians.

    Where all of them that are not 0 are, in radians, whole multiples of 90, 45, 30, 15 or 5 degrees, to all digits that
    were written: 3.1416, or 0.349 and -1.047 together. What chance leaves of that is counted by the digits.
    """
    given = [round(float(angle), 9) for angle in angles_deg if angle]
    if not given or not all(math.isfinite(x) and abs(x) <= WINDING_RAD * 2 for x in given):
        return False
    for step in (math.pi / 2, math.pi / 4, math.pi / 6, math.pi / 12, math.pi / 36):
        chance = 1.0
        for x in given:
            rounding = 0.5 * 10.0 ** int(Decimal(repr(x)).as_tuple().exponent)
            fits = round(x / step) and abs(x - step * round(x / step)) <= rounding * 1.01
            chance *= min(1.0, 2 * rounding / step) if fits else math.inf
        if chance < CHANCE:
            return True
    return False


def in_radians(angles_deg: Sequence[float]) -> int | None:
    """The number of an angle that is meant to be degrees and is most likely in radians; None where there is none.

    The first that is not 0 where all of them are by what they have in common, else one that is so by itself.
    """
    if are_radians(angles_deg):
        return next(k for k, angle in enumerate(angles_deg) if angle)
    return next((k for k, angle in enumerate(angles_deg) if are_radians([angle])), None)


def content_sha256(value: object) -> str:
    """Hash of what a value is made of, however it came about: numbers, texts, arrays, tables, rows, dataclasses.

    1 and 1.0 are the same, rows as lists and tuples too. What has a hash of its own counts by that.
    """
    digest = hashlib.sha256()
    for piece in _pieces(value):
        digest.update(piece)
    return digest.hexdigest()


def _pieces(value: object) -> Iterator[bytes]:
    if value is None or isinstance(value, (str, bool)):
        yield repr(value).encode()
    elif isinstance(value, (int, float, np.number)):
        yield repr(float(value) + 0.0).encode()  # no -0
    elif isinstance(value, np.ndarray):
        yield f"array{value.shape}".encode()
        yield np.ascontiguousarray(value, dtype=np.float64).__add__(0.0).tobytes()
    elif isinstance(value, Mapping):
        for key in sorted(value, key=str):
            yield f"{{{key}:".encode()
            yield from _pieces(value[key])
        yield b"}"
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield b"["
            yield from _pieces(item)
        yield b"]"
    elif isinstance(own := getattr(value, "sha256", None), str):
        yield own.encode()
    elif is_dataclass(value) and not isinstance(value, type):
        yield type(value).__qualname__.encode()
        yield from _pieces({field.name: getattr(value, field.name) for field in fields(value)})
    else:  # a function, or an effect of the catalogue
        kind = value if callable(value) and hasattr(value, "__qualname__") else type(value)
        yield f"{kind.__module__}.{kind.__qualname__}".encode()


def shares_of_length(body_m: Array) -> Array:
    """(N,) share of a body's length at its points (N, 3)."""
    length = np.append(0.0, np.cumsum(lengths(np.diff(body_m, axis=0))))
    share: Array = length / length[-1] if length[-1] > 0 else np.linspace(0.0, 1.0, len(length))
    return share


def alike(bodies: Array, pattern: Array) -> Array:
    """(S, N, 3) as many points on bodies (S, M, 3) as a body (N, 3) has, at the same shares of the first's length."""
    if bodies.shape[1] == len(pattern):
        return bodies
    if bodies.shape[1] == 0:
        return np.zeros((len(bodies), len(pattern), 3))
    if not np.isfinite(bodies).all():
        return np.full((len(bodies), len(pattern), 3), np.nan)
    own, share = shares_of_length(bodies[0]), shares_of_length(pattern)
    columns = [[np.interp(share, own, column) for column in body.T] for body in bodies]
    return np.ascontiguousarray(np.array(columns).transpose(0, 2, 1))
