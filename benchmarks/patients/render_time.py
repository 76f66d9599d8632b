"""How long does `ctrplan render` take for a picture of a plan, by camera?

    python benchmarks/run.py render_time out/plan.json [SCENARIO.toml]

Processor time of one process, of the first picture and the mean of the next ones. What stands still is drawn once where
the camera stands still too, and anew for each picture from inside.
"""

import sys
import time

import numpy as np
from common import table

from ctrplan.files.plan_file import load_plan
from ctrplan.reports.plan_scene import written_motion
from ctrplan.reports.render.camera import VIEWS
from ctrplan.reports.render.film import film

WIDTH, HEIGHT, PICTURES = 960, 720, 6


def main() -> None:
    motion, rows = written_motion(load_plan(*sys.argv[1:3], allow_outside=True), PICTURES), []
    for view in VIEWS:
        times = [time.process_time()]
        for _ in film(motion, view, WIDTH, HEIGHT):  # type: ignore[arg-type]
            times.append(time.process_time())
        first, *others = np.diff(times).tolist()
        rows.append((view, f"{first:.2f} s", f"{np.mean(others):.2f} s"))
    table(f"{motion.scenario.name}, {WIDTH} x {HEIGHT}", ("camera", "first picture", "each other"), rows)
