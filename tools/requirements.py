"""Prints what pyproject.toml requires to build, run and test, one per line, for the Makefile's environment."""

import sys
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:  # 3.10 has no reader of its own, but every environment's pip carries one
    from pip._vendor import tomli as tomllib

project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))
wanted = [
    *project["build-system"]["requires"],
    *project["project"]["dependencies"],
    *project["project"]["optional-dependencies"]["test"],
    *project["project"]["optional-dependencies"]["live"],
    *project["project"]["optional-dependencies"]["images"],
    "cmake>=3.18",
    "ninja",
]
sys.stdout.write("\n".join(wanted) + "\n")
