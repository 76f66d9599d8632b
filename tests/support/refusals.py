"""Refusals written down as text: what is changed in a file, and below it the sentence that follows.

old text -> new text
    file.toml: key = value: rule.
"""

from __future__ import annotations

import re


def refusals(listed: str, file: str) -> list[tuple[str, str]]:
    """Content of the changed file and the sentence, for every entry; a sentence is all that is indented."""
    cases = []
    for entry in re.split(r"\n(?! )", listed.strip()):
        change, *sentence = entry.split("\n")
        old, new = (text.strip().replace(r"\n", "\n") for text in f"{change} ".split(" -> "))
        assert old in file, old
        cases.append((file.replace(old, new, 1), " ".join(line.strip() for line in sentence)))
    return cases
