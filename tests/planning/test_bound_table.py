"""The bound looked up on a grid against the model it was made from."""

from __future__ import annotations

import errno
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import ROBOTS

from ctrplan.certificate.friction_states import bound_allowance_m
from ctrplan.cli import main
from ctrplan.commands.field import _print_errors
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot, robot_from_dict
from ctrplan.files.scenario_file import load_scenario
from ctrplan.mechanics.bound_lookup import FieldLookup
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.tube import nests
from ctrplan.mechanics.walk import Field, PathDensity, PathLimits
from ctrplan.motion import bound_table as fields
from ctrplan.motion.bound_table import BoundTable, FieldError, choose_axes, known_table, tabulated_bounds
from ctrplan.planning import plan
from ctrplan.planning.table_worth import _lost, helpful_table, table_worth
from ctrplan.robot.robot import Robot

DENSITY = PathDensity(rotation_rad=0.26, translation_m=8e-3, motion_m=15e-3)


@pytest.fixture(scope="module")
def pair() -> Robot:
    return load_robot(ROBOTS / "table_5_pair.toml")


@pytest.fixture(scope="module")
def grid(pair: Robot, tmp_path_factory: pytest.TempPathFactory) -> BoundTable:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        told: list[float] = []
        built = tabulated_bounds(pair, progress=told.append)
        assert built is not None
        assert told == sorted(told)
        assert told[-1] == 1.0
        again = tabulated_bounds(pair, build=False)
        assert again is not None
        np.testing.assert_array_equal(again.values, built.values)
    return built


def joints(robot: Robot, seed: int, count: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    drive = robot.drive
    low, high = np.where(drive.wraps, -np.pi, drive.lower), np.where(drive.wraps, np.pi, drive.upper)
    return rng.uniform(low, high, (count, len(drive.joints)))


def test_looked_up_bounds_stay_above_the_true_ones_within_the_stated_error(pair: Robot, grid: BoundTable) -> None:
    collars = pair.drive.collars(joints(pair, 1, 120))
    bounds = pair.bound_many(*collars)
    samples = [
        grid.check_path(theta[None], l_b[None], None, density=DENSITY, limits=PathLimits())
        for theta, l_b in zip(*collars, strict=True)
    ]
    found = np.array([s.position_m[0] for s in samples])
    covered = np.array([s.status[0] == Status.CONVERGED for s in samples]) & (bounds.status != Status.FAILED)
    assert covered.mean() > 0.9
    short = (bounds.position_m - found)[covered]
    assert (short > 0).mean() < 0.05
    assert short.max() < max(grid.error.largest_m, 0.2e-3)
    assert np.median(-short) < 1.5 * grid.error.margin_m  # nor far above them
    tips = np.array([s.tip_m[0] for s in samples])
    assert np.quantile(np.linalg.norm(tips - bounds.tip_m, axis=1)[covered], 0.9) < 0.2e-3


def test_common_rotation_turns_the_looked_up_shape(pair: Robot, grid: BoundTable) -> None:
    theta, l_b = pair.drive.collars(joints(pair, 2, 1))
    angle = 1.1
    c, s = np.cos(angle), np.sin(angle)
    first, turned = (
        grid.check_path(theta + shift, l_b, None, density=DENSITY, limits=PathLimits()) for shift in (0, angle)
    )
    np.testing.assert_allclose(
        turned.tip_m[0], np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ first.tip_m[0], atol=1e-8
    )
    assert turned.position_m[0] == pytest.approx(first.position_m[0], rel=1e-6)


def test_clearance_to_a_wall_is_that_of_the_model(pair: Robot, grid: BoundTable) -> None:
    """A wall at x = 0.1 m: the field holds distances to it."""
    x = np.arange(-60, 61) * 5e-3
    walls = np.broadcast_to((0.1 - x)[:, None, None], (121, 121, 121)).astype(np.float32)
    wall = Field(np.ascontiguousarray(walls), np.full(3, -0.3), 5e-3, np.eye(3), np.zeros(3))
    theta, l_b = pair.drive.collars(joints(pair, 3, 12))
    compared = 0
    for row in range(12):
        exact = pair.mechanics.check_path(theta[row : row + 1], l_b[row : row + 1], wall, density=DENSITY)
        found = grid.check_path(theta[row : row + 1], l_b[row : row + 1], wall, density=DENSITY, limits=PathLimits())
        if found.status[0] != Status.CONVERGED:
            continue
        compared += 1
        difference = exact.clearance_m[0] - found.clearance_m[0]
        assert -0.1e-3 < difference < 2 * grid.error.margin_m + 0.6 * exact.position_m[0] + 0.2e-3
    assert compared >= 10


def test_the_mirrored_half_is_what_the_model_says(pair: Robot, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Only half of a planar robot's grid is solved."""
    monkeypatch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path))
    assert not fields._is_planar(pair)
    pair = load_robot(ROBOTS / "table_1_pair.toml")
    assert fields._is_planar(pair)
    grid = tabulated_bounds(pair)
    assert grid is not None
    axes = grid.axes
    rng = np.random.default_rng(6)
    rows = rng.choice(len(grid.values), 20, replace=False)
    grids = np.meshgrid(*[axis.lower + axis.step * np.arange(axis.count) for axis in axes], indexing="ij")
    coordinates = np.stack([values.ravel() for values in grids], axis=1)[rows]
    theta, l_b = fields._collars(pair, axes, coordinates)
    nested = nests(pair.tubes, l_b) & (grid.values[rows, FieldLookup.VALID] > 0)
    solved = pair.mechanics.field_entries(theta[nested], l_b[nested])
    assert nested.sum() >= 10
    opposed = np.abs(np.abs(coordinates[nested, 0]) - np.pi) < 1e-9  # there two mirrored solutions may exist
    np.testing.assert_allclose(grid.values[rows[nested]][~opposed], solved[~opposed], atol=2e-5)


