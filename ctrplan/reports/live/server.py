"""The live view's server: one robot, this machine only, nothing from the network."""

from __future__ import annotations

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from ctrplan.errors import CtrplanError, InputError
from ctrplan.reports.live.page import POLICY, live_page, live_script, scene_script

if TYPE_CHECKING:
    from ctrplan.reports.live.state import LiveState

ADDRESS = "127.0.0.1"
LONGEST_QUERY = 4000


class LiveServer(ThreadingHTTPServer):
    """Serves the page, plotly.js and poses on a port of 127.0.0.1; 0 takes a free one."""

    daemon_threads = True

    def __init__(self, state: LiveState, port: int = 0) -> None:
        """Raises InputError where the port can't be had."""
        self.state = state
        self.pages = _pages(state)
        self.solving = threading.Semaphore(2)  # a page that asks faster than answers come can't pile up work
        try:
            super().__init__((ADDRESS, port), _Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"can't be listened on ({reason})", key="--port", value=port) from None

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{ADDRESS}:{self.server_address[1]}/"


def _pages(state: LiveState) -> dict[str, tuple[str, bytes]]:
    """Content type and content by path."""
    from plotly.offline import get_plotlyjs

    script = "text/javascript; charset=utf-8"
    return {
        "/": ("text/html; charset=utf-8", live_page(state).encode()),
        "/plotly.js": (script, get_plotlyjs().encode()),
        "/scene.js": (script, scene_script(state).encode()),
        "/live.js": (script, live_script().encode()),
    }


class _Handler(BaseHTTPRequestHandler):
    server: LiveServer

    def do_GET(self) -> None:  # noqa: N802, the name http.server asks for
        host = (self.headers.get("Host") or "").rsplit(":", 1)[0]
        if host not in (ADDRESS, "localhost"):  # another site's name that was pointed at this machine
            self._answer(403, {"error": "this server answers to 127.0.0.1 only"})
            return
        parts = urlsplit(self.path)
        if parts.path in self.server.pages:
            self._send(200, *self.server.pages[parts.path])
        elif parts.path == "/pose":
            self._pose(parts.query)
        else:
            self._answer(404, {"error": f"there is no {parts.path[:60]} here"})

    def _pose(self, query: str) -> None:
        try:
            text = parse_qs(query[:LONGEST_QUERY]).get("q", [""])[0]
            values = [float(value) for value in text.split(",")]
        except ValueError:
            self._answer(400, {"error": "q must be numbers with commas between them"})
            return
        try:
            with self.server.solving:
                self._answer(200, self.server.state.at(values))
        except CtrplanError as error:
            self._answer(400, {"error": str(error)})

    def _answer(self, code: int, content: dict[str, Any]) -> None:
        self._send(code, "application/json", json.dumps(content, allow_nan=False).encode())

    def _send(self, code: int, kind: str, content: bytes) -> None:
        self.send_response(code)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(content))),
            ("Content-Security-Policy", POLICY),
            ("X-Content-Type-Options", "nosniff"),
            ("Cache-Control", "no-store"),
        ):
            self.send_header(name, value)
        self.end_headers()
        try:
            self.wfile.write(content)
        except (BrokenPipeError, ConnectionResetError):  # the page was closed
            self.close_connection = True

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002, the base class's name
        """Says nothing: the terminal belongs to the user."""
