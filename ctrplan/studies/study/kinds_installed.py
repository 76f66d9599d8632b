"""All kinds of tasks, registered: whoever looks one up imports this."""

from __future__ import annotations

import ctrplan.studies.study.kinds
from ctrplan.base.extensions import import_modules
from ctrplan.studies.study.task_kind import CATALOGUE, TaskKind

import_modules(ctrplan.studies.study.kinds, CATALOGUE)

__all__ = ["CATALOGUE", "TaskKind"]
