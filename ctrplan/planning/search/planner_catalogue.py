"""Every planner there is: one file each, below planning/search/planners/ or in that of an extension."""

from __future__ import annotations

import ctrplan.planning.search.planners
from ctrplan.base.extensions import import_modules
from ctrplan.planning.search.planner_settings import CATALOGUE

__all__ = ["CATALOGUE"]

import_modules(ctrplan.planning.search.planners, CATALOGUE)
