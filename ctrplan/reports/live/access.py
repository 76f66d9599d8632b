"""Who may read the live view: the page that the program opened, and nothing else that runs on this machine."""

from __future__ import annotations

import secrets
from typing import TYPE_CHECKING

from ctrplan.reports.live.page import POLICY

if TYPE_CHECKING:
    from ctrplan.reports.live.http_message import Request

ADDRESS = "127.0.0.1"
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Resource-Policy": "same-origin",  # no script, image or frame of a page elsewhere
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
OWN_PAGES = ("", "none", "same-origin")  # Sec-Fetch-Site: of old browsers, typed by hand, asked by the page itself


def new_token() -> str:
    """A secret part of the address, another one for each start of the program."""
    return secrets.token_urlsafe(24)


def refused(request: Request, token: str) -> str:
    """Why the request must not be answered, in a sentence; empty if it may."""
    host = request.headers.get("Host", "").rsplit(":", 1)[0]
    if host not in (ADDRESS, "localhost"):  # another site's name that was pointed at this machine
        return "this server answers to 127.0.0.1 only"
    if request.headers.get("Sec-Fetch-Site", "") not in OWN_PAGES:
        return "this server does not answer other pages"
    given = request.path.split("/")[1:2]
    if not given or not secrets.compare_digest(given[0].encode(), token.encode()):
        return "open the address that the program printed, with all that follows the port"
    return ""
