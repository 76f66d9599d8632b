"""What does path history do to a robot, and is its simulation right? Figures and tables of docs/history.md.

    python benchmarks/history.py [--write] [--histories N] [section_v] [loop] [bound] [release] [numerics]

All sections if none is named. `bound` simulates 2,000 random histories, which takes tens of minutes; with --histories N
of each robot.
"""

from __future__ import annotations

import argparse

from history_bound import HISTORIES, bound
from history_numerics import numerics
from history_release import release
from history_section_v import loop, section_v


def main() -> None:
    sections = {"section_v": section_v, "loop": loop, "bound": bound, "release": release, "numerics": numerics}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=", ".join(sections))
    parser.add_argument("--write", action="store_true", help="put figures and tables into docs/history.md")
    parser.add_argument("--histories", type=int, default=HISTORIES, help="random histories of each robot")
    given = parser.parse_args()
    if unknown := set(given.sections) - set(sections):
        parser.error(f"no section {', '.join(sorted(unknown))}")
    for name in given.sections or sections:
        if name == "bound":
            bound(given.write, given.histories)
        else:
            sections[name](given.write)


if __name__ == "__main__":
    main()
