"""What the site shows of the sources: also comments behind fields, for units and shapes; no constants of modules."""

from __future__ import annotations

import io
import tokenize
from typing import Any

import griffe

from ctrplan.certificate.certificate import FIGURES

KEPT = {"CATALOGUE"}  # constants that are part of the interface


class CommentDocs(griffe.Extension):
    """Gives attributes without a docstring the comment at the end of their line, figures of the certificate their
    description in the table; drops a module's own settings.
    """

    def on_attribute_instance(self, *, attr: griffe.Attribute, **_: Any) -> None:
        is_figure = attr.name in FIGURES and attr.parent is not None and attr.parent.name == "Certificate"
        comment = end_comment(attr) or (FIGURES[attr.name].description if is_figure else "")
        if is_figure:
            attr.value = None  # its row of the table
        if attr.docstring is None and attr.lineno and comment:
            attr.docstring = griffe.Docstring(comment, parent=attr, lineno=attr.lineno)

    def on_module_members(self, *, mod: griffe.Module, **_: Any) -> None:
        exported = {str(name) for name in mod.exports or []}
        for name in [name for name in mod.members if name.isupper() and name not in KEPT | exported]:
            del mod.members[name]


def end_comment(attribute: griffe.Attribute) -> str:
    """What stands behind the # of the attribute's last line; nothing without one, or where it speaks to a tool."""
    line = attribute.lines_collection[attribute.filepath][(attribute.endlineno or attribute.lineno or 1) - 1]
    try:
        tokens = list(tokenize.generate_tokens(io.StringIO(line.strip()).readline))
    except tokenize.TokenError:
        return ""
    comments = [token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT]
    return comments[0] if comments and not comments[0].startswith(("noqa", "type:", "fmt:")) else ""
