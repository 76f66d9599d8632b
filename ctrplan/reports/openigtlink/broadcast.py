"""A server of OpenIGTLink on this machine: whoever listens gets what is sent, and first what was sent last."""

from __future__ import annotations

import contextlib
import socket
import threading
from types import TracebackType

from ctrplan.errors import InputError

ADDRESS = "127.0.0.1"
SLOWEST_S = 1.0  # that a listener may take before it is let go


class Broadcast:
    """Sends messages to all listeners of a port; 0 takes a free one. Calls may come from several threads."""

    def __init__(self, port: int) -> None:
        """Raises InputError where the port can't be had."""
        try:
            self.socket = socket.create_server((ADDRESS, port))
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"can't be listened on ({reason})", key="--igtl", value=port) from None
        self.port: int = self.socket.getsockname()[1]
        self._listeners: list[socket.socket] = []
        self._last: list[bytes] = []
        self._lock = threading.Lock()
        self._accepting = threading.Thread(target=self._accept, name="OpenIGTLink", daemon=True)

    def __enter__(self) -> Broadcast:
        """Begins to listen."""
        self._accepting.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Lets everybody go."""
        with contextlib.suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)  # closing alone would not wake who accepts
        self.socket.close()
        self._accepting.join()
        with self._lock:
            for listener in self._listeners:
                listener.close()
            self._listeners.clear()

    @property
    def is_heard(self) -> bool:
        """Whether anybody listens."""
        with self._lock:
            return bool(self._listeners)

    def send(self, messages: list[bytes]) -> None:
        """To all listeners; who has gone, or is too slow, is let go."""
        with self._lock:
            self._last = messages
            self._listeners = [listener for listener in self._listeners if _sent(listener, messages)]

    def _accept(self) -> None:
        while True:
            try:
                listener, _ = self.socket.accept()
            except OSError:  # closed
                return
            listener.settimeout(SLOWEST_S)
            with self._lock:
                if _sent(listener, self._last):
                    self._listeners.append(listener)


def _sent(listener: socket.socket, messages: list[bytes]) -> bool:
    try:
        listener.sendall(b"".join(messages))
    except OSError:
        listener.close()
        return False
    return True
