"""`pytest --processor-times FILE`: seconds of a processor that every test and every fixture took, children included.

A loaded machine changes the time by the clock far more than that of the processor. Each line of the file is `seconds
kind name`; a test's line does not hold what fixtures of wider scope took, which have lines of their own. The workers of
xdist append to the same file. `sort -rn FILE` lists what costs most first.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--processor-times", metavar="FILE", help="append the processor time of every test and fixture")


def pytest_configure(config: pytest.Config) -> None:
    path = config.getoption("--processor-times")
    runs_tests = hasattr(config, "workerinput") or config.getoption("dist", "no") == "no"
    if path and runs_tests:
        config.pluginmanager.register(ProcessorTimes(Path(str(config.invocation_params.dir)) / path))


class ProcessorTimes:
    """Writes one line a test, one a fixture wider than a test, and one for the rest of the process."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._of_fixtures = 0.0
        self._written = 0.0

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Generator[None, Any, Any]:
        start = processor_time()
        try:
            return (yield)
        finally:
            if fixturedef.scope != "function":
                took = processor_time() - start
                self._of_fixtures += took
                self._write(took, "fixture", f"{fixturedef.baseid}::{fixturedef.argname} ({request.node.nodeid})")

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, Any, Any]:
        start, of_fixtures = processor_time(), self._of_fixtures
        try:
            return (yield)
        finally:
            self._write(processor_time() - start - (self._of_fixtures - of_fixtures), "test", item.nodeid)

    def pytest_sessionfinish(self) -> None:
        self._write(processor_time() - self._written, "process", "imports, collection and what is between the tests")

    def _write(self, seconds: float, kind: str, name: str) -> None:
        self._written += seconds
        with self._path.open("a", encoding="utf-8") as file:
            file.write(f"{seconds:.3f} {kind} {name}\n")


def processor_time() -> float:
    """Seconds of this process and of its children that have ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime
