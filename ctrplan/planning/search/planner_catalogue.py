"""Every planner there is: one file each, below planning/search/planners/ or in that of an extension."""

from __future__ import annotations

import ctrplan.planning.search.planners
from ctrplan.base.extensions import import_modules
from ctrplan.planning.planner_settings import CATALOGUE
from ctrplan.planning.search.planners.bit_star import BITStar

__all__ = ["CATALOGUE", "DEFAULT"]

DEFAULT = BITStar()  # where a scenario names none

import_modules(ctrplan.planning.search.planners, CATALOGUE)
