"""The live view's server: one robot on a port of this machine, for the page that the program opened and nothing else.

One loop of asyncio answers, one request a connection. Python's http.server has a thread for each connection and keeps
clients that send a byte now and then; what viser lets other pages do is told in docs/dependencies.md.
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import secrets
import socket
import sys
import threading
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from http import HTTPStatus
from http.client import HTTPException, HTTPMessage, parse_headers
from types import TracebackType
from typing import TYPE_CHECKING, Any
from urllib.parse import SplitResult, parse_qs, urlsplit

from ctrplan.errors import CtrplanError, InputError
from ctrplan.reports import looks
from ctrplan.reports.html_page import FONT, KEY_STYLE, figure_json, rendered, script
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
#scene {{ width: 100%; height: 100vh; min-width: 0;
  background: radial-gradient(ellipse at 40% 35%, #ffffff 0%, #eef3f6 55%, #d9e2e8 100%); }}
@media (max-width: 800px) {{ body {{ display: block; height: auto; }}
  #scene {{ height: 48vh; position: sticky; top: 0; z-index: 1;
    border-bottom: 1px solid {looks.GRID}; }}
  aside {{ border: 0; padding-top: 12px; }} }}
"""
ROWS = (
    ("bound_deg", explained("error of the direction", "By how much friction can turn the tip's direction.")),
    ("stability", term("stability")),
    ("other_shape", explained("another stable shape", "Whole turns may have led there: the same joints, another tip.")),
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
        f"const FIGURE = {figure_json(state.figure())};\nconst JOINTS = {json.dumps(state.sliders())};\n"
        f"const MOTION = {json.dumps(state.played())};\n"
    )


def live_script() -> str:
    """JavaScript that moves the robot."""
    return script("fit_camera.js") + script("scene_key.js") + script("live_view.js")


