"""Made-up files for the readers, and what each of them owes whoever gave it such a file.

CI makes a few hundred; with CTRPLAN_FUZZ set (`make fuzz`) a test makes CASES, a fault comes REPETITIONS times.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from datetime import timedelta
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from ctrplan.errors import InputError

FUZZ = bool(os.environ.get("CTRPLAN_FUZZ"))
CASES = int(os.environ.get("CTRPLAN_FUZZ_CASES", "10000"))
REPETITIONS = int(os.environ.get("CTRPLAN_FUZZ_REPETITIONS", "100"))
HANG_S = 10.0

# Rules about a file as a whole: there is no key or value to name.
OF_THE_FILE = (
    "is not UTF-8 text",
    "is empty",
    "is a web page",
    "is a pointer of Git LFS",
    "is packed by",
    "is not valid TOML",
    "is nested too deeply",
    "is no readable CSV file",
    "must have a header and at least one row",
    "holds a number with thousands of digits",
    "is larger than",
    "has its columns separated by",
    "all joints are constant",
    "holds no pose",
)

NUMBERS = st.sampled_from(
    ["nan", "inf", "-inf", "0", "-0.0", "5e-324", "1e-310", "2.3e-308", "1e-12", "1", "-1", "0.5", "90", "1e5", "1e12"]
    + ["1e154", "1e200", "1e300", "-1e300", "1.7e308", "9223372036854775807", "-9223372036854775808", "1e-300"]
)


def thorough(shown_by: str) -> pytest.MarkDecorator:
    """Marks a test of many seconds, for `make fuzz`: most of its law another one shows every time, which is named."""
    return pytest.mark.skipif(not FUZZ, reason=f"{shown_by}; this one in make fuzz")


def cases(few: int) -> Callable[[Any], Any]:
    """Settings of a test: `few` cases in CI, CASES with `make fuzz`; one that takes HANG_S fails either way."""
    return settings(
        max_examples=CASES if FUZZ else few,
        deadline=timedelta(seconds=HANG_S),
        suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
        print_blob=True,
    )


def repetitions(few: int) -> int:
    """How often a fault is tried: `few` times in CI, REPETITIONS times with `make fuzz`."""
    return REPETITIONS if FUZZ else few


def assert_names_the_fault(error: InputError, file: str) -> None:
    """One printable sentence that begins with the file and holds key, value and rule wherever there is one."""
    sentence = str(error)
    assert sentence.isprintable() and sentence.endswith((".", "?")) and len(sentence) < 1000, sentence
    assert error.exit_code == 2
    named = os.fspath(error.file) if error.file is not None else ""
    assert named and sentence.startswith(printable(named)), f"{file}: no file in: {sentence}"
    assert error.rule and len(error.rule.split()) > 1, sentence
    if not error.rule.startswith(OF_THE_FILE):
        assert error.key, f"no key in: {sentence}"


def printable(text: str) -> str:
    """A name in the form in which sentences show it."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))
