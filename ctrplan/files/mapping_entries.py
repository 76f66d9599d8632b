"""What a mapping file may say: where in a laboratory's own tables the columns are that ctrplan reads."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from ctrplan.storage.number_ranges import Angle, Coordinate, Name, Point

MOST_RUNS = 200

Column = str | int  # its name, or its number from 1 where there is no header; -NAME changes its sign
Columns = list[Column]
Three = Annotated[list[Column], Meta(min_length=3, max_length=3)]
Quaternion = tuple[float, float, float, float]


class FrameEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """frame = {...}: the robot's frame in that of the tracker."""

    position_mm: Point = (0.0, 0.0, 0.0)
    quaternion_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)


class RunEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[[run]]: a file, or one of joints and one of poses whose rows belong together."""

    file: str | None = None
    joints: str | None = None
    poses: str | None = None
    tracker: Name = "tracker"  # runs of one name share its frame
    homing: Name = "homing"  # runs of one name share the zeros of the joints
    frame: FrameEntry | Literal["unknown"] | None = None


class ColumnsEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[columns]: of both files of a run counted on, those of the poses after those of the joints."""

    position: Three | None = None  # of the tip
    markers: dict[str, Three] = {}  # marker of the robot -> columns, "" along the line of sight
    theta: Columns | None = None
    l: Columns | None = None  # noqa: E741 (as in the equations)
    joints: dict[str, Column] | None = None  # actuator -> column, in place of theta and l
    tangent: Three | None = None  # "" where a component is not seen
    time: Column | None = None
    sequence: Column | None = None
    more: dict[str, Column] = {}


class UnitsEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[units]"""

    theta: Literal["rad", "deg", "turns"] = "rad"
    l: Literal["m", "mm"] = "m"  # noqa: E741
    position: Literal["m", "mm"] = "m"
    time: Literal["s", "ms", "us", "ns"] = "s"


class ZeroEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[zero]: what is added to the values of the tubes, in the order of the lists."""

    theta_deg: list[Angle] | None = None
    l_mm: list[Coordinate] | None = None


class MappingEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """A mapping file."""

    run: Annotated[list[RunEntry], Meta(min_length=1, max_length=MOST_RUNS)]
    columns: ColumnsEntry
    units: UnitsEntry = UnitsEntry()
    zero: ZeroEntry = ZeroEntry()
    tubes: Literal["outermost first", "innermost first"] = "outermost first"
    values: Literal["commanded", "collars"] = "commanded"
    rotations: Literal["unwrapped", "wrapped"] | None = None
    separator: Literal[",", ";", "tab", "space"] = ","
    header: bool = True
