"""What is wrong with a TOML document that does not fit its schema, said in the words of the file."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args, get_origin

import msgspec
from msgspec import inspect

from ctrplan.base.arguments import or_meant, percent_hint

Path = tuple[str | int, ...]  # of keys and positions, these from 0
Fault = tuple[Path, str]  # the place, and the rule that the value there breaks

# suffix of a key -> unit as people write it
UNITS = {
    "_deg_s3": "deg/s^3",
    "_deg_s2": "deg/s^2",
    "_deg_s": "deg/s",
    "_mm_s3": "mm/s^3",
    "_mm_s2": "mm/s^2",
    "_mm_s": "mm/s",
    "_kg_m3": "kg/m^3",
    "_Nm2": "N m^2",
    "_GPa": "GPa",
    "_per_m": "1/m",
    "_deg": "deg",
    "_mm": "mm",
    "_s": "s",
    "_per_rad": "mm/rad",  # mm_per_rad
}
_ANY_UNIT = re.compile(
    r"_(?:per_)?(?:[µumnck]?m|in|inch|deg|degrees?|rad|rads|N?[munck]?m2|GPa|MPa|Pa|k?g_c?m3|m?s|min|percent|turns?)"
    r"(?:_s[23]?|_ms)?$"
)
# Keys that files of one kind have and those of the other do not.
_OF_ROBOTS = {"tube", "contact", "joint", "home", "measurement", "uncertainty", "effects"}
_OF_SCENARIOS = {"robot", "start", "goal", "target", "base", "anatomy", "margins", "cost", "planner"}
# What the options of a key mean, and what people write in the place of one of them.
MEANINGS: dict[str, dict[str, str]] = {
    "role": {"avoid": "an obstacle", "inside": "a lumen that the robot stays in"},
    "repair": {"off": "nothing is closed", "holes": "small openings, the default", "caps": "flat cuts of any size too"},
    "frame": {"RAS": "x right, y front, z head, as 3D Slicer shows", "LPS": "x left, y back, z head, as DICOM counts"},
    "order": {"outer first": "the default", "inner first": "everything listed by tube from inside"},
}
MEANT: dict[str, tuple[str, ...]] = {
    "inside": ("lumen", "airway", "cavity", "in", "within", "stay inside", "keep inside"),
    "avoid": ("obstacle", "outside", "out", "keep out", "forbidden"),
    "mm": ("millimeter", "millimetre", "millimeters", "millimetres", "MM"),
    "cm": ("centimeter", "centimetre"),
    "m": ("meter", "metre", "meters", "metres"),
    "in": ("inch", "inches"),
    "mesh": ("stl", "obj", "ply", "vtk", "vtp", "vtu", "glb", "gltf", "body", "file"),
    "volume": ("nii", "nifti", "nrrd", "dicom", "image", "label", "segmentation", "ct", "mri"),
    "sphere": ("ball",),
    "capsule": ("cylinder", "tube", "rod"),
    "surface": ("sheet", "wall", "plane"),
    "RAS": ("right", "ras"),
    "LPS": ("left", "lps", "dicom"),
    "holes": ("true", "yes", "on", "auto", "fill"),
    "off": ("false", "no", "none"),
    "deg": ("degree", "degrees", "\u00b0"),
    "rad": ("radian", "radians"),
}
WORD = r"^[A-Za-z][A-Za-z0-9]{0,39}$"
PATTERNS = {WORD: "a letter, and after it letters and digits alone, 40 in all at most"}
_KINDS: tuple[tuple[Any, Any, str], ...] = (  # of a schema, the types that values of it have, and what people call it
    (inspect.FloatType, (int, float), "a number"),
    (inspect.IntType, int, "a whole number"),
    (inspect.StrType, str, "text"),
    (inspect.BoolType, bool, "true or false"),
    ((inspect.ListType, inspect.TupleType), (list, tuple), "a list"),
    ((inspect.StructType, inspect.DictType), dict, "a table"),
    (inspect.NoneType, type(None), "nothing"),
)


def unit_of(key: str) -> str | None:
    """The unit that the last part of a key names, as people write it."""
    suffix = _ANY_UNIT.search(key)
    return UNITS.get(suffix[0]) if suffix else None


def first_fault(content: Any, schema: type[msgspec.Struct]) -> Fault | None:
    """The first thing in `content` that does not fit `schema`, in the order of the file; None if all does."""
    return _fault(content, inspect.type_info(schema), ())


def rule_of_options(options: Sequence[str], key: str = "", value: Any = None) -> str:
    """A rule that lists the options of a value, what they mean where known, and the one most likely meant."""
    meanings = MEANINGS.get(key, {})
    shown = ", ".join(f"{option} ({meanings[option]})" if option in meanings else option for option in options)
    text = str(value).lower() if isinstance(value, (str, bool)) else ""
    meant = [option for option in options if text in (word.lower() for word in (option, *MEANT.get(option, ())))]
    return f"must be one of {shown}{or_meant(meant[0] if meant else value, options if text else ())}"


def _fault(value: Any, kind: inspect.Type, path: Path) -> Fault | None:
    """Where and why a value at `path` is not of a kind."""
    if isinstance(kind, inspect.UnionType):
        return _fault_of_any(value, kind, path)
    if isinstance(kind, inspect.LiteralType):
        is_known = any(value == option and type(value) is type(option) for option in kind.values)
        return None if is_known else (path, f"must be one of {', '.join(map(str, kind.values))}")
    if not _is_of(value, kind):
        is_headed = (
            isinstance(value, dict)
            and isinstance(kind, inspect.ListType)
            and isinstance(kind.item_type, (inspect.StructType, inspect.DictType))
        )
        heads = f", each headed [[{'.'.join(step for step in path if isinstance(step, str))}]]" if is_headed else ""
        return path, f"must be {_in_words(kind)}{heads}"
    if isinstance(kind, inspect.StructType):
        return _fault_in_table(value, kind, path)
    if isinstance(kind, (inspect.ListType, inspect.TupleType, inspect.DictType)):
        return _fault_within(value, kind, path)
    if isinstance(kind, (inspect.FloatType, inspect.IntType)):
        return _beyond(value, kind, path)
    if isinstance(kind, inspect.StrType) and (broken := _wrong_length(len(value), kind)):
        return path, f"must be text {broken}"
    if isinstance(kind, inspect.StrType) and kind.pattern and not re.search(kind.pattern, value):
        return path, f"must be {PATTERNS.get(kind.pattern, f'text like {kind.pattern}')}"
    return None


def _fault_of_any(value: Any, kind: inspect.UnionType, path: Path) -> Fault | None:
    """The fault of a value that may be of several kinds: that of the first kind it looks like."""
    for member in kind.types:
        if _is_of(value, member):
            return _fault(value, member, path)
    literals = [member for member in kind.types if isinstance(member, inspect.LiteralType)]
    if literals:
        return _fault(value, literals[0], path)
    kinds = (_in_words(member) for member in kind.types if not isinstance(member, inspect.NoneType))
    return path, f"must be {' or '.join(kinds)}"


def _fault_in_table(table: dict[Any, Any], kind: inspect.StructType, path: Path) -> Fault | None:
    known = {field.encode_name: field for field in kind.fields}
    for key, value in table.items():
        if not isinstance(key, str):
            return path, "must be a table whose keys are text"
        if key not in known:
            if kind.forbid_unknown_fields:
                return (*path, key), _unknown_key(key, known)
            continue
        if fault := _fault(value, known[key].type, (*path, key)):
            options = _options(next(f.type for f in msgspec.structs.fields(kind.cls) if f.encode_name == key))
            return ((*path, key), rule_of_options(options, key, value)) if options else fault
    missing = [key for key, field in known.items() if field.required and key not in table]
    return ((*path, missing[0]), "is missing") if missing else None


def _options(hint: Any) -> list[str]:
    """What a field may be one of, in the order of its declaration, which `inspect` does not keep."""
    if get_origin(hint) is Literal:
        return [str(option) for option in get_args(hint)]
    return [option for inner in get_args(hint) for option in _options(inner)]


def _fault_within(
    value: Any, kind: inspect.ListType | inspect.TupleType | inspect.DictType, path: Path
) -> Fault | None:
    """The first fault of the entries of a list, or of a table with any keys."""
    if isinstance(kind, inspect.DictType):
        wrong = any(not isinstance(key, str) for key in value)
        faults = (_fault(item, kind.value_type, (*path, key)) for key, item in value.items())
        return (path, "must be a table whose keys are text") if wrong else next(filter(None, faults), None)
    if isinstance(kind, inspect.TupleType):
        if len(value) != len(kind.item_types):
            return path, f"must be a list of length {len(kind.item_types)}"
        kinds = list(kind.item_types)
    else:
        if broken := _wrong_length(len(value), kind):
            return path, f"must be a list {broken}"
        kinds = [kind.item_type] * len(value)
    pairs = enumerate(zip(value, kinds, strict=True))
    return next(filter(None, (_fault(item, member, (*path, k)) for k, (item, member) in pairs)), None)


def _beyond(value: float, kind: inspect.FloatType | inspect.IntType, path: Path) -> Fault | None:
    for sign, limit, is_kept in (
        (">", kind.gt, kind.gt is None or value > kind.gt),
        (">=", kind.ge, kind.ge is None or value >= kind.ge),
        ("<", kind.lt, kind.lt is None or value < kind.lt),
        ("<=", kind.le, kind.le is None or value <= kind.le),
    ):
        if not is_kept and limit is not None:
            hint = percent_hint(value, limit) or _smaller_unit_hint(value, limit, path) if sign == "<=" else ""
            return path, f"must be {_range(kind) or f'{sign} {limit:g}'}{hint}"
    return None


def _smaller_unit_hint(value: float, most: float, path: Path) -> str:
    """The end of a rule about a modulus in GPa that is too large in GPa, but not in MPa or in Pa."""
    if unit_of(str(path[-1])) != "GPa":
        return ""
    return f": is it in {'MPa' if value <= 1e3 * most else 'Pa'}?" if value <= 1e9 * most else ""


def _range(kind: inspect.FloatType | inspect.IntType) -> str:
    """Both ends of the range of a number; empty where it has but one."""
    if kind.le is None or (kind.ge is None and kind.gt is None):
        return ""
    return f"above {kind.gt:g} and at most {kind.le:g}" if kind.ge is None else f"from {kind.ge:g} to {kind.le:g}"


def _wrong_length(length: int, kind: inspect.ListType | inspect.StrType) -> str:
    """What length a list or text must have that has another one; empty if it is right."""
    if kind.min_length is not None and length < kind.min_length:
        return f"of length >= {kind.min_length}"
    if kind.max_length is not None and length > kind.max_length:
        return f"of length <= {kind.max_length}"
    return ""


def _is_of(value: Any, kind: inspect.Type) -> bool:
    """Whether a value looks like a kind, whatever is within it; true and false are no numbers."""
    if isinstance(kind, inspect.AnyType):
        return True
    for kinds, types, _ in _KINDS:
        if isinstance(kind, kinds):
            return isinstance(value, types) and (isinstance(value, bool) <= (types is bool))
    return isinstance(kind, inspect.LiteralType) and value in kind.values


def _in_words(kind: inspect.Type) -> str:
    return next(words for kinds, _, words in _KINDS if isinstance(kind, kinds))


def _unknown_key(key: str, known: Mapping[str, Any]) -> str:
    if key in _OF_ROBOTS and known.keys() >= _OF_SCENARIOS:
        return (
            f"is a key of robot files, this must be a scenario (ctrplan init scenario writes one); "
            f"to change its robot, write robot.{key} after --set"
        )
    if key in _OF_SCENARIOS and "tube" in known:
        return "is a key of scenarios, this must be a robot file"
    if key in {"name", *_OF_ROBOTS, *_OF_SCENARIOS} and known.keys() >= {"run", "columns"}:
        return "unknown key: measurements are a CSV table or its mapping file, not a robot or scenario"
    if key in {*_OF_ROBOTS, *_OF_SCENARIOS} and "scenario" in known:
        return "is a key of scenarios or robots, this must be a file that names a scenario: are two files exchanged?"
    quantity = _ANY_UNIT.sub("", key)
    if same := [name for name in known if _ANY_UNIT.sub("", name) == quantity]:
        return "unknown key, expected " + " or ".join(f"{n} (in {unit_of(n)})" if unit_of(n) else n for n in same)
    if close := difflib.get_close_matches(key, known, n=1):
        return f"unknown key, did you mean {close[0]}?"
    return f"unknown key, {_listed(known)}"


def _listed(known: Mapping[str, Any]) -> str:
    """The keys there are, those that may be left out called so."""
    needed = [key for key, field in known.items() if field.required]
    optional = [key for key, field in known.items() if not field.required]
    if not needed or not optional:
        return f"known ones{', all optional,' if not needed else ''} are {', '.join(known)}"
    return f"known ones are {', '.join(needed)}, and optional {', '.join(optional)}"
