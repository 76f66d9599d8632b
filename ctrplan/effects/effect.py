"""What every effect of the catalogue says about itself, and the catalogue.

An effect belongs to one stage of the chain and changes what passes through that stage; everything else is inherited.
A new effect is one new file in the folder of its stage, here or in that of an extension: docs/extending.md.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeVar, get_args

import numpy as np

from ctrplan.base.arrays import DEGREE as DEGREE
from ctrplan.base.arrays import MILLIMETRE as MILLIMETRE
from ctrplan.base.arrays import Array
from ctrplan.base.catalogue import Catalogue, file_of_ones_own, guarded
from ctrplan.drive.legs import Collars
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements, Poses
from ctrplan.robot.robot import Robot

Stage = Literal["clock", "drive", "mechanics", "sensor"]
Values = Mapping[str, float]  # parameter -> value, SI
Stood = TypeVar("Stood", Collars, Poses)


@dataclass(frozen=True)
class Parameter:
    """A number of an effect; everything but `si` is in the unit that the name ends with."""

    name: str
    prior: float  # standard deviation of what is plausible, around `neutral`
    neutral: float = 0.0  # the value at which the effect vanishes
    lower: float = -np.inf
    upper: float = np.inf
    start: float | None = None  # where a fit starts, `neutral` if None
    si: float = 1.0  # SI value of the name's unit


class Effect(ABC):
    """A term of one stage. Subclasses set the class attributes and override what they change."""

    name: str
    stage: Stage
    equation: str
    signature: str  # what it does to data, in a sentence
    in_words: str = ""  # the effect for people, as "play in the drive"; its name where empty
    look_alikes: ClassVar[tuple[str, ...]] = ()
    experiment: str  # what separates it from them
    is_linear: ClassVar[bool] = True  # whether tips change nearly in proportion to its parameters
    scales_with_stiffness: ClassVar[bool] = False  # its parameters are known only as well as the stiffness of tube 1
    acts_at_rest: bool = True  # of drive and mechanics: whether a shape at rest has it, however it came there
    needs: ClassVar[str] = ""  # an effect without which it does nothing
    depends_on_history: ClassVar[bool] = False  # acts on differences between approaches of one configuration

    is_alone: ClassVar[bool] = False  # so like whatever acts at a place that it is not asked beside a rest
    of_the_file: ClassVar[bool] = False  # its parameters are the robot file's own numbers, not a table [effects.NAME]
    sets_outright: ClassVar[bool] = False  # of the mechanics: its parameters take the place of the file's own numbers

    needs_time: ClassVar[bool] = False  # whether it does nothing without time_s
    needs_columns: ClassVar[tuple[str, ...]] = ()  # others (`Measurements.more`) that it does nothing without
    turns_with_tip: ClassVar[bool] = False  # of the sensor: whether the tangent alone says too little

    @property
    def title(self) -> str:
        """For people: in words, or the name without its underscores."""
        return self.in_words or self.name.replace("_", " ")

    def in_figures(self, values: Values, robot: Robot) -> str:
        """What the real robot does at these values, in the units of their names: "tube 2 turns 5 % too far".

        Here the title with the values; an effect of the catalogue says it in words that need no equation.
        """
        return f"{self.title}: {', '.join(f'{name} {two_digits(value)}' for name, value in values.items())}"

    @abstractmethod
    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Everything that a robot file may say about the effect, of tubes numbered from 1, outermost first."""

    def untestable(self, robot: Robot, data: Measurements) -> str:
        """Why these data say nothing about the effect; empty if they do."""
        missing = self.missing_columns(data.time_s, data.more)
        return f"there is no column {', '.join(missing)}" if missing else ""

    def missing_columns(self, time_s: Array | None, more: Mapping[str, Array]) -> list[str]:
        """What the effect needs and data with these columns do not have: it does not act on them."""
        missing = ["time_s"] if self.needs_time and time_s is None else []
        return [*missing, *(name for name in self.needs_columns if name not in more)]

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        """Sets of parameters worth fitting, the others staying neutral."""
        return [[parameter.name for parameter in self.parameters(robot)]]

    def starts(self, names: Sequence[str]) -> Sequence[Values]:
        """Values, in the units of the names, that a fit should start from besides the parameters' own."""
        return [{}]

    def shared(self, names: Sequence[str]) -> Sequence[str]:
        """Names of the parameters by which other causes act as well: what these explain alone names nothing."""
        return []

    def delay_s(self, values: Values) -> float:
        """How much earlier [s] the joints are that a pose belongs to, an effect of the clock; several delays add up."""
        return 0.0

    def drive_delays_s(self, values: Values, n: int) -> Array:
        """(2 n,) how much later [s] than commanded each rotation, then each translation, happens; an effect of the
        clock.
        """
        return np.zeros(2 * n)

    def drive(self, values: Values, collars: Collars, directions: Array) -> Collars:
        """Where collars stand when the drive has gone to `collars`; values are SI by name.

        directions (K, 2 n): sign of the last motion of each rotation, then of each translation; 0 before any.
        """
        return collars

    def bends(self, values: Values, collars: Collars) -> Iterator[tuple[Array, Array]]:
        """Inputs (K,) of an effect of the drive at `collars`, each with values (B,) between which `drive` is smooth,
        however narrow what lies between; none where it is smooth everywhere.
        """
        yield from ()

    def zeros(self, values: Values, data: Measurements) -> Array | None:
        """(K, 2 n) what the zeros of rotations [rad], then of translations [m], are off at each pose; an effect of
        the drive.

        That of the runs in a log; where nobody knows the run, no zero is off.
        """
        return None

    def mechanics(self, values: Values, robot: Robot) -> Mapping[str, float]:
        """Named numbers of the robot (`named_numbers.py`) that differ from what `robot` has."""
        return {}

    def changing(self, values: Values, robot: Robot, data: Measurements) -> Mapping[str, Array]:
        """How much (K,) named numbers of the mechanics differ at each pose from what `robot` has.

        Small changes: tips follow them to first order.
        """
        return {}

    def plate_turn(self, values: Values, robot: Robot, collars: Collars) -> Array | None:
        """Rotation vectors (K, 3) [rad] of all that is in front of the plate, about its middle; an effect of the
        mechanics.
        """
        return None

    def largest_turn_rad(self, values: Values, robot: Robot) -> float:
        """What no `plate_turn` exceeds. Bounds and plans allow for it as for a model error."""
        return 0.0

    def anywhere(self, values: Values) -> Mapping[str, float]:
        """Names of values beside its parameters that differ from pose to pose or run to run, with the most that they
        come to either way [SI]: to bounds and plans, which ask about any, they are parameters known by an interval.
        """
        return {}

    def play(self, values: Values, n: int) -> Collars:
        """How far (1, n) an effect of the drive that depends on directions may move the collars, every way the same."""
        nowhere, ahead = Collars(np.zeros((1, n)), np.zeros((1, n))), np.ones((1, 2 * n))
        moved = self.drive(values, nowhere, ahead)
        return Collars(np.abs(moved.theta), np.abs(moved.l))

    @property
    def counts_turns_of(self) -> frozenset[int]:
        """Tubes, from 1, on whose rotations an effect of the drive depends beyond whole turns."""
        return frozenset()

    def stated(self, values: Values) -> Mapping[str, Any]:
        """What its table in a robot file says besides the parameters."""
        return {}

    def friction_share(self, values: Values, data: Measurements) -> Array | float:
        """(K, n - 1) or one share of the friction state that is left when a pose is taken; an effect of the
        mechanics.
        """
        return 1.0

    def friction_release_m(self, values: Values) -> float:
        """Relative translation [m] that leaves 1/e of the circumferential friction; infinite if none does."""
        return np.inf

    def sensor(self, values: Values, poses: Poses, data: Measurements) -> Poses:
        """What is measured of `poses`, the K of `data` in the robot's frame."""
        return poses

    def sensor_by(self, values: Values, poses: Poses) -> Mapping[str, Array]:
        """(K, 6) derivatives of the positions and tangents that `sensor` makes of K poses, by parameters for which they
        are cheap.
        """
        return {}

    def alike(self, made: Stood, given: Stood) -> Stood:
        """What `drive` or `sensor` made of what they were given. Raises InputError for another kind, shape, or NaN."""
        key = f"effects.{self.name}"
        if type(made) is not type(given):
            raise InputError(f"must return {type(given).__name__}, not {type(made).__name__}", key=key)
        for returned, before in zip(vars(made).values(), vars(given).values(), strict=True):
            if np.shape(returned) != before.shape:
                rule = f"returns an array of shape {np.shape(returned)} where it was given {before.shape}"
                raise InputError(rule, key=key)
            if np.any(~np.isfinite(returned) & np.isfinite(before)):
                raise InputError("returns numbers that are not finite", key=key)
        return made

    def overrides(self, method: str) -> bool:
        """Whether it has a `method` of its own."""
        return getattr(type(self), method) is not getattr(Effect, method)


