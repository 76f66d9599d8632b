"""Numbers of a robot and of its registration that are known by intervals only, and what they may do to a motion.

`ctrplan.plan_uncertainty(plan)` gives the result for a plan. The package itself can be called in its place, as the
function was until it had the name of the package; that ends with the next version.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any


class _Package(ModuleType):
    def __call__(self, *arguments: Any, **named: Any) -> Any:
        import ctrplan

        return ctrplan.plan_uncertainty(*arguments, **named)


sys.modules[__name__].__class__ = _Package
