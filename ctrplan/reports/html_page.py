"""Pages that stand alone, from templates: everything in one file, nothing loaded from anywhere, every text escaped."""

from __future__ import annotations

import base64
import json
import math
import zlib
from collections.abc import Sequence
from functools import cache
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.package import __version__
from ctrplan.reports import looks, words
from ctrplan.reports.words import Markup

if TYPE_CHECKING:
    from jinja2 import Environment

# The browser itself refuses whatever would reach for the network; plotly.js builds functions from strings.
POLICY = "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:"

FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'
FIGURE_TEXT = {"color": looks.INK, "size": 13, "family": FONT}
BUTTONS_2D, BUTTONS_3D = ("toImage", "resetScale2d"), ("toImage",)  # none that leaves the page
KEY_STYLE = """#key, .scene-key { display: flex; flex-wrap: wrap; gap: 6px; margin: 0 0 12px; }
button { font: inherit; padding: 5px 12px; border-radius: 6px; border: 1px solid #c9d1d8; background: #fff;
  cursor: pointer; }
button:hover { background: #eef2f5; }
#key button, .scene-key button { padding: 1px 9px 1px 6px; font-size: 0.85rem; }
#key .off, .scene-key .off { opacity: 0.4; }
#key i, .scene-key i { display: inline-block; width: 11px; height: 11px; border-radius: 3px; margin-right: 6px; }"""
STYLE = f"""
:root {{ color-scheme: light; }}
body {{ margin: 0; background: #f4f6f8; color: {looks.INK}; line-height: 1.5;
  font-family: {FONT}; font-size: 16px; }}
main {{ max-width: 1180px; margin: 0 auto; padding: 28px 20px 60px; }}
h1 {{ font-size: 1.9rem; line-height: 1.2; margin: 0 0 14px; overflow-wrap: anywhere; }}
h2 {{ font-size: 1.2rem; margin: 0 0 4px; }}
p {{ margin: 6px 0 10px; max-width: 75ch; }}
.kicker {{ color: {looks.MUTED}; margin: 0 0 2px; font-size: 0.95rem; }}
.verdict {{ border-left: 6px solid; border-radius: 6px; padding: 12px 18px; margin: 0 0 18px; background: #fff;
  font-size: 1.1rem; font-weight: 600; max-width: none; }}
.good {{ color: {looks.MET}; }} .bad {{ color: {looks.LIMIT}; }}
.caution {{ color: {looks.CAUTION}; }} .quiet {{ color: {looks.MUTED}; }}
.tiles {{ display: flex; flex-wrap: wrap; gap: 12px; margin: 0 0 18px; }}
.tile {{ background: #fff; border-radius: 8px; padding: 12px 14px; flex: 1 1 110px; }}
.tile b {{ display: block; font-size: 1.5rem; line-height: 1.3; white-space: nowrap; }}
.tile > span {{ color: {looks.MUTED}; font-size: 0.9rem; }}
section {{ background: #fff; border-radius: 8px; padding: 18px 22px; margin: 0 0 18px; }}
table {{ border-collapse: collapse; width: 100%; font-size: 0.95rem; }}
th, td {{ text-align: left; vertical-align: top; padding: 6px 14px 6px 0; border-bottom: 1px solid {looks.GRID};
  overflow-wrap: anywhere; font-variant-numeric: tabular-nums; }}
th {{ color: {looks.MUTED}; font-weight: 600; overflow-wrap: break-word; }}
td.key {{ width: 30%; min-width: 7.5em; color: {looks.MUTED}; overflow-wrap: break-word; }}
code {{ font-size: 0.85rem; }}
.plot {{ margin: 8px -8px 0; }}
.scene {{ height: max(340px, min(640px, 100vh - 300px)); margin: 0; border-radius: 8px; overflow: hidden;
  background: radial-gradient(ellipse at 40% 35%, #ffffff 0%, #eef3f6 55%, #d9e2e8 100%); }}
.scene > div {{ height: 100%; }}
section.motion {{ padding: 0 0 14px; overflow: hidden; }}
section.motion > :not(.scene), section.motion > #key, section.motion > .scene-key {{ margin-left: 22px;
  margin-right: 22px; }}
section.motion .scene {{ border-radius: 8px 8px 0 0; }}
.player {{ display: flex; gap: 14px; align-items: center; margin: 12px 0 10px; }} .player input {{ flex: 1; }}
.looking {{ display: flex; flex-wrap: wrap; gap: 6px; align-items: center; margin: 0 0 10px; font-size: 0.9rem; }}
.looking button {{ padding: 2px 10px; }} .cut {{ display: flex; gap: 8px; align-items: center; margin-left: 8px; }}
.cut select {{ font: inherit; }} .cut input {{ width: 120px; }}
.player button {{ width: 7em; font-weight: 600; color: #fff; background: {looks.SERIES[0]}; border: 0; }}
.player button:hover {{ background: #005a8e; }}
output {{ min-width: 3.5em; text-align: right; }} output, .moment b {{ font-variant-numeric: tabular-nums; }}
.moment {{ display: flex; flex-wrap: wrap; gap: 4px 40px; }} .moment > div {{ margin: 0 0 10px; }}
.moment b {{ display: block; font-size: 1.5rem; line-height: 1.2; }}
.moment span {{ color: {looks.MUTED}; font-size: 0.9rem; }} .moment b.bound {{ color: {looks.BOUND}; }}
.small {{ font-size: 0.85rem; }} .hint {{ margin-bottom: 0; max-width: none; }}
.whole {{ white-space: nowrap; }} .wide {{ overflow-x: auto; }} .wide th, .wide td {{ overflow-wrap: break-word; }}
{KEY_STYLE}
abbr {{ text-decoration: underline dotted {looks.MUTED} 1px; text-underline-offset: 3px; cursor: help; }}
details {{ margin: 10px 0 0; }} summary {{ cursor: pointer; color: {looks.MUTED}; }}
dt {{ font-weight: 600; }} dd {{ margin: 0 0 8px; color: {looks.MUTED}; max-width: 75ch; }}
@media (max-width: 800px) {{
  main {{ padding: 16px 10px 40px; }} section {{ padding: 14px 14px; }} h1 {{ font-size: 1.5rem; }}
  .verdict {{ font-size: 1rem; padding: 10px 14px; }} .tile {{ padding: 8px 12px; }} .tile b {{ font-size: 1.25rem; }}
  .tiles {{ gap: 8px; }} .tile {{ flex-basis: 140px; }}
  section.motion {{ padding: 0 0 10px; }}
  section.motion > :not(.scene), section.motion > #key, section.motion > .scene-key {{ margin-left: 14px;
    margin-right: 14px; }}
  .scene {{ height: 46vh; min-height: 300px; }}
  .wide th, .wide td {{ min-width: 4.2em; }}
  .moment {{ gap: 12px; }} .moment > div {{ flex: 1; }} .moment b {{ font-size: 1.15rem; }}
  .moment span {{ font-size: 0.8rem; }} table {{ font-size: 0.85rem; }} th, td {{ padding-right: 8px; }}
  .cut {{ margin-left: 0; }} #key button, .scene-key button {{ font-size: 0.78rem; }}
  .stack thead, .named thead {{ display: none; }} .stack tr, .named tr {{ display: flex; flex-wrap: wrap;
    gap: 0 18px; padding: 7px 0; border-bottom: 1px solid {looks.GRID}; }}
  .wide.stack td, .wide .named td {{ border: 0; padding: 0; min-width: 0; }} .stack td:empty {{ display: none; }}
  .stack td:first-child, .named td:first-child {{ flex-basis: 100%; color: {looks.MUTED}; }}
  .named td:not(:first-child):not(:empty)::before {{ content: attr(data-name) " "; color: {looks.MUTED}; }}
}}
@media print {{ body {{ background: #fff; font-size: 11pt; }} section, .tile {{ padding: 8px 0; }}
  section, tr {{ break-inside: avoid; }} }}
"""