def test_a_walk_is_as_dense_as_asked_for(pair: Robot, grid: BoundTable) -> None:
    theta, l_b = pair.drive.collars(joints(pair, 4, 2))
    samples = grid.check_path(theta, l_b, None, density=DENSITY, limits=PathLimits())
    assert samples.fraction[0] == 0
    assert samples.status[-1] == Status.CONVERGED and samples.fraction[-1] == 1
    assert len(samples.fraction) > 10 and np.all(samples.motion_m <= DENSITY.motion_m)


def test_a_walk_ends_at_the_first_broken_limit(pair: Robot, grid: BoundTable) -> None:
    theta, l_b = pair.drive.collars(joints(pair, 5, 2))
    free = grid.check_path(theta, l_b, None, density=DENSITY, limits=PathLimits())
    limit = float(np.median(free.stability))
    first = int(np.flatnonzero(free.stability < limit)[0])
    samples = grid.check_path(theta, l_b, None, density=DENSITY, limits=PathLimits(stability=limit))
    assert 0 < first < len(free.status) - 1 and len(samples.status) == first + 1
    np.testing.assert_array_equal(samples.stability, free.stability[: first + 1])


def test_a_plan_searched_with_the_field_is_certified_by_the_model(pair: Robot, grid: BoundTable) -> None:
    free = load_scenario(ROBOTS.parent / "pair_free.toml")
    assert free.robot.path == pair.path
    found = plan(free, time_s=1.0, bound_table=grid)
    assert found.certificate.valid
    assert any(grid.key in note for note in found.notes)
    theta_b, l_b = free.robot.drive.collars(found.legs[-1].end)
    closely = pair.bound(theta_b, l_b, accuracy="certificate").position_m
    assert found.certificate.goal_bound_m == pytest.approx(closely + bound_allowance_m(pair, "certificate"), abs=1e-6)


def test_another_robot_has_another_field(pair: Robot, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path))
    other = replace(pair, tubes=(replace(pair.tubes[0], poisson_ratio=0.1), *pair.tubes[1:]))
    assert tabulated_bounds(other, build=False) is None
    assert fields._key(pair, choose_axes(pair)) != fields._key(other, choose_axes(other))


