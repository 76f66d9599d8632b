"""Every effect there is: one file each, in the folder of its stage or in that of an extension."""

from __future__ import annotations

import ctrplan.effects.clock
import ctrplan.effects.drive
import ctrplan.effects.mechanics
import ctrplan.effects.sensor
from ctrplan.base.extensions import import_modules
from ctrplan.effects.effect import CATALOGUE

__all__ = ["CATALOGUE"]

for _stage in (ctrplan.effects.clock, ctrplan.effects.drive, ctrplan.effects.mechanics, ctrplan.effects.sensor):
    import_modules(_stage, CATALOGUE)