def script(name: str) -> str:
    """The content of a JavaScript file of this package."""
    return (files("ctrplan.reports") / "scripts" / name).read_text(encoding="utf-8")


def plot(
    figure: Any,
    name: str,
    *,
    frames: Sequence[dict[str, Any]] = (),
    with_library: bool = False,
    script: str | None = None,
    kind: str = "plot",
) -> Markup:
    """A plotly figure in an element called `name`; the first one on a page brings plotly.js with it.

    The figure is plotly's or a plain object of data and layout. `frames` are those of a moving figure, plain objects
    with arrays. `script` runs once the figure stands. A figure without a height fills that of `kind`, a class of the
    style. Texts of the figure must be escaped by whoever made it.
    """
    layout = figure["layout"]
    buttons = BUTTONS_3D if "scene" in layout else BUTTONS_2D
    config = json.dumps({"displaylogo": False, "responsive": True, "modeBarButtons": [list(buttons)]})
    height = f"{layout['height']}px" if "height" in layout and layout["height"] else "100%"
    place = f'<div id="{name}" class="plotly-graph-div" style="height:{height}; width:100%;"></div>'
    call = f'drawn("{name}", "{packed(figure_json(figure, frames))}", {config}).then(() => {{{script or ""}\n}});'
    first = f"<script>{_library()}</script>" if with_library else ""
    return Markup(f'<div class="{kind}">{first}{place}<script>{call}</script></div>')


