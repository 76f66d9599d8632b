"""How sure the tip is when friction is 0.1 to 0.3: friction_ventricle.toml and docs/images/friction_range.png.

python benchmarks/run.py friction_sensitivity FOLDER    # 1,152 bounds of as many robots, some 15 s of a core
"""

import common
import numpy as np
from common import STUDIES, panels, save

import ctrplan
from ctrplan.reports import looks
from ctrplan.studies.study.table import Sensitivity, sensitivity

STUDY = STUDIES / "friction_ventricle.toml"
FRICTION = ("contact.1.friction_coefficient", "contact.2.friction_coefficient")
SHARES = (0.05, 0.5, 0.95)


def print_numbers(table: ctrplan.StudyTable, found: Sensitivity) -> None:
    bound = table["bound_mm"]
    known = bound[np.isfinite(bound)]
    at = ", ".join(f"{share:.0%}: {value:.2f}" for share, value in zip(SHARES, np.quantile(known, SHARES), strict=True))
    print(f"{len(table)} robots, {len(known)} with a bound; bound (mm) at {at}; {known.min():.2f} to {known.max():.2f}")
    for k in np.argsort(-found.total).tolist():
        shares = f"with others {found.total[k]:.3f} +- {found.total_interval[k]:.3f}"
        print(f"  {found.keys[k]:38} alone {found.first[k]:6.3f}  {shares}")


def draw(table: ctrplan.StudyTable, found: Sensitivity) -> None:
    figure, ((cloud, bars),) = panels(1, 2, (10, 3.6))
    cloud.scatter(table[FRICTION[1]], table["bound_mm"], s=5, color=looks.SERIES[0], linewidths=0)
    cloud.set(xlabel="friction between the inner two tubes", ylabel="worst-case friction error (mm)", ylim=(0, None))
    order, colour = np.argsort(found.total), looks.SERIES[0]
    bars.barh([found.keys[k] for k in order], found.total[order], xerr=found.total_interval[order], color=colour)
    bars.set_xlabel("share of the variance, with all others")
    bars.tick_params(axis="y", labelsize=8)
    save(figure, "friction_range")


def main() -> None:
    given = common.arguments(__doc__, "folder")
    study = ctrplan.Study.read(STUDY)
    table = study.run(given.folder, workers=1)
    found = sensitivity(study, table, "bound_mm")
    assert found is not None
    print_numbers(table, found)
    draw(table, found)
