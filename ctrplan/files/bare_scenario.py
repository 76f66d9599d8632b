"""A scenario from a file of either kind: a scenario's, or a robot's, which then stands in free space."""

from __future__ import annotations

import os
from collections.abc import Sequence

from ctrplan.files.robot_file import robot_from_dict
from ctrplan.files.scenario_file import load_scenario
from ctrplan.planning.bare_scenario import bare_scenario
from ctrplan.planning.scenario import Scenario
from ctrplan.storage.toml_document import read_document


def load_robot_or_scenario(
    path: str | os.PathLike[str], overrides: Sequence[str] = (), *, allow_outside: bool = False
) -> Scenario:
    """The scenario of a file, or the bare scenario of a robot file: what has tubes is a robot. Raises InputError."""
    document = read_document(path)
    if "tube" not in document.content:
        return load_scenario(path, overrides, allow_outside=allow_outside)
    return bare_scenario(robot_from_dict(document.with_overrides(overrides).content, file=document.file))
