"""The page of the live view: a scene, a slider per joint, and the figures of the pose they make."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from ctrplan.reports import looks
from ctrplan.reports.html_page import FONT, KEY_STYLE, rendered, script
from ctrplan.reports.words import Markup, explained, term

if TYPE_CHECKING:
    from ctrplan.reports.live_state import LiveState

# The browser itself refuses everything but this server; plotly.js builds functions from strings.
POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:; "
    "connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
STYLE = f"""
:root {{ color-scheme: light; }}
* {{ box-sizing: border-box; }}
body {{ margin: 0; height: 100vh; display: grid; grid-template-columns: 340px minmax(0, 1fr); background: #f4f6f8;
  color: {looks.INK}; font: 15px/1.45 {FONT}; }}
aside {{ order: -1; padding: 20px 20px 28px; overflow-y: auto; background: #fff;
  border-right: 1px solid {looks.GRID}; }}
h1 {{ font-size: 1.25rem; line-height: 1.25; margin: 0 0 14px; overflow-wrap: anywhere; }}
.kicker {{ color: {looks.MUTED}; margin: 0; font-size: 0.85rem; }}
#bound {{ font-size: 2.3rem; font-weight: 700; line-height: 1.1; color: {looks.BOUND};
  font-variant-numeric: tabular-nums; }}
#meter {{ height: 8px; border-radius: 4px; background: {looks.GRID}; margin: 8px 0 14px; overflow: hidden; }}
#meter div {{ height: 100%; width: 0; border-radius: 4px; background: {looks.BOUND}; transition: width 80ms; }}
#state {{ border-left: 5px solid; border-radius: 5px; padding: 8px 12px; margin: 0 0 14px; background: #f8fafb;
  font-weight: 600; min-height: 2.9em; }}
.good {{ color: {looks.MET}; }} .bad {{ color: {looks.LIMIT}; }} .quiet {{ color: {looks.MUTED}; }}
.caution {{ color: {looks.CAUTION}; font-weight: 600; }}
label {{ display: grid; grid-template-columns: 1fr auto; margin: 0 0 10px; gap: 0 8px; align-items: baseline; }}
label input[type=range] {{ grid-column: 1 / 3; width: 100%; accent-color: {looks.SERIES[0]}; margin: 2px 0; }}
label input[type=number] {{ width: 92px; text-align: right; font: inherit; border: 1px solid {looks.GRID};
  border-radius: 4px; padding: 1px 4px; font-variant-numeric: tabular-nums; }}
table {{ width: 100%; border-collapse: collapse; margin: 6px 0 14px; }}
td {{ padding: 4px 0; border-bottom: 1px solid {looks.GRID}; }}
td + td {{ text-align: right; font-variant-numeric: tabular-nums; }}
.row {{ display: flex; gap: 6px; align-items: center; flex-wrap: wrap; margin: 4px 0 12px; }}
.row[hidden] {{ display: none; }} .row input[type=number] {{ width: 62px; font: inherit; padding: 2px 4px;
  border: 1px solid {looks.GRID}; border-radius: 4px; }} #base input {{ width: 92px; }} #time {{ flex: 1; }}
button {{ font: inherit; padding: 5px 12px; border-radius: 6px; border: 1px solid #c9d1d8; background: #fff;
  cursor: pointer; }}
button:hover {{ background: #eef2f5; }}
pre {{ background: #f4f6f8; border-radius: 6px; padding: 10px 12px; overflow-x: auto; font-size: 0.8rem; }}
{KEY_STYLE}
abbr {{ text-decoration: underline dotted {looks.MUTED} 1px; text-underline-offset: 3px; cursor: help; }}
details {{ margin-top: 14px; font-size: 0.9rem; }} summary {{ cursor: pointer; }} dt {{ font-weight: 600; }}
dd {{ margin: 0 0 8px; color: {looks.MUTED}; }}
#scene {{ width: 100%; height: 100vh; min-width: 0; }}
@media (max-width: 800px) {{ body {{ display: block; height: auto; }}
  #scene {{ height: 48vh; position: sticky; top: 0; z-index: 1; background: #fff;
    border-bottom: 1px solid {looks.GRID}; }}
  aside {{ border: 0; padding-top: 12px; }} }}
"""
ROWS = (
    ("bound_deg", explained("error of the direction", "By how much friction can turn the tip's direction.")),
    ("stability", term("stability")),
    ("strain_percent", term("strain", "largest strain")),
    ("nominal_mm", term("clearance", "clearance without friction")),
    ("friction_mm", term("clearance", "clearance, worst friction")),
    (
        "sure_mm",
        explained("same, allowances taken off", "Less what certificates take off for what is not proven."),
    ),
    ("tip_mm", "tip without friction"),
    ("target_free", "from the goal without friction"),
    ("target_worst", term("worst case at the target", "from the goal at worst")),
)
WORDS = ("worst-case friction error", "envelope of friction", "corner shapes", "clearance", "stability", "strain")


def live_page(state: LiveState) -> str:
    """The HTML of the page; its scripts come from the same server."""
    scenario, style = state.scenario, Markup(STYLE)
    return rendered(
        "live.html", name=scenario.name, robot=scenario.robot.name, rows=ROWS, LIVE_STYLE=style, WORDS=WORDS
    )


def scene_script(state: LiveState) -> str:
    """JavaScript that holds the figure and the sliders."""
    return (
        f"const FIGURE = {state.figure().to_json()};\nconst JOINTS = {json.dumps(state.sliders())};\n"
        f"const MOTION = {json.dumps(state.played())};\n"
    )


def live_script() -> str:
    """JavaScript that moves the robot."""
    return script("fit_camera.js") + script("scene_key.js") + script("live_view.js")
