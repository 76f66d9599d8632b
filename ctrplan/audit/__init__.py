"""An independent judge of written plans: it hunts for what breaks a certificate, and shares nothing with its making.

Of the planner's world it uses the core's solutions, and reads scenario and plan. Path, body points, distances and what
is looked at are its own.
"""

from __future__ import annotations
