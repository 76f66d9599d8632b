"""What the site adds to docs/: the README as first page, pages of the interface by room, formulas as MathML."""

from __future__ import annotations

import html
import logging
import pkgutil
import re
from functools import cache
from pathlib import Path
from typing import Any

import griffe
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "ctrplan"
LOG = logging.getLogger("mkdocs.hooks.site")  # warnings end a strict build
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.S)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Lists the pages of the interface in the navigation."""
    for entry in config.nav or []:
        if entry.get("Python interface"):
            entry["Python interface"] = [{title(room): page_of(room)} for room in rooms()]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages that are no files of docs/."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    files.append(File.generated(config, "index.md", content=links_of(readme, ROOT, moved="docs/")))
    for room in rooms():
        files.append(File.generated(config, page_of(room), content=interface(room)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Turns links to files of the tree that are no pages into their names."""
    return links_of(markdown, (ROOT / "docs" / page.file.src_uri).parent)


def on_page_content(content: str, page: Any, **_: Any) -> str:
    """Turns formulas into MathML, which browsers draw without a script; warns of code that was not understood."""
    if "<p>```" in content:
        LOG.warning("%s: a block of code was not understood", page.file.src_uri)
    return FORMULA.sub(lambda match: mathml(html.unescape(match[2]), block=match[1] == "div"), content)


def mathml(tex: str, block: bool) -> str:
    number = re.search(r"\\tag\{(.*?)\}", tex)
    drawn = convert(re.sub(r"\\tag\{.*?\}", "", tex).strip(), display="block" if block else "inline")
    return f'<div class="formula">{drawn}{f"<span>({number[1]})</span>" if number else ""}</div>' if block else drawn


def links_of(markdown: str, folder: Path, moved: str = "") -> str:
    """The text with links to pages kept, their prefix `moved` taken off, and other files of the tree named only."""

    def changed(match: re.Match[str]) -> str:
        picture, text, target = match.groups()
        if target.startswith(("http", "#")):
            return match[0]
        if moved and target.startswith(moved):
            target = target.removeprefix(moved)
            return f"{picture}[{text}]({target})" if is_page(ROOT / "docs" / target) else text
        return match[0] if not moved and is_page(folder / target) else text

    return LINK.sub(changed, markdown)


def is_page(target: Path) -> bool:
    return (target.suffix in (".png", ".svg") or target.name.partition("#")[0].endswith(".md")) and (
        ROOT / "docs"
    ) in target.resolve().parents


def rooms() -> list[str]:
    """The package itself, then its packages."""
    return [
        "",
        *sorted(info.name for info in pkgutil.iter_modules([str(PACKAGE)]) if info.ispkg and info.name != "commands"),
    ]


def title(room: str) -> str:
    return f"ctrplan.{room}" if room else "ctrplan"


def page_of(room: str) -> str:
    return f"api/{room or 'index'}.md"


def interface(room: str) -> str:
    """A heading, the names that the room offers by itself, and what mkdocstrings shows of its public modules."""
    modules = modules_below(PACKAGE / room, title(room)) if room else ["ctrplan.errors"]
    heading = f"::: {title(room)}\n    options:\n      members: false\n      heading_level: 1\n"
    return heading + offered(title(room)) + "".join(f"\n::: {module}\n" for module in modules)


def offered(package: str) -> str:
    """A table of the names in the package's __all__, each linked to where it is described."""
    found = tree()[package]
    names = [name for name in found.exports or [] if found[str(name)].is_alias]
    if not names:
        return ""
    rows = (f"| [`{name}`][{found[str(name)].final_target.path}] | {first_line(found[str(name)])} |" for name in names)
    return f"\n`from {package} import ...`\n\n| name | |\n|---|---|\n" + "\n".join(rows) + "\n"


def first_line(described: griffe.Object | griffe.Alias) -> str:
    return described.docstring.value.splitlines()[0].replace("|", "\\|") if described.docstring else ""


@cache
def tree() -> griffe.ModulesCollection:
    """The package as its sources say, nothing imported."""
    loader = griffe.GriffeLoader(search_paths=[str(ROOT)])
    loader.load("ctrplan")
    loader.resolve_aliases(implicit=True)
    return loader.modules_collection


def modules_below(folder: Path, name: str) -> list[str]:
    found: list[str] = []
    for info in pkgutil.iter_modules([str(folder)]):
        if not info.name.startswith("_"):
            inner = f"{name}.{info.name}"
            found += modules_below(folder / info.name, inner) if info.ispkg else [inner]
    return found
