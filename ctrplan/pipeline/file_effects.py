"""[effects.*] of a robot file, read strictly."""

from __future__ import annotations

from ctrplan.effects.catalogue import CATALOGUE
from ctrplan.pipeline.chain import NOTES
from ctrplan.robot.robot import Robot
from ctrplan.storage.toml_document import Document


def check_effects(robot: Robot, document: Document) -> None:
    """Raises InputError for an effect that is not in the catalogue and for parameters it does not have."""
    for name, table in robot.effects.items():
        if name not in CATALOGUE:
            raise document.fault(f"unknown effect, known ones are {', '.join(CATALOGUE)}", "effects", name)
        known = {parameter.name: parameter for parameter in CATALOGUE[name].parameters(robot)}
        for key, value in table.items():
            if key in NOTES:
                continue
            if key not in known:
                raise document.fault(f"unknown parameter, known ones are {', '.join(known)}", "effects", name, key)
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise document.fault("must be a number", "effects", name, key)
            low, high = known[key].lower, known[key].upper
            if not low <= value <= high:
                raise document.fault(f"must be from {low:g} to {high:g}", "effects", name, key)
