"""The first thing to see in report.html: the robot in motion, and what friction makes of it at each moment."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.planning.plan_timing import sample_time_s
from ctrplan.reports.glossary import term
from ctrplan.reports.html_page import Markup, plot, script, section, tag
from ctrplan.reports.plan_page.looking import looking_places
from ctrplan.reports.plan_page.other_ways import other_ways
from ctrplan.reports.plan_page.panels import CURSOR
from ctrplan.reports.plan_page.scene import scene_figure
from ctrplan.reports.plan_words.numbers import millimetres

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array
    from ctrplan.reports.plan_scene import PlanScene

SCRIPTS = ("fit_camera.js", "scene_key.js", "plan_page/player.js", "plan_page/looking.js")
CURVES = ("margins", "joints")  # where the time is marked
SHORTEST_FRAME_MS, LONGEST_FRAME_MS = 60, 200  # a motion plays in real time where that is neither jerky nor dull
HINT = "Drag to turn, scroll to zoom; a click on a name hides a part. The time is marked on the curves below."


def motion_section(scene: PlanScene) -> Markup:
    """Scene and player, figures of the moment, and what other ways to the same goal would leave."""
    code = "".join(map(script, SCRIPTS)) + _starting(scene)
    figure = scene_figure(scene)
    drawn = plot(figure, "scene", with_library=True, script=code, kind="plot scene")
    left = tag("div", drawn, _controls(scene), Markup('<div id="looking" class="looking"></div><div id="key"></div>'))
    right = tag("div", _figures(scene), other_ways(scene.plan), kind="beside")
    hint = tag("p", HINT + _thinned(scene, figure), kind="quiet hint")
    return section("The motion", tag("div", left, right, kind="motion"), hint)


def moments(scene: PlanScene) -> dict[str, list[str]]:
    """Texts for each pose of the path, by the id of the element that shows them."""
    samples = scene.plan.certificate.samples
    times, at = sample_time_s(scene.plan), np.array([step.time_s for step in scene.path])
    columns = {"bound": samples.bound_m, "predicted": samples.predicted_m, "clearance": samples.clearance_m}
    return {f"now_{name}": [_length(value) for value in _then(times, column, at)] for name, column in columns.items()}


def _then(times: Array, column: Array, at: Array) -> list[float]:
    """A column of the certificate at other times; infinite where all of it is."""
    return np.interp(at, times, column).tolist() if np.isfinite(column).all() else [float(column[0])] * len(at)


def _length(value_m: float) -> str:
    return "free space" if value_m == np.inf else millimetres(value_m)


def _controls(scene: PlanScene) -> Markup:
    last = len(scene.path) - 1
    if not last:
        return Markup()
    return Markup(
        '<div class="player"><button id="play" type="button">▶ Play</button>'
        f'<input id="time" type="range" min="0" max="{last}" value="0" step="1" aria-label="time">'
        f'<output id="now">{scene.start.time_s:.1f} s</output></div>'
    )


def _figures(scene: PlanScene) -> Markup:
    """Of the first frame; the player changes them."""
    first = {name: values[0] for name, values in moments(scene).items()}
    rows = (
        ("now_bound", term("worst-case friction error", "worst-case friction error now"), "large bound"),
        ("now_predicted", term("predicted friction error", "predicted friction error now"), "large"),
        ("now_clearance", term("clearance", "clearance beyond the margins now"), "large"),
    )
    return tag(
        "div",
        *(
            tag("div", Markup(f'<b id="{name}" class="{kind}">{first[name]}</b>'), tag("span", label))
            for name, label, kind in rows
        ),
        kind="moment",
    )


def _thinned(scene: PlanScene, figure: Any) -> str:
    """What is drawn of a fine mesh; distances are those of all its triangles."""
    whole = sum(len(part.shape.surface().faces) for part in scene.plan.scenario.anatomy)
    drawn = sum(len(trace.i) for trace in figure.data if trace.meta and "wall" in trace.meta)
    if drawn == whole:
        return ""
    return f" The anatomy is drawn in {drawn:,} of its {whole:,} triangles; distances are to all of them."


def _starting(scene: PlanScene) -> str:
    """What runs once the scene and all of the page stand."""
    calls = ["addKey(plot, document.getElementById('key'))", "keepFitted(plot)"]
    calls.append(f"addLooking(plot, {json.dumps(looking_places(scene))})")
    if len(scene.path) > 1:
        calls.append(f"addPlayer(plot, {json.dumps(_motion(scene))})")
    body = f"const plot = document.getElementById('scene'); {'; '.join(calls)};"
    return (
        f"\nfunction start() {{ {body} }}\n"
        "if (document.readyState === 'loading') document.addEventListener('DOMContentLoaded', start); else start();\n"
    )


def _motion(scene: PlanScene) -> dict[str, Any]:
    """What player.js needs to know."""
    path, duration_s = scene.path, scene.plan.trajectory.duration_s
    return {
        "frames": [f"{step.time_s:.3f}" for step in path],
        "time_s": [step.time_s for step in path],
        "figures": moments(scene),
        "curves": CURVES,
        "cursor": CURSOR,
        "step_ms": float(np.clip(1e3 * duration_s / (len(path) - 1), SHORTEST_FRAME_MS, LONGEST_FRAME_MS)),
    }
