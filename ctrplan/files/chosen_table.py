"""A table that names one of a catalogue (a planner, a kind of obstacle) and has its keys then, and no others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import msgspec

from ctrplan.base.catalogue import Catalogue
from ctrplan.storage.toml_table import Table

T = TypeVar("T", bound=msgspec.Struct)


def chosen(
    table: Table, by: str, catalogue: Catalogue[type[T]], common: type[msgspec.Struct], default: str | None = None
) -> T:
    """The table as the catalogue's schema that its key `by` names; all of them have the keys of `common`.

    default: what it names where the key is missing. Raises InputError for a name that is not in the catalogue, for a
    key of another schema than the one named, for one that is missing, and for what does not fit.
    """
    name = _name(table, by, catalogue, default)
    own = {other: _own_fields(schema, common) for other, schema in catalogue.items()}
    for key in sorted(table.content):
        if key not in own[name] and any(key in keys for keys in own.values()):
            raise table.fault(f"does not go with {by} = '{name}'", key)
    for key in _required(catalogue[name]):
        if key not in table.content and key != by:
            raise table.fault(f"is missing, a {name} needs {', '.join(own[name])}", key)
    return table.to(catalogue[name])


def _name(table: Table, by: str, catalogue: Catalogue[type[T]], default: str | None) -> str:
    name = table.content.get(by, default)
    if name is None:
        raise table.fault("is missing", by)
    if not isinstance(name, str) or name not in catalogue:
        raise table.fault(f"must be one of {catalogue.names}", by)
    return name


def _own_fields(schema: type[msgspec.Struct], common: type[msgspec.Struct]) -> Sequence[str]:
    shared = {field.name for field in msgspec.structs.fields(common)}
    return [field.name for field in msgspec.structs.fields(schema) if field.name not in shared]


def _required(schema: type[msgspec.Struct]) -> Sequence[str]:
    return [field.name for field in msgspec.structs.fields(schema) if field.required]