def figure_json(figure: Any, frames: Sequence[dict[str, Any]] = ()) -> str:
    """A figure, plotly's or a plain object, with the frames of its motion."""
    text: str = json.dumps(figure, default=_typed_array) if isinstance(figure, dict) else figure.to_json()
    return f'{text[:-1]},"frames":{json.dumps(list(frames), default=_typed_array)}}}' if frames else text


def _typed_array(values: NDArray[np.float32 | np.int32]) -> dict[str, str]:
    """Numbers of single precision as plotly.js reads them."""
    kind = f"{values.dtype.kind}4"
    return {"dtype": kind, "bdata": base64.b64encode(values.astype(f"<{kind}").tobytes()).decode("ascii")}


def packed(text: str) -> str:
    """Compressed, in letters and digits: packed.js makes the text of it again."""
    return base64.b64encode(zlib.compress(text.encode(), looks.LEVEL)).decode("ascii")


@cache
def _library() -> str:
    """plotly.js, a third of its size. Its file is found without an import of plotly, which takes as long as packing."""
    library = Path(str(distribution("plotly").locate_file("plotly/package_data/plotly.min.js")))
    return f'{script("packed.js")}\nconst plotly = library("{packed(library.read_text(encoding="utf-8"))}");\n'


def scene_script(plot: str, key: str, *calls: str, files: Sequence[str] = ()) -> str:
    """What gives a scene its key and keeps it fitted, once all of the page stands.

    plot, key: elements of the scene and of its key. calls: what else is called, of `files` of this package, with the
    scene as `plot`.
    """
    begin = [f"addKey(plot, document.getElementById('{key}'))", "keepFitted(plot)", *calls]
    body = f"const plot = document.getElementById('{plot}'); {'; '.join(begin)};"
    return "".join(map(script, ("fit_camera.js", "scene_key.js", *files))) + (
        f"\nfunction start() {{ {body} }}\n"
        "if (document.readyState === 'loading') document.addEventListener('DOMContentLoaded', start); else start();\n"
    )


@cache
def _templates() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined  # when a page is made and not before

    loader = PackageLoader("ctrplan.reports")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.globals.update(
        {name: getattr(words, name) for name in ("TERMS", "term", "millimetres", "degrees", "digits")}
    )
    environment.globals.update(POLICY=Markup(POLICY), STYLE=Markup(STYLE), version=__version__)
    environment.filters["abs"], environment.tests["finite"] = abs, math.isfinite
    return environment


def rendered(template: str, **content: Any) -> Markup:
    """A page, or a part of one, from a file of the folder templates; a name that it does not know is an error."""
    return Markup(_templates().get_template(template).render(content))
