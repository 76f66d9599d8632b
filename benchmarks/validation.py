"""Does the model reproduce the paper's numerical experiments? Figures and tables of docs/validation.md.

python benchmarks/validation.py [--write]     figures go to docs/images/validation, --write puts tables into the page

Tables whose figures are enough for the page are printed only.

Figure and table numbers are those of Ha, Fagogenis, Dupont, IEEE T-RO 35(2), 2019. Hollow markers in the figures and
"exact" in the tables are values of an independent exact-geometry solver (tests/reference/pair_values.json).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from page_table import put_into_page
from paper_figures.clear_tube import fig_17
from paper_figures.clearance_and_friction import fig_4_5, fig_6_7
from paper_figures.contact_forces import fig_10_13, fig_11_12, fig_13
from paper_figures.three_tubes import fig_14, table_3
from paper_figures.transmission import fig_8, fig_9

PAGE = Path(__file__).resolve().parents[1] / "docs" / "validation.md"
BEGIN, END = "<!-- table: {} -->\n", "<!-- end of table -->"

TABLES: dict[str, Callable[[], str]] = {
    "fig_4_5": fig_4_5,
    "fig_6_7": fig_6_7,
    "fig_8": fig_8,
    "fig_9": fig_9,
    "fig_10_13": fig_10_13,
    "fig_11_12": fig_11_12,
    "fig_13": fig_13,
    "table_3": table_3,
    "fig_14": fig_14,
    "fig_17": fig_17,
}
# Printed only: the page has their figures.
FIGURE_ONLY = ("fig_4_5", "fig_8", "fig_9", "fig_11_12", "fig_13", "fig_14", "fig_17")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="put the tables into docs/validation.md")
    write = parser.parse_args().write
    for name, make in TABLES.items():
        text = make()
        print(f"\n{name}\n{text}", end="", flush=True)
        if write and name not in FIGURE_ONLY:
            put_into_page(PAGE, BEGIN.format(name), text, END)


if __name__ == "__main__":
    main()