def test_base_poses_share_the_field() -> None:
    """It belongs to the robot: wherever it stands, and whatever is around it."""
    bases = ([], ["base.position_mm=[5, -3, 12]", "base.direction=[0.2, 0, 1]"])
    robots = [load_scenario(ROBOTS.parent / "pair_free.toml", base).robot for base in bases]
    keys = {fields._key(robot, choose_axes(robot)) for robot in robots}
    assert robots[0] is not robots[1] and len(keys) == 1


def test_which_tubes_move_together_is_part_of_the_key() -> None:
    robot = load_robot(ROBOTS / "three_tube.toml")
    last = robot.drive.joints[-1]
    assert not np.array_equal(last.moves, [0, 1, 1])
    joints = (*robot.drive.joints[:-1], replace(last, moves=np.array([0.0, 1.0, 1.0])))
    other = replace(robot, drive=replace(robot.drive, joints=joints))
    axes = choose_axes(robot)
    assert fields._key(robot, axes) != fields._key(other, axes)


@pytest.mark.parametrize(
    ("effect", "sentence"),
    [
        ({"tip_load": {"force_x_N": 1.0}}, "loads with a direction of their own"),
        ({"homing_offset": {"l_2_mm": -1.0}}, "effects of the drive"),
    ],
)
def test_robots_that_such_a_grid_is_wrong_for_have_none(pair: Robot, effect: dict[str, object], sentence: str) -> None:
    robot = robot_from_dict({**pair.content, "effects": effect})
    with pytest.raises(InputError, match=f"{sentence}.*no bound field") as refusal:
        tabulated_bounds(robot)
    assert str(refusal.value).count(".") <= 2 and known_table(robot) is None


def test_a_grid_that_would_be_too_large_is_refused_with_its_size() -> None:
    robot = load_robot(ROBOTS / "three_tube.toml")
    loose = robot.drive.joints[-1]
    free = [replace(loose, name=f"push {i}", moves=np.eye(3)[i], lower=-0.5, upper=0.0) for i in range(3)]
    drive = replace(robot.drive, joints=(*robot.drive.joints[:3], *free))
    with pytest.raises(InputError, match="points .* over 5 coordinates"):
        choose_axes(replace(robot, drive=drive))


def test_malformed_grids_are_refused(pair: Robot) -> None:
    with pytest.raises(InputError, match="do not fit"):
        FieldLookup(pair.mechanics, [(1, True, -np.pi, 0.1, 63)], np.zeros((5, FieldLookup.NUMBERS), np.float32), 0.0)


@pytest.mark.parametrize("unknown", [np.nan, np.inf])
def test_joints_that_are_no_numbers_have_no_answer(grid: BoundTable, unknown: float) -> None:
    found = grid.lookup.sample([[0.0, unknown], [0.0, 1.0]], [[0.0, -0.06], [0.0, unknown]])
    assert not found.valid.any()


def test_configurations_of_another_number_of_tubes_are_refused(grid: BoundTable) -> None:
    for joints in (np.zeros((2, 3)), np.zeros(2)):
        with pytest.raises(InputError, match="must have shape"):
            grid.lookup.sample(joints, joints)


def field_command(robot_file: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    code = main(["field", str(robot_file), "--quiet"])
    return code, capsys.readouterr().err


@pytest.mark.parametrize("place", ["/proc/cache", "file"])
def test_a_field_that_cannot_be_kept_is_told_before_it_is_built(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path / place))  # an absolute place stays what it is
    monkeypatch.setattr(fields, "_solve", lambda *_: pytest.fail("built for nothing"))
    code, sentence = field_command(ROBOTS / "table_5_pair.toml", capsys)
    assert (
        code == 1 and sentence.startswith("ctrplan: the bound field could not be kept: ") and sentence.count("\n") == 1
    )


