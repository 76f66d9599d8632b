"""Writes docs/effects.md from the catalogue: python tools/effects_page.py > docs/effects.md"""

from __future__ import annotations

from pathlib import Path

from ctrplan.diagnosis import CATALOGUE, Effect
from ctrplan.files.robot_file import load_robot

ROBOT = Path(__file__).parents[1] / "scenarios" / "robots" / "three_tube.toml"
STAGES = ("clock", "drive", "mechanics", "sensor")
HEAD = """\
# Catalogue of effects

An effect is something that a real robot has and the ideal model lacks. Each one is a term of one stage of the chain

    commanded joint path -> clock -> drive -> mechanics -> sensor -> measured pose

A table `[effects.NAME]` of a robot file switches it on, with the parameters below. Every parameter has the unit that
its name ends with. What is left out does nothing. Priors and ranges are those of the three-tube robot of Table II. A
*prior* is the standard deviation of what is plausible.

A robot file with effects is the same robot to every command. Effects of drive and mechanics act in `ctrplan bound`,
`ik`, `view`, `plan`, `simulate` and in sweeps. Those of clock and sensor move no tube at rest: `ctrplan simulate`
writes what would be measured (`measured_x_m` ...) beside where the tip is.

Backlash depends on the way. `ctrplan simulate` follows it along its path. `ctrplan bound` and plans say how far it
may move the robot, and plans take that off every clearance.

Effects that turn the front plate (`plate_clearance`, `plate_compliance`, `bent_base`) act in fits and on what
`simulate` writes as measured. Bounds and shapes stand on a plate that keeps still; the largest turn times the robot's
length is added to `model_error_mm`. Effects of speed, rest and use (`friction_speed`, `relaxation`,
`precurvature_loss`) act in fits: a shape at rest is that of full friction and of the tubes as they were at the last
pose. Bounds hold for less.

This page is made by `python tools/effects_page.py` from the files under `ctrplan/effects/`. How to write another
effect: [diagnosis](diagnosis.md#a-new-effect).
"""


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    for stage in STAGES:
        parts.append(f"## {stage.capitalize()}\n")
        parts += [_section(effect) for effect in CATALOGUE.values() if effect.stage == stage]
    return "\n".join(parts)


def _section(effect: Effect) -> str:
    rows = [
        f"| `{p.name}` | {p.prior:g} | {p.neutral:g} | {_limit(p.lower)} to {_limit(p.upper)} |"
        for p in effect.parameters(load_robot(ROBOT))
    ]
    shown = rows if len(rows) <= 9 else [*rows[:4], f"| ... {len(rows)} in all | | | |"]
    table = ["| parameter | prior | vanishes at | range |", "|---|---|---|---|", *shown]
    facts = {
        "equation": effect.equation,
        "signature": effect.signature,
        "looks like": ", ".join(effect.look_alikes) or "none",
        "what separates it": effect.experiment,
    }
    if effect.needs:
        facts["needs"] = effect.needs
    items = "\n".join(f"- *{name}* {text}" for name, text in facts.items())
    return f"### {effect.name}\n\n{items}\n\n" + "\n".join(table) + "\n"


def _limit(value: float) -> str:
    return f"{value:g}".replace("inf", "∞")


if __name__ == "__main__":
    print(page(), end="")
