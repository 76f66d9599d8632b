"""Which structures the robot stays inside of and which it avoids: as said, or by names that leave no doubt."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ctrplan.anatomy.shape import Role
from ctrplan.cases.inputs import Found
from ctrplan.cases.structures import Structure, stem
from ctrplan.errors import InputError

LUMEN = re.compile(r"airway|trachea|bronch|lumen|ventric|cavity|phary|laryn", re.IGNORECASE)
AVOID = re.compile(
    r"vessel|arter|vein|venous|aort|carotid|vascula|bone|skull|rib(s|_|\b|cage)|vertebr|spine|nerve|obstacle|avoid",
    re.IGNORECASE,
)
RANGE = re.compile(r"\s*(above|below)\s*=\s*(-?\d+(\.\d+)?)\s*(,|$)")


def chosen(
    found: Found,
    lumens: Sequence[str],
    avoids: Sequence[str],
    ignored: Sequence[str],
    targets: Sequence[Structure] = (),
) -> tuple[list[tuple[Structure, Role]], list[str]]:
    """Structures with their roles, and a note of those that were recognised or left out. Raises InputError.

    Names are of segments, labels, meshes or files; "FILE:NAME" where two files have one, "FILE:above=200" of grey
    values. targets: structures to be reached, which are not avoided.
    """
    roles: dict[Structure, Role | None] = {}
    told: list[tuple[str, Sequence[str], Role | None]] = [
        ("--lumen", lumens, "inside"),
        ("--avoid", avoids, "avoid"),
        ("--ignore", ignored, None),
    ]
    for option, names, role in told:
        for name in names:
            one = named(found, option, name)
            if roles.setdefault(one, role) != role:
                raise InputError("is said to be two things", key=option, value=name)
    for one in targets:
        if roles.setdefault(one, None) == "avoid":
            raise InputError("is said to be two things", key="--target", value=one.name)
    recognised = {one: role for one in found.structures if one not in roles and (role := by_name(one.name))}
    roles |= recognised
    taken = [(one, role) for one, role in roles.items() if role]
    left = [one for one in found.structures if one not in roles]
    if not taken:
        rule = "is needed, or --avoid: which structure the robot moves through and which it avoids can't be known of"
        raise InputError(f"{rule} {found.listed}{_grey(found)}", key="--lumen")
    return taken, [*_recognised(recognised), *_left(left)]


def by_name(name: str) -> Role | None:
    """The role that a name tells; None where it tells none, or two."""
    is_lumen, is_obstacle = bool(LUMEN.search(name)), bool(AVOID.search(name))
    if is_lumen == is_obstacle:
        return None
    return "inside" if is_lumen else "avoid"


def named(found: Found, option: str, text: str) -> Structure:
    """The structure that an option names. Raises InputError with those that there are."""
    one = matching(found, option, text)
    if one is None:
        rule = f"is not there: the files hold {found.listed}{_grey(found)}"
        raise InputError(rule, key=option, value=text)
    return one


def matching(found: Found, option: str, text: str) -> Structure | None:
    """The structure that a text names; None where none is called so. Raises InputError for several."""
    matches = [one for one in found.structures if text in (one.name, one.file.name)]
    matches = matches or [one for one in found.structures if text.lower() == one.name.lower()]
    file, colon, name = text.partition(":")
    if not matches and colon:
        if (image := _grey_file(found, file)) is not None:
            return _range(found, image, option, text, name)
        within = [one for one in found.structures if file in (one.file.name, str(one.file))]
        matches = [one for one in within if name in (one.name, _group_of(one, name))]
        if not matches and within and within[0].entry["kind"] == "mesh":
            return Structure(within[0].file, name, "group", {**within[0].entry, "group": name})
    if len({one.file for one in matches}) > 1:
        rule = f"is in several files, say which as FILE:{matches[0].name}: {', '.join(one.called for one in matches)}"
        raise InputError(rule, key=option, value=text)
    if len(matches) > 1:
        rule = f"names several structures: the files hold {found.listed}{_grey(found)}"
        raise InputError(rule, key=option, value=text)
    return matches[0] if matches else None


def _group_of(one: Structure, name: str) -> str | None:
    """A label map of one label is called by its file, its label is still a name."""
    return name if str(one.entry.get("label")) == name else None


def _grey_file(found: Found, name: str) -> Path | None:
    return next((path for path in found.grey if name in (path.name, str(path), stem(path))), None)


def _range(found: Found, image: Path, option: str, text: str, said: str) -> Structure:
    ends: dict[str, Any] = {}
    place = 0
    while match := RANGE.match(said, place):
        ends[match[1]] = float(match[2])
        place = match.end()
    if not ends or place < len(said):
        rule = (
            f"{image.name} has grey values: say a range as {image.name}:below=-500 or {image.name}:above=100,below=300"
        )
        raise InputError(rule, key=option, value=text)
    series = {"series": found.series} if image.is_dir() and found.series else {}
    return Structure(image, said, "grey values", {"kind": "volume", **series, **ends})


def _grey(found: Found) -> str:
    if not found.grey:
        return ""
    return f"; {found.grey[0].name} has grey values, of which a range can be said as {found.grey[0].name}:below=-500"


def _recognised(roles: dict[Structure, Any]) -> list[str]:
    words = {"inside": "a lumen, to stay inside", "avoid": "an obstacle, to be avoided"}
    return [
        f"{one.called} is taken for {words[role]}: by its name (--ignore '{one.name}' leaves it out)"
        for one, role in roles.items()
    ]


def _left(structures: Sequence[Structure]) -> list[str]:
    if not structures:
        return []
    return [f"left out, since nobody says what they are: {', '.join(one.called for one in structures)}"]
