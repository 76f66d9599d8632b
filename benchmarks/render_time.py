"""How long does `ctrplan render` take for a picture of a plan, by camera?

    python benchmarks/render_time.py out/plan.json [SCENARIO.toml]

Processor time of one process, of the first picture and the mean of the next ones. What stands still is drawn once where
the camera stands still too, and anew for each picture from inside.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from ctrplan.files.plan_file import load_plan
from ctrplan.reports.render.camera import VIEWS
from ctrplan.reports.render.film import film
from ctrplan.reports.written_motion import written_motion

WIDTH, HEIGHT, PICTURES = 960, 720, 6


def main() -> None:
    motion = written_motion(load_plan(*sys.argv[1:3], allow_outside=True), PICTURES)
    print(f"{motion.scenario.name}, {WIDTH} x {HEIGHT}")
    for view in VIEWS:
        times = [time.process_time()]
        for _ in film(motion, view, WIDTH, HEIGHT):  # type: ignore[arg-type]
            times.append(time.process_time())
        first, *others = np.diff(times).tolist()
        print(f"{view:8} first {first:.2f} s, others {np.mean(others):.2f} s")


if __name__ == "__main__":
    main()
