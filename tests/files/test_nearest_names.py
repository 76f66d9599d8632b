"""What is misspelt is answered with the nearest name there is, wherever files name something."""

from __future__ import annotations

from pathlib import Path

import pytest
from pair_file import PAIR
from written_scenario import SCENARIO, place

from ctrplan.__main__ import main
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot
from ctrplan.files.scenario_file import load_robot_or_scenario, load_scenario

ROBOT = [
    ("[effects.backlsh]\ntheta_2_deg = 1", r"effects.backlsh: unknown effect, .*; did you mean backlash\?"),
    ("[effects.backlash]\ntheta_2_rad = 1", r"theta_2_rad = 1: unknown parameter, .*; did you mean theta_2_deg\?"),
    ("[uncertainty.ci95]\n'tube.2.poisson_rato' = [0, 1]", r"poisson_rato = .*; did you mean poisson_ratio\?"),
    ("[[marker]]\nname = 'ring 1'\ntube = 2", r"marker.1.name = 'ring 1': must be a letter, and after it letters and "),
    ("[contact]\nclearance_mm = 1", r"Cannot .* \(a key is said once; .* \[\[two brackets\]\] each time\)"),
    ("[marker]\nname = 'a'", r"marker: must be a list, each headed \[\[marker\]\]"),
]
SCENARIOS = [
    ('"rotate outer" = ', '"rotat outer" = ', r"start.rotat outer = .*; did you mean rotate outer\?"),
    ("[start]", '[start]\nfriction = "unknwon"', r"must be one of unknown, .*; did you mean unknown\?"),
    ("[start]", '[start]\nturns = "absolut"', r"must be one of unknown, absolute; did you mean absolute\?"),
    ("[start]", '[fixture]\nkind = "sphere"\n[start]', r"fixture: must be a list, each headed \[\[fixture\]\]"),
]


@pytest.mark.parametrize(("added", "rule"), ROBOT)
def test_of_a_robot(added: str, rule: str, tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text(f"{PAIR}\n{added}\n")
    with pytest.raises(InputError, match=rule):
        load_robot(tmp_path / "robot.toml")


@pytest.mark.parametrize(("text", "other", "rule"), SCENARIOS)
def test_of_a_scenario(text: str, other: str, rule: str, tmp_path: Path) -> None:
    place(tmp_path)
    assert text in SCENARIO
    file = tmp_path / "scenario.toml"
    file.write_text(SCENARIO.replace(text, other, 1))
    with pytest.raises(InputError, match=rule):
        load_scenario(file)


def test_a_plan_in_the_place_of_a_robot_is_named(tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text('{"schema_version": 6}')
    with pytest.raises(InputError, match=r"is not valid TOML .* \(it is JSON: are two files exchanged\?\)"):
        load_robot_or_scenario(tmp_path / "plan.json")


def test_a_robot_file_takes_keys_as_a_scenario_hands_them_on(tmp_path: Path) -> None:
    """`ctrplan ik FILE --set robot.KEY=VALUE` and keys of studies are the same for a robot and a scenario."""
    file = tmp_path / "robot.toml"
    file.write_text(PAIR)
    own, handed = (f"{prefix}tube.2.poisson_ratio=0.28" for prefix in ("", "robot."))
    assert load_robot(file, [own]).to_toml() == load_robot(file, [handed]).to_toml()
    assert load_robot_or_scenario(file, [own]).robot.to_toml() == load_robot_or_scenario(file, [handed]).robot.to_toml()
    command = ["--theta-deg", "0", "90", "--l-mm", "0", "-17", "--set", handed]
    assert main(["bound", str(file), *command]) == 0
    study = 'robot = "robot.toml"\ntask = {kind = "bound", theta_deg = [0, 90], l_mm = [0, -17]}\n'
    study += '[[vary]]\nkey = "robot.contact.1.friction_coefficient"\nvalues = [0.1, 0.2]\n'
    (tmp_path / "study.toml").write_text(study)
    assert main(["study", str(tmp_path / "study.toml"), "-o", str(tmp_path / "out"), "--quiet"]) == 0
