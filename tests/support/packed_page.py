"""What pages carry compressed, for tests that read it."""

from __future__ import annotations

import base64
import re
import zlib


def unpacked(text: str) -> str:
    """The text of what a page has packed."""
    return zlib.decompress(base64.b64decode(text)).decode()


def library(page: str) -> str:
    """plotly.js, which a page carries once."""
    (text,) = re.findall(r'= library\("([^"]+)"\)', page)
    return unpacked(text)
