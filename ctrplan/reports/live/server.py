"""The live view's server: one robot, this machine only, nothing from the network."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING

from ctrplan.errors import CtrplanError, InputError
from ctrplan.reports.live.access import ADDRESS, HEADERS, new_token, refused
from ctrplan.reports.live.http_message import Answer, Request, json_answer, parsed, refusal
from ctrplan.reports.live.page import live_page, live_script, scene_script

if TYPE_CHECKING:
    from ctrplan.reports.live.state import LiveState

SOLVERS = 2  # threads that solve poses; requests wait in line for them
LONGEST_HEAD = 16_384  # bytes of a request
HEAD_S, SEND_S = 5.0, 30.0  # that a client may take to ask, and to take the answer
ENDING_S = 0.1  # until a shutdown is noticed
MOST_CONNECTIONS = 800  # at once, all of them answered; fewer than the files a program may have open
ASKED_TOO_SLOWLY = (asyncio.TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError)


class LiveServer:
    """Serves the page, plotly.js and poses on a port of 127.0.0.1; 0 takes a free one."""

    def __init__(self, state: LiveState, port: int = 0) -> None:
        """Raises InputError where the port can't be had."""
        self.state = state
        self.token = new_token()
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
                writer.write((await self._answer(head)).encoded(HEADERS))
                await asyncio.wait_for(writer.drain(), SEND_S)
        finally:
            self.connections -= 1
            writer.close()

    async def _answer(self, head: bytes) -> Answer:
        try:
            request = parsed(head)
            if self.connections > MOST_CONNECTIONS:
                return refusal(503, "too many requests at once, ask again later")
            if sentence := refused(request, self.token):
                return refusal(403, sentence)
            return await self._content(request)
        except CtrplanError as error:
            return refusal(400, str(error))
        except Exception as error:  # a fault of the program must not look like a pose
            sentence = f"the program failed at this pose ({type(error).__name__}: {error})"
            print(f"ctrplan: warning: live view: {sentence}", file=sys.stderr)
            return refusal(500, sentence)

    async def _content(self, request: Request) -> Answer:
        path = request.path.removeprefix(f"/{self.token}")
        if request.method != "GET":
            return refusal(405, "this server knows GET only")
        if path in self.pages:
            return self.pages[path]
        if path not in ("/pose", "/ik"):
            return refusal(404, f"there is no {path[:60]} here")
        values, base = request.numbers("q"), request.numbers("base") if request.has("base") else None
        asked = partial(self.state.at, values, base)
        if path == "/ik":
            asked = partial(self.state.reaching, values, request.numbers("tip"), base)
        return json_answer(200, await asyncio.get_running_loop().run_in_executor(self.solvers, asked))


def _pages(state: LiveState) -> dict[str, Answer]:
    """Content by path below the token."""
    from plotly.offline import get_plotlyjs

    script = "text/javascript; charset=utf-8"
    return {
        "/": Answer(200, "text/html; charset=utf-8", live_page(state).encode()),
        "/plotly.js": Answer(200, script, get_plotlyjs().encode()),
        "/scene.js": Answer(200, script, scene_script(state).encode()),
        "/live.js": Answer(200, script, live_script().encode()),
    }