ANYWHERE = "anywhere"  # how names of an effect's `anywhere` end
E_ = TypeVar("E_", bound=type[Effect])
CATALOGUE: Catalogue[Effect] = Catalogue(
    "effect", *(f"ctrplan.effects.{stage}" for stage in ("clock", "drive", "mechanics", "sensor"))
)
STATED = ("name", "stage", "equation", "signature", "experiment")  # what every effect says of itself


def register(effect: E_) -> E_:
    """Adds an effect to the catalogue. Raises InputError where it says too little, or has another's name."""
    CATALOGUE.require(effect, STATED)
    if effect.stage not in get_args(Stage):
        rule = f"the stage of {effect.__name__} must be one of {', '.join(get_args(Stage))}"
        raise InputError(rule, value=effect.stage)
    guarded(effect, f"effects.{effect.name}")
    if file_of_ones_own(effect):
        setattr(effect, "parameters", _stated(effect.parameters, f"effects.{effect.name}"))  # noqa: B010 (of a class)
    CATALOGUE.add(effect.name, effect(), effect.__module__)
    return effect


def _stated(parameters: Callable[..., Any], key: str) -> Callable[..., tuple[Parameter, ...]]:
    """A method `parameters`, asked for what it returns. Its result raises InputError for anything else."""

    def call(effect: Effect, robot: Robot) -> tuple[Parameter, ...]:
        made = parameters(effect, robot)
        if not isinstance(made, (tuple, list)) or not all(isinstance(each, Parameter) for each in made):
            raise InputError("parameters: must return a tuple of Parameter", key=key)
        return tuple(made)

    return call


