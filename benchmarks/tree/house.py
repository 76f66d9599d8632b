"""How large is the tree, and how is it cut? Files, lines, packages, importers, private functions, numbers, words.

    python benchmarks/run.py house [FOLDER]        # default: this tree; another checkout is counted in the same way

An importer is another file of ctrplan/ that imports something of the file, types included; what a package's `__init__`
passes on counts for the file that has it. A private function (or method, or class) used once is one whose name begins
with an underscore and occurs twice in all of ctrplan/: where it is defined, and where it is used. A hand-set number
is a name in capitals that a module binds to numbers alone. Words of documents are those of README.md and docs/**/*.md.
"""

import ast
import re
import sys
from collections import Counter
from pathlib import Path
from statistics import median

import common
import grimp
from common import ROOT, table

SMALL = 60  # lines


def importers(root: Path) -> dict[Path, set[Path]]:
    """For each file those that import from it; through a package's __init__ where that passes names on."""
    sys.path.insert(0, str(root))
    graph = grimp.build_graph("ctrplan", cache_dir=None)

    def file(module: str) -> Path:
        place = root.joinpath(*module.split("."))
        return place / "__init__.py" if place.is_dir() else place.with_suffix(".py")

    by = {file(module): set(map(file, graph.find_modules_that_directly_import(module))) for module in graph.modules}
    for path in sorted(by):
        if path.name == "__init__.py":
            for passed in [other for other, users in by.items() if path in users]:
                by[passed] |= by[path] - {passed}
    return by


def is_number(node: ast.expr) -> bool:
    """Numbers, and tuples, lists, sums and products of them."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if isinstance(node, ast.Tuple | ast.List):
        return bool(node.elts) and all(map(is_number, node.elts))
    if isinstance(node, ast.BinOp):
        return is_number(node.left) and is_number(node.right)
    return isinstance(node, ast.UnaryOp) and is_number(node.operand)


def hand_set(tree: ast.Module) -> int:
    """Names in capitals that a module binds to numbers; a tuple on both sides counts each name."""
    count = 0
    for node in tree.body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
            several = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
            pairs = zip(target.elts, node.value.elts, strict=False) if several else [(target, node.value)]
            names = (name.id for name, value in pairs if isinstance(name, ast.Name) and is_number(value))
            count += sum(bool(re.fullmatch(r"_?[A-Z][A-Z0-9_]*[a-zA-Z]*", name)) for name in names)
    return count


def visits() -> list[tuple[str, int]]:
    """Files and functions that a plan calls in the thread that asks for it, from its scenario to plan.json."""
    import ctrplan

    seen: set[tuple[str, str]] = set()
    common.end_searches_by_count()
    scenario = ctrplan.load_scenario(ROOT / "scenarios" / "vessel.toml", ["planner.time_s=1"])
    ctrplan.plan(scenario)  # imports everything
    sys.setprofile(lambda frame, _event, _: seen.add((frame.f_code.co_filename, f"{frame.f_code.co_firstlineno}")))
    ctrplan.plan(ctrplan.load_scenario(scenario.path or "", ["planner.time_s=1"])).to_json()
    sys.setprofile(None)
    own = {(file, name) for file, name in seen if "ctrplan" in Path(file).parts[-4:]}
    return [("files", len({file for file, _ in own})), ("functions", len(own))]


def main() -> None:
    root = Path(common.arguments(__doc__, "folder?").folder or ROOT).resolve()
    if not (root / "ctrplan").is_dir():
        sys.exit(f"{root}: has no folder ctrplan/, whose files are counted")
    texts = {path: path.read_text(encoding="utf-8") for path in sorted((root / "ctrplan").rglob("*.py"))}
    trees = {path: ast.parse(text) for path, text in texts.items()}
    lines = {path: len(text.splitlines()) for path, text in texts.items()}
    own = [path for path in texts if path.name != "__init__.py"]
    by = importers(root)
    single = [path for path in own if len(by[path]) == 1]
    small = [p for p in single if lines[p] < SMALL and next(iter(by[p])).parent == p.parent]
    nodes = [node for tree in trees.values() for node in ast.walk(tree)]
    words = Counter(word for text in texts.values() for word in re.findall(r"\b_[a-z]\w*", text))
    private = {n.name for n in nodes if isinstance(n, ast.FunctionDef) and re.match(r"_[a-z]", n.name)}
    classes = Counter(node.name for node in nodes if isinstance(node, ast.ClassDef))
    twice = sorted(name for name, count in classes.items() if count > 1)
    pages = [root / "README.md", *(root / "docs").rglob("*.md")]
    length = {page: len(page.read_text(encoding="utf-8").split()) for page in pages}
    rows = [
        ("files in ctrplan/", len(texts)),
        ("median lines of a file", f"{median(lines.values()):g}"),
        ("the same without __init__", f"{median(lines[path] for path in own):g}"),
        ("most lines of a file", max(lines.values())),
        ("lines", sum(lines.values())),
        ("packages", sum(path.name == "__init__.py" for path in texts)),
        ("files with one importer", len(single)),
        (f"of these under {SMALL} lines with the importer in their own folder", len(small)),
        ("private functions used once", sum(words[name] == 2 for name in private)),
        ("hand-set numbers", sum(map(hand_set, trees.values()))),
        ("class names that occur more than once", len(twice)),
        ("words of documents", sum(length.values())),
        ("of these in docs/log", sum(length[page] for page in pages if "log" in page.parts)),
    ]
    if root == ROOT:  # another checkout would have to be imported in a process of its own
        rows += [(f"{what} of ctrplan/ that a plan of vessel.toml visits", n) for what, n in visits()]
    table("the tree", ("what", "count"), rows)
    print(f"\nclass names that occur more than once: {', '.join(twice)}")
