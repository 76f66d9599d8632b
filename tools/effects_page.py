"""Writes docs/effects.md from the catalogue: python tools/effects_page.py > docs/effects.md"""

from __future__ import annotations

import textwrap
from pathlib import Path

from ctrplan.diagnosis import CATALOGUE, Effect
from ctrplan.effects.learned.inputs import KINDS
from ctrplan.files.robot_file import load_robot

ROBOT = Path(__file__).parents[1] / "scenarios" / "robots" / "three_tube.toml"
STAGES = ("clock", "drive", "mechanics", "sensor")
HEAD = """\
# Catalogue of effects

An effect is something that a real robot has and the ideal model lacks. Each one is a term of one stage of the chain

    commanded joint path -> clock -> drive -> mechanics -> sensor -> measured pose

A table `[effects.NAME]` of a robot file switches it on, with the parameters below. Every parameter has the unit that
its name ends with, and vanishes at 0 unless another value is given. Priors (the standard deviation of what is
plausible) and ranges are those of the three-tube robot of Table II. The *experiment* separates look-alikes.

A robot file with effects is the same robot to every command. What an effect does there:

| effects | bounds, shapes, `ik`, `view`, sweeps, plans | `ctrplan simulate`, fits |
|---|---|---|
| drive, mechanics | act | act |
| clock, sensor | move no tube | act on what is measured (`measured_x_m` ...) |
| `backlash` | stated as play; plans take it off every clearance | followed along the path |
| `plate_clearance`, `plate_compliance`, `bent_base` | add the largest turn times the length to `model_error_mm` | act |
| `friction_speed`, `relaxation`, `precurvature_loss` | full friction, tubes as at the last pose | act in fits |
| `homing_shift` | an interval: any later homing | acts on logs |

`python tools/effects_page.py` makes this page from the catalogue. How to write another effect:
[extending](extending.md#an-effect).
"""

BUILT = """\
## Built terms

A diagnosis builds a term of what no effect explains ([how](diagnosis.md#built-a-term-for-what-nobody-has-named)).
It stands in a robot file as `[effects.learned_NAME]`, where NAME says what it acts on:
"""
AFTER = """
`learned_theta_I_way` and `learned_l_I_way` are those that depend on the sign of the last motion. An example:

```toml
[effects.learned_theta_2]
stage = "drive"
acts_on = "the rotation of tube 2"
formula = "the rotation of tube 2 changes by 3.1 deg sin(3 theta_2) - 1.2 deg cos(3 theta_2)"
may_be = "acts in the drive on the rotation of tube 2 with a period of 120 deg, ..."
sin_3_theta_2_deg = 3.1
cos_3_theta_2_deg = -1.2
[effects.learned_theta_2.range]
theta_2 = [-180, 180]
[effects.learned_theta_2.ci95]
sin_3_theta_2_deg = [2.9, 3.3]
cos_3_theta_2_deg = [-1.4, -1.0]
```

A key is `PART_UNIT`, or `AXIS_PART_UNIT` (x, y, z) of the plate and the sensor; its value is the largest amount of
that part. A part is a product, joined by `_times_`, of

- `sin_K_INPUT`, `cos_K_INPUT`: K waves a turn of an angle; `sin_K_over_time`: K half waves over the time;
- `slope_INPUT`, `square_INPUT`: -1 to 1 over the range, and its square;
- `knot_J_of_M_INPUT`: a natural cubic spline, 1 at the J-th of M knots over the range and 0 at the others;
- `bump_J_of_M_INPUT`: a Gaussian at such a knot;
- `sign_theta_I`, `sign_l_I`: of the last motion; `constant`.

Inputs are `theta_I` [deg], `turn_I` (tube I against the one around it) [deg], `l_I` [mm], `overlap_I` (of the
curved parts of tubes I and I + 1) [mm], `load_I` (friction state of a pair), `speed_I` [deg/s], `rest` [s], the
tip's `x, y, z` [mm] and `tx, ty, tz`, and columns of the data. `formula`, `may_be`, `stage`, `acts_on` and
`largest_mm` are comments.

Outside its range an input is held at the edge; every command says so. Terms of the drive know the first three, and act
in bounds, shapes and plans. Those of the mechanics act in fits; in bounds and plans a property is anything up to its
most, and the largest tilt times the robot's length is added to `model_error_mm`. Those of the sensor act on what is
measured. A column not given is at the middle of its range; without time, waves over it are nothing.
"""


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    for stage in STAGES:
        parts.append(f"## {stage.capitalize()}\n")
        parts += [_section(effect) for effect in CATALOGUE.values() if effect.stage == stage]
    return "\n".join([*parts, _built()])


def _built() -> str:
    rows = [
        f"| `learned_{name}{'' if kind.has_axes else '_I'}` | {kind.stage} | {kind.words.format('I')} | {kind.unit} |"
        for name, kind in KINDS.items()
    ]
    return "\n".join([BUILT, "| table | stage | acts on | unit |", "|---|---|---|---|", *rows, AFTER])


def _section(effect: Effect) -> str:
    facts = {
        "equation": effect.equation,
        "signature": effect.signature,
        "looks like": ", ".join(effect.look_alikes) or "none",
        "experiment": effect.experiment,
    }
    if effect.needs:
        facts["needs"] = effect.needs
    items = [f"- *{name}* {text}" for name, text in facts.items()]
    return "\n".join([f"### {effect.name}\n", *items, *_parameters(effect)]) + "\n"


def _parameters(effect: Effect) -> list[str]:
    """The parameters, those with the same prior, neutral value and range together."""
    groups: dict[str, list[str]] = {}
    for p in effect.parameters(load_robot(ROBOT)):
        neutral = f", vanishes at {p.neutral:g}" if p.neutral else ""
        numbers = f"prior {p.prior:g}{neutral}, range {_limit(p.lower)} to {_limit(p.upper)}"
        groups.setdefault(numbers, []).append(f"`{p.name}`")
    line = "- *parameters* " + "; ".join(f"{_some(names)}: {numbers}" for numbers, names in groups.items())
    return textwrap.wrap(line, 120, subsequent_indent="  ", break_on_hyphens=False)


def _some(names: list[str]) -> str:
    shown = names if len(names) <= 6 else [*names[:2], f"... {names[-1]} ({len(names)} in all)"]
    return ", ".join(shown)


def _limit(value: float) -> str:
    return f"{value:g}".replace("inf", "∞")


if __name__ == "__main__":
    print(page(), end="")
