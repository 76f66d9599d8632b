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
from ctrplan.reports.live_page import POLICY, live_page, live_script, scene_script

if TYPE_CHECKING:
    from ctrplan.reports.live_state import LiveState

ADDRESS = "127.0.0.1"
SOLVERS = 2  # threads that solve poses; requests wait in line for them
LONGEST_HEAD = 16_384  # bytes of a request
HEAD_S, SEND_S = 5.0, 30.0  # that a client may take to ask, and to take the answer
ENDING_S = 0.1  # until a shutdown is noticed
MOST_CONNECTIONS = 800  # at once, all of them answered; fewer than the files a program may have open
ASKED_TOO_SLOWLY = (asyncio.TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError)
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
        """Answers until `shutdown` or Ctrl-C, in a thread of its own: an interrupt never lands in the midst of it."""
        answering = threading.Thread(target=asyncio.run, args=(self._serve(),), name="live view")
        answering.start()
        try:
            answering.join()
        finally:
            self.shutdown()
            answering.join()

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
            with contextlib.suppress(OSError, *ASKED_TOO_SLOWLY):
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