def two_digits(value: float) -> str:
    """A number for a sentence: two digits, more of what is larger than 100, never a power of ten."""
    if not np.isfinite(value) or value == 0:
        return f"{value:g}"
    places = max(0, 1 - int(np.floor(np.log10(abs(value)))))
    text = f"{value:.{places}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


Clauses = list[tuple[float, str]]  # sizes, by which they are put in order, and texts


def clauses(values: Values, name: str, text: str, *, signs: tuple[str, str] = ("", ""), factor: float = 1.0) -> Clauses:
    """Clauses of a sentence: `text` for every value whose name is `name` with numbers in the place of I and K.

    In the text {I}, {K} are the numbers, {next} is I + 1, {value} is the value times `factor` and {sign} the first of
    `signs` where it is positive, else the second; the value is without its own sign then.
    """
    pattern = re.compile(re.escape(name).replace("I", r"(?P<I>\d+)").replace("K", r"(?P<K>\d+)"))
    result: Clauses = []
    for key, value in values.items():
        if match := pattern.fullmatch(key):
            size, numbers = factor * value, match.groupdict()
            shown = two_digits(abs(size) if any(signs) else size)
            following = int(numbers["I"]) + 1
            result.append((size, text.format(**numbers, next=following, value=shown, sign=signs[int(size < 0)])))
    return result


def vectors(values: Values, names: Sequence[str], text: str, *, factor: float = 1.0) -> Clauses:
    """`text` with {I} and {value}, for every number I: the length of the vector whose components have these names."""
    numbers = sorted({int(x) for key in values for x in re.findall(r"_(\d+)", key)})
    sizes = ((i, factor * length_of(values, *(name.replace("I", str(i)) for name in names))) for i in numbers)
    return [(size, text.format(I=i, value=two_digits(size))) for i, size in sizes]


def length_of(values: Values, *names: str) -> float:
    """The length of a vector whose components have these names; 0 for those that are not there."""
    return float(np.linalg.norm([values.get(name, 0.0) for name in names]))


def direction_of(values: Values, *names: str) -> str:
    """The direction of that vector, as "(0, 0.6, -0.8)"."""
    vector = np.array([values.get(name, 0.0) for name in names])
    unit = vector / max(float(np.linalg.norm(vector)), 1e-300)
    return f"({', '.join(f'{x + 0.0:.2g}' for x in unit.round(2))})"


MOST_CLAUSES = 3  # clauses that a sentence holds


def joined_clauses(*parts: Clauses) -> str:
    """Clauses as one, those with the largest sizes where there are many."""
    ordered = sorted((clause for part in parts for clause in part if clause[0]), key=lambda clause: -abs(clause[0]))
    shown = [text for _, text in ordered[:MOST_CLAUSES]]
    return ", ".join([*shown, *([f"and {len(ordered) - MOST_CLAUSES} more"] if len(ordered) > MOST_CLAUSES else [])])


def numbered(stem: str, numbers: Iterable[int], unit: str = "") -> list[str]:
    """Names such as theta_2_deg."""
    return [f"{stem}_{number}{unit}" for number in numbers]


def turning(data: Measurements) -> list[int]:
    """Tubes (from 1) whose base ever turns."""
    return [i + 1 for i in range(data.n) if np.ptp(data.theta_commanded[:, i]) > np.radians(1.0)]


def sliding(data: Measurements) -> list[int]:
    """Tubes (from 1) whose base is ever moved along."""
    return [i + 1 for i in range(data.n) if np.ptp(data.l_commanded[:, i]) > 0.5e-3]


def shifted(collars: Collars, values: Values, by: Callable[[float, Array], Array | float]) -> Collars:
    """Collars with what `by` makes of each value, called theta_I or l_I, and of its column (K,) added to that."""
    tables = {"theta": collars.theta, "l": collars.l}
    for name, value in values.items():
        kind, number = name.split("_")[:2]
        tables[kind] = with_column(tables[kind], int(number), by(value, tables[kind][:, int(number) - 1]))
    return Collars(tables["theta"], tables["l"])


def with_column(matrix: Array, tube: int, change: Array | float) -> Array:
    """A copy with `change` added to the column of a tube (from 1)."""
    changed = matrix.copy()
    changed[:, tube - 1] += change
    return changed