ADDRESS = "127.0.0.1"
SOLVERS = 2  # threads that solve poses; requests wait in line for them
LONGEST_HEAD = 16_384  # bytes of a request
HEAD_S, SEND_S = 5.0, 30.0  # that a client may take to ask, and to take the answer
ENDING_S = 0.1  # until a shutdown is noticed
MOST_CONNECTIONS = 800  # at once, all of them answered; fewer than the files a program may have open
SLOW_REQUEST = (asyncio.TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError)
HEADERS = {
    "Connection": "close",
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Resource-Policy": "same-origin",  # no script, image or frame of a page elsewhere
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
OWN_PAGES = ("", "none", "same-origin")  # Sec-Fetch-Site: of old browsers, typed by hand, asked by the page itself
HTML, SCRIPT = "text/html; charset=utf-8", "text/javascript; charset=utf-8"


class LiveServer:
    """Serves the page, plotly.js and poses on a port of 127.0.0.1; 0 takes a free one."""

    def __init__(self, state: LiveState, port: int = 0) -> None:
        """Raises InputError where the port can't be had."""
        self.state = state
        self.token = secrets.token_urlsafe(24)  # of the address, another one for each start of the program
        self.pages = _pages(state)
        self.connections = 0
        try:
            self.socket = socket.create_server((ADDRESS, port), backlog=MOST_CONNECTIONS)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"can't be listened on ({reason})", key="--port", value=port) from None
        self.server_address: tuple[str, int] = self.socket.getsockname()
        self.solvers = ThreadPoolExecutor(SOLVERS, thread_name_prefix="pose")
        self._ended = threading.Event()

    def __enter__(self) -> LiveServer:
        """Itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Gives the port back."""
        self.socket.close()
        self.solvers.shutdown(wait=False, cancel_futures=True)

    @property
    def url(self) -> str:
        """Where the page is; whoever does not know all of it gets nothing."""
        return f"http://{ADDRESS}:{self.server_address[1]}/{self.token}/"

    def serve_forever(self) -> None:
        """Answers until `shutdown` or Ctrl-C, in a thread of its own: an interrupt never lands in the midst of it.

        It is waited for by its result: a `Thread.join` that was interrupted takes the thread for ended (Python 3.11).
        """
        with ThreadPoolExecutor(1, thread_name_prefix="live view") as answering:
            ended = answering.submit(asyncio.run, self._serve())
            try:
                ended.result()
            finally:
                self.shutdown()

    def shutdown(self) -> None:
        """Ends `serve_forever`, from another thread."""
        self._ended.set()

    async def _serve(self) -> None:
        server = await asyncio.start_server(self._connected, sock=self.socket, limit=LONGEST_HEAD)
        while not self._ended.is_set():
            await asyncio.sleep(ENDING_S)
        server.close()

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One request and its answer; a client that leaves or is too slow is let go without a word."""
        self.connections += 1
        try:
            with contextlib.suppress(OSError, *SLOW_REQUEST):
                head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_S)
                writer.write(await self._answer(head))
                await asyncio.wait_for(writer.drain(), SEND_S)
        finally:
            self.connections -= 1
            writer.close()

    async def _answer(self, head: bytes) -> bytes:
        try:
            method, url, headers = _parsed(head)
            if self.connections > MOST_CONNECTIONS:
                return _refusal(503, "too many requests at once, ask again later")
            if sentence := self._refused(url.path, headers):
                return _refusal(403, sentence)
            if method != "GET":
                return _refusal(405, "this server knows GET only")
            return await self._content(url)
        except CtrplanError as error:
            return _refusal(400, str(error))
        except Exception as error:  # a fault of the program must not look like a pose
            sentence = f"the program failed at this pose ({type(error).__name__}: {error})"
            print(f"ctrplan: warning: live view: {sentence}", file=sys.stderr)
            return _refusal(500, sentence)

    def _refused(self, path: str, headers: HTTPMessage) -> str:
        """Why the request must not be answered, in a sentence; empty if it may."""
        host = headers.get("Host", "").rsplit(":", 1)[0]
        if host not in (ADDRESS, "localhost"):  # another site's name that was pointed at this machine
            return "this server answers to 127.0.0.1 only"
        if headers.get("Sec-Fetch-Site", "") not in OWN_PAGES:
            return "this server does not answer other pages"
        given = path.split("/")[1:2]
        if not given or not secrets.compare_digest(given[0].encode(), self.token.encode()):
            return "open the address that the program printed, with all that follows the port"
        return ""

    async def _content(self, url: SplitResult) -> bytes:
        path, query = url.path.removeprefix(f"/{self.token}"), parse_qs(url.query.replace("+", "%2B"))
        if path in self.pages:
            return self.pages[path]
        if path not in ("/pose", "/ik"):
            return _refusal(404, f"there is no {path[:60]} here")
        joints, base = _numbers(query, "q"), _numbers(query, "base") if "base" in query else None
        solve = partial(self.state.at, joints, base)
        if path == "/ik":
            solve = partial(self.state.reaching, joints, _numbers(query, "tip"), base)
        return _json(200, await asyncio.get_running_loop().run_in_executor(self.solvers, solve))


def _pages(state: LiveState) -> dict[str, bytes]:
    """Answers by path below the token."""
    from plotly.offline import get_plotlyjs

    scripts = {"/plotly.js": get_plotlyjs(), "/scene.js": scene_script(state), "/live.js": live_script()}
    pages = {path: _response(200, SCRIPT, text.encode()) for path, text in scripts.items()}
    return {"/": _response(200, HTML, live_page(state).encode()), **pages}


def _parsed(head: bytes) -> tuple[str, SplitResult, HTTPMessage]:
    """Method, address and headers of a request, its empty line included. Raises InputError where it is none."""
    first, _, rest = head.partition(b"\r\n")
    try:
        method, target, _ = first.decode("ascii").split()
        return method, urlsplit(target), parse_headers(io.BytesIO(rest))
    except (ValueError, HTTPException):
        raise InputError("is not a request that this server understands", value=ascii(first[:60])) from None


def _numbers(query: Mapping[str, list[str]], key: str) -> list[float]:
    """The numbers of a key with commas between them. Raises InputError."""
    text = query.get(key, [""])[0]
    try:
        return [float(value.replace("_", "?")) for value in text.split(",")]
    except ValueError:
        raise InputError("must be numbers with commas between them", key=key, value=text[:60]) from None


def _response(code: int, kind: str, content: bytes) -> bytes:
    """Status line, headers and content; the connection ends with it."""
    headers = {"Content-Type": kind, "Content-Length": str(len(content)), **HEADERS}
    rows = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
    return f"HTTP/1.1 {code} {HTTPStatus(code).phrase}\r\n{rows}\r\n".encode("latin-1") + content


def _json(code: int, content: Mapping[str, Any]) -> bytes:
    return _response(code, "application/json", json.dumps(content, allow_nan=False).encode())


def _refusal(code: int, sentence: str) -> bytes:
    return _json(code, {"error": sentence})
