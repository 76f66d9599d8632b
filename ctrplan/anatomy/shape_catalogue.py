"""Every kind of obstacle and lumen there is: one file each, below anatomy/shapes/ or in that of an extension."""

from __future__ import annotations

import ctrplan.anatomy.shapes
from ctrplan.anatomy.shape import CATALOGUE
from ctrplan.base.extensions import import_modules

__all__ = ["CATALOGUE"]

import_modules(ctrplan.anatomy.shapes, CATALOGUE)
