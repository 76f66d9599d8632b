"""Comments behind the fields of a class become their documentation: that is where units and shapes stand."""

from __future__ import annotations

import io
import tokenize
from typing import Any

import griffe


class CommentDocs(griffe.Extension):
    """Gives every attribute without a docstring the comment at the end of its line."""

    def on_attribute_instance(self, *, attr: griffe.Attribute, **_: Any) -> None:
        if attr.docstring is None and attr.lineno and (comment := end_comment(attr)):
            attr.docstring = griffe.Docstring(comment, parent=attr, lineno=attr.lineno)


def end_comment(attribute: griffe.Attribute) -> str:
    """What stands behind the # of the attribute's last line; nothing without one, or where it speaks to a tool."""
    line = attribute.lines_collection[attribute.filepath][(attribute.endlineno or attribute.lineno or 1) - 1]
    try:
        tokens = list(tokenize.generate_tokens(io.StringIO(line.strip()).readline))
    except tokenize.TokenError:
        return ""
    comments = [token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT]
    return comments[0] if comments and not comments[0].startswith(("noqa", "type:", "fmt:")) else ""
