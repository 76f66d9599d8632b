"""Whether the bound field of a scenario's robot helps to plan it, as `ctrplan plan` measures it.

python benchmarks/field_worth.py scenarios/ribs.toml scenarios/ventricle.toml      # builds missing fields: minutes
"""

from __future__ import annotations

import sys

import ctrplan
from ctrplan.motion.bound_table import tabulated_bounds
from ctrplan.planning.table_worth import table_worth


def main() -> None:
    for path in sys.argv[1:]:
        scenario = ctrplan.load_scenario(path)
        table = tabulated_bounds(scenario.robot)
        assert table is not None
        error = table.error
        print(
            f"{scenario.name}: {scenario.robot.name}, {error.margin_m * 1e3:.2f} mm added to bounds whose median is "
            f"{table.median_m * 1e3:.2f} mm, {100 * error.uncovered:.1f} % without an answer"
        )
        print(f"  {table_worth(scenario, table).sentence}")


if __name__ == "__main__":
    main()
