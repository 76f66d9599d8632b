"""As much of HTTP/1.1 as a page of this machine needs: one request, and one answer to it."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPStatus
from http.client import HTTPException, HTTPMessage, parse_headers
from typing import Any
from urllib.parse import parse_qs, urlsplit

from ctrplan.errors import InputError

JSON = "application/json"


@dataclass(frozen=True)
class Request:
    """What a client asks for."""

    method: str
    path: str
    query: str
    headers: HTTPMessage  # names in any case

    def numbers(self, key: str) -> list[float]:
        """The numbers of a key with commas between them; a plus sign is one. Raises InputError."""
        text = self._text(key) or ""
        try:
            return [float(value.replace("_", "?")) for value in text.split(",")]
        except ValueError:
            raise InputError("must be numbers with commas between them", key=key, value=text[:60]) from None

    def has(self, key: str) -> bool:
        """Whether the query says anything of a key."""
        return self._text(key) is not None

    def _text(self, key: str) -> str | None:
        return parse_qs(self.query.replace("+", "%2B")).get(key, [None])[0]


@dataclass(frozen=True)
class Answer:
    """What it gets."""

    code: int
    kind: str  # content type
    content: bytes

    def encoded(self, headers: Mapping[str, str]) -> bytes:
        """Status line, headers and content; the connection ends with it."""
        own = {"Content-Type": self.kind, "Content-Length": str(len(self.content)), "Connection": "close"}
        rows = "".join(f"{name}: {value}\r\n" for name, value in {**own, **headers}.items())
        return f"HTTP/1.1 {self.code} {HTTPStatus(self.code).phrase}\r\n{rows}\r\n".encode("latin-1") + self.content


def json_answer(code: int, content: Mapping[str, Any]) -> Answer:
    """Plain types as JSON."""
    return Answer(code, JSON, json.dumps(content, allow_nan=False).encode())


def refusal(code: int, sentence: str) -> Answer:
    """Why there is nothing else."""
    return json_answer(code, {"error": sentence})


def parsed(head: bytes) -> Request:
    """The request of a head, its empty line included. Raises InputError where it is none."""
    first, _, rest = head.partition(b"\r\n")
    try:
        method, target, _ = first.decode("ascii").split()
        parts = urlsplit(target)
        headers = parse_headers(io.BytesIO(rest))
    except (ValueError, HTTPException):
        raise InputError("is not a request that this server understands", value=ascii(first[:60])) from None
    return Request(method, parts.path, parts.query, headers)
