"""The effect that a table [effects.NAME] of a robot file is: of the catalogue, or a term that was built."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ctrplan.effects.effect import CATALOGUE, Effect
from ctrplan.effects.learned import table as learned_table

COMMON_NOTES = ("ci95", "provenance")  # keys of any effect's table that say where its values come from
NOTES = (*COMMON_NOTES, *learned_table.NOTES)  # keys that are no parameters


def effect_of(name: str, table: Mapping[str, Any], n: int) -> Effect:
    """Of a table that was checked, in the file of a robot with n tubes."""
    return learned_table.learned_in(name, table, COMMON_NOTES, n) if learned_table.is_learned(name) else CATALOGUE[name]
