"""Renews the figures of the certificate in docs/plan.schema.json: python tools/plan_schema.py [FILE]

What is said of a figure is in the table of figures, the class `Certificate`; all else of the schema is written by hand.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import fields
from pathlib import Path
from textwrap import fill
from typing import Any

from ctrplan.certificate.certificate import FIGURES, Certificate, Figure

SCHEMA = Path(__file__).resolve().parents[1] / "docs" / "plan.schema.json"
ELSEWHERE = ("settling", "end_states", "spare_m", "walk_again")  # fields that are no keys of "certificate"
WIDTH = 120


def renewed(schema: dict[str, Any]) -> dict[str, Any]:
    """The schema with the present figures; keys are in the order of the fields."""
    certificate = schema["properties"]["certificate"]
    written, names = certificate["properties"], [entry.name for entry in fields(Certificate)]
    names = [name for name in names if name not in ELSEWHERE]
    certificate["required"] = names
    certificate["properties"] = {
        name: entry(FIGURES[name]) if name in FIGURES and FIGURES[name].unit else written[name] for name in names
    }
    return schema


def entry(figure: Figure) -> dict[str, Any]:
    """A figure's own schema."""
    described = {"description": figure.description} if figure.description else {}
    kind = {"type": "integer", "minimum": 0} if figure.unit == "count" else {"$ref": "#/$defs/number_or_null"}
    return {**described, **kind}


def laid_out(value: Any, indent: int = 0, before: int = 0) -> str:
    """JSON on one line where it fits, else an entry a line, or as many as fit where they are words."""
    line = json.dumps(value, ensure_ascii=False)
    if not isinstance(value, (dict, list)) or not value or indent + before + len(line) < WIDTH:
        return line
    keys = [f"{json.dumps(key)}: " for key in value] if isinstance(value, dict) else [""] * len(value)
    items = value.values() if isinstance(value, dict) else value
    rows = [
        " " * (indent + 2) + key + laid_out(item, indent + 2, len(key)) for key, item in zip(keys, items, strict=True)
    ]
    if all(isinstance(item, str) and " " not in item for item in value) and isinstance(value, list):
        pad = " " * (indent + 2)
        rows = [fill(", ".join(map(json.dumps, value)), WIDTH, initial_indent=pad, subsequent_indent=pad)]
    opening, closing = "{}" if isinstance(value, dict) else "[]"
    return f"{opening}\n" + ",\n".join(rows) + f"\n{' ' * indent}{closing}"


def main() -> None:
    """Renews the schema in its place, or writes it to the file that is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", nargs="?", type=Path, default=SCHEMA)
    schema = renewed(json.loads(SCHEMA.read_text(encoding="utf-8")))
    parser.parse_args().file.write_text(laid_out(schema) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