def test_a_full_disk_is_no_success_either(
    grid: BoundTable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path))
    table = np.vstack([grid.values, np.zeros((1, FieldLookup.NUMBERS), np.float32)])
    monkeypatch.setattr(fields, "_solve", lambda *_: table)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("ctrplan.storage.cache.os.replace", full)
    code, sentence = field_command(ROBOTS / "table_5_pair.toml", capsys)
    assert code == 1 and "was built but not kept" in sentence and os.strerror(errno.ENOSPC) in sentence


def test_what_is_said_of_a_damaged_field_is_what_happens(
    grid: BoundTable,
    pair: Robot,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path))
    table = np.vstack([grid.values, np.zeros((1, FieldLookup.NUMBERS), np.float32)])
    monkeypatch.setattr(fields, "_solve", lambda *_: table)
    assert tabulated_bounds(pair) is not None
    (stored,) = (tmp_path / "fields").glob("*.grid")
    stored.write_bytes(stored.read_bytes()[:1000])
    assert known_table(pair) is None
    assert "is not used, `ctrplan field` builds it again" in caplog.text and "rebuilt" not in caplog.text
    caplog.clear()
    assert tabulated_bounds(pair) is not None
    assert "will be rebuilt" in caplog.text and known_table(pair) is not None


def test_a_field_that_answers_nothing_says_so_and_is_not_used(
    grid: BoundTable, pair: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path))
    empty = np.zeros((len(grid.values) + 1, FieldLookup.NUMBERS), np.float32)
    empty[-1, :3] = fields._measure(pair, grid.axes, empty[:-1])
    monkeypatch.setattr(fields, "_solve", lambda *_: empty)
    assert main(["field", str(ROBOTS / "table_5_pair.toml"), "-o", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "an answer for none" in told and "mm" not in told
    assert (tmp_path / "out" / "report.html").exists() and known_table(pair) is None


def test_a_field_is_used_where_it_saves_more_than_it_spoils(grid: BoundTable, monkeypatch: pytest.MonkeyPatch) -> None:
    free = load_scenario(ROBOTS.parent / "pair_free.toml")
    good = table_worth(free, grid)
    assert good == table_worth(free, grid)  # counted, not timed
    assert good.helps and good.work < 0.5 and good.lost < 0.1 and "it is used" in good.sentence
    empty = table_worth(free, replace(grid, values=np.zeros_like(grid.values)))
    assert empty.work > 1 and empty.lost == 0 and not empty.helps and "left alone" in empty.sentence  # asked in vain
    patchy = grid.values.copy()
    patchy[::7] = 0  # next to all of them it has no answer
    wide = replace(grid, values=patchy, error=replace(grid.error, margin_m=20e-3))
    assert table_worth(free, wide).lost > good.lost and good.work < table_worth(free, wide).work
    for table, used in ((grid, grid), (replace(grid, values=np.zeros_like(grid.values)), None), (None, None)):
        monkeypatch.setattr("ctrplan.planning.table_worth.known_table", lambda _, table=table: table)
        found, sentence = helpful_table(free)
        assert found is used and bool(sentence) == (table is not None)


def test_what_looked_up_costs_spoil() -> None:
    true = np.random.default_rng(0).random(9)
    assert _lost(true, 3 * true + 1) == 0 and _lost(true, -true) == 1 and _lost(true[:1], true[:1]) == 0
    swapped = np.array([2.0, 1.0, 5.0])
    assert _lost(np.array([1.0, 2.0, 5.0]), swapped) == pytest.approx(1 / (1 + 4 + 3))


def test_the_command_says_plainly_that_a_field_is_poor(grid: BoundTable, capsys: pytest.CaptureFixture[str]) -> None:
    _print_errors(grid)
    plain = capsys.readouterr().out
    _print_errors(replace(grid, error=FieldError(17.6e-3, 30e-3, 0.39)))
    poor = capsys.readouterr().out
    assert "17.60 mm" in poor and "39.0 %" in poor and "say little" in poor and "say little" not in plain
    assert "measures" in poor and f"{grid.median_m * 1e3:.2f} mm" in poor
