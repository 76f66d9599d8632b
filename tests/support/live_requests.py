"""Requests to a live view, as a page makes them."""

from __future__ import annotations

import http.client
import json
from typing import Any

from ctrplan.reports.live_server import LiveServer

VESSEL_START = "20,-60,80,-86.4"


def get(server: LiveServer, path: str, **headers: str) -> tuple[int, Any, dict[str, str]]:
    """What a page of the server gets for a path below its token."""
    return ask(server, f"/{server.token}{path}", **headers)


def ask(server: LiveServer, path: str, **headers: str) -> tuple[int, Any, dict[str, str]]:
    connection = http.client.HTTPConnection(*server.server_address[:2], timeout=60)
    connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    is_json = answer.headers["Content-Type"] == "application/json"
    return answer.status, json.loads(content) if is_json else content.decode(), dict(answer.headers)
