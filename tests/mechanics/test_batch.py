"""Many bounds at once: the same on threads, in processes, in one piece or in chunks."""

from __future__ import annotations

import multiprocessing
import pickle
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from places import ROBOTS

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.shapes import Bounds, Status
from ctrplan.mechanics.walk import CHUNK, FEWEST, chunks, columns_of, rows_in_a_chunk

PAIR = load_robot(ROBOTS / "table_1_pair.toml")  # two corners: quick


def configurations(count: int) -> tuple[Array, Array]:
    theta_b = np.random.default_rng(3).uniform(-np.pi, np.pi, (count, 2))
    return theta_b, np.tile([0.0, -0.017], (count, 1))


def assert_same(a: Bounds, b: Bounds) -> None:
    for name in columns_of(a):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


class OneAfterTheOther(Executor):
    """The least an executor can be; remembers what was called off."""

    def __init__(self) -> None:
        self.submitted: list[Future[Any]] = []

    def submit(self, work: Any, /, *args: Any, **keys: Any) -> Future[Any]:
        self.submitted.append(Future())
        if len(self.submitted) == 1:
            self.submitted[0].set_result(work(*args, **keys))
        return self.submitted[-1]


def test_mechanics_are_pickled_as_numbers() -> None:
    for name in ("three_tube", "table_5_pair"):
        robot = load_robot(ROBOTS / f"{name}.toml")
        theta_b, l_b = np.arange(robot.n) * 0.7, robot.drive.home_l_m
        again = pickle.loads(pickle.dumps(robot.mechanics))
        assert again.bound(theta_b, l_b).position_m == robot.mechanics.bound(theta_b, l_b).position_m
        assert pickle.loads(pickle.dumps(robot)).bound(theta_b, l_b).position_m == robot.bound(theta_b, l_b).position_m


def test_processes_find_what_threads_find() -> None:
    theta_b, l_b = configurations(150)
    shares: list[float] = []
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=2, mp_context=spawn) as executor:
        theirs = PAIR.bound_many(theta_b, l_b, executor=executor, progress=shares.append)
        certified = PAIR.bound_many(theta_b[:70], l_b[:70], executor=executor, accuracy="certificate")
    assert_same(theirs, PAIR.bound_many(theta_b, l_b))
    assert_same(certified, PAIR.bound_many(theta_b[:70], l_b[:70], accuracy="certificate"))
    assert shares == sorted(shares) and len(shares) == 3 and shares[-1] == 1.0


def test_chunks_change_nothing_but_report() -> None:
    theta_b, l_b = configurations(CHUNK + 40)
    shares: list[float] = []
    whole = PAIR.bound_many(theta_b, l_b, progress=shares.append)
    assert shares == [pytest.approx(CHUNK / (CHUNK + 40)), 1.0]
    for k in (0, CHUNK - 1, CHUNK, CHUNK + 39):
        assert PAIR.bound(theta_b[k], l_b[k]).position_m == whole.position_m[k]
    with ThreadPoolExecutor(2) as executor:
        assert_same(whole, PAIR.bound_many(theta_b, l_b, executor=executor))


@pytest.mark.parametrize("count", [0, 1, 63, 64, 65, 1000])
def test_chunks_cover_every_row_once(count: int) -> None:
    assert [k for chunk in chunks(count, 64) for k in range(count)[chunk]] == list(range(count))


def test_chunks_shrink_as_bounds_grow_dearer() -> None:
    assert rows_in_a_chunk(3, "search") == CHUNK
    sizes = [rows_in_a_chunk(n, "search") for n in (3, 4, 5, 6, 12)]
    assert sizes == sorted(sizes, reverse=True)
    assert rows_in_a_chunk(4, "exact") == sizes[-1] == FEWEST


def test_nothing_to_do_is_done() -> None:
    shares: list[float] = []
    assert PAIR.bound_many(*configurations(0), progress=shares.append).tip_m.shape == (0, 3)
    assert shares == [1.0] or shares == [0.0]
    with ThreadPoolExecutor(1) as executor:
        assert PAIR.bound_many(*configurations(0), executor=executor).tip_m.shape == (0, 3)


def test_a_bad_row_is_refused_by_its_number_before_anything_is_solved() -> None:
    theta_b, l_b = configurations(3 * CHUNK)
    refused: list[float] = []
    for row, column, value, words in ((700, 1, -0.01, "collar"), (600, 0, np.nan, "finite"), (500, 0, -0.2, "plate")):
        l_b[row, column] = value
        if value == -0.2:
            l_b[row, 1] = -0.217
        with pytest.raises(InputError, match=f"row {row}: .*{words}"):
            PAIR.bound_many(theta_b, l_b, progress=refused.append)
        with ThreadPoolExecutor(1) as executor, pytest.raises(InputError, match=f"row {row}: "):
            PAIR.bound_many(theta_b, l_b, progress=refused.append, executor=executor)
    with pytest.raises(InputError, match="same number of rows"):
        PAIR.bound_many(theta_b, l_b[:-1])
    assert not refused


def test_tasks_are_called_off_when_the_caller_gives_up() -> None:
    executor = OneAfterTheOther()

    def give_up(share: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        PAIR.bound_many(*configurations(300), executor=executor, progress=give_up)
    assert len(executor.submitted) == 5
    assert all(future.cancelled() for future in executor.submitted[1:])


def test_a_zero_clearance_shape_has_the_tip_of_many_at_once_and_ends_there() -> None:
    """One configuration's shape is laid out when it is looked at; its tip is known before."""
    robot = load_robot(ROBOTS / "three_tube.toml")
    theta_b = np.random.default_rng(5).uniform(-np.pi, np.pi, (20, robot.n))
    l_b = np.tile(robot.drive.home_l_m, (20, 1))
    tips, tangents, status = robot.mechanics.tips(theta_b, l_b)
    for row in range(20):
        shape = robot.mechanics.zero_clearance(theta_b[row], l_b[row])
        np.testing.assert_allclose(shape.tip_m, tips[row], rtol=0, atol=1e-9)
        np.testing.assert_allclose(shape.tip_tangent, tangents[row], rtol=0, atol=1e-7)
        np.testing.assert_array_equal(shape.tubes[-1].centreline_m[-1], shape.tip_m)
        assert shape.max_strain == max(tube.strain.max() for tube in shape.tubes) > 0
    assert np.isfinite(tips).all()
    assert len(status) == 20


def test_a_row_that_does_not_nest_fails_no_other_one() -> None:
    """Every row has a status: the refused ones are NaN and no number, the others as if those were not there."""
    theta_b, l_b = configurations(400)
    wrong = {0: ("l", np.nan), 7: ("l", 0.01), 133: ("theta", np.inf), 398: ("l", 5.0), 399: ("theta", 1e9)}
    for k, (which, value) in wrong.items():
        (theta_b if which == "theta" else l_b)[k, 1] = value
    bounds = PAIR.bounds(theta_b, l_b)
    assert np.flatnonzero(bounds.status == Status.REFUSED).tolist() == sorted(wrong)
    kept = ~np.isin(np.arange(400), list(wrong))
    for name in columns_of(bounds):
        column = getattr(bounds, name)
        np.testing.assert_array_equal(column[kept], getattr(PAIR.bound_many(theta_b[kept], l_b[kept]), name))
        assert name == "status" or np.isnan(column[~kept]).all()
    for k in wrong:
        with pytest.raises(InputError):
            PAIR.bound(theta_b[k], l_b[k])
    nothing = PAIR.bounds(np.full((3, 2), np.nan), np.zeros((3, 2)))
    assert (nothing.status == Status.REFUSED).all() and len(PAIR.bounds(np.empty((0, 2)), np.empty((0, 2))).status) == 0
    with pytest.raises(InputError, match="shape"):
        PAIR.bounds(np.zeros((3, 3)), np.zeros((3, 2)))


def test_threads_may_share_a_robot() -> None:
    theta_b, l_b = configurations(60)
    rows = list(zip(theta_b, l_b, strict=True))
    asked = (
        lambda row: PAIR.bound(*row).position_m,
        lambda row: tuple(PAIR.solve(*row, 0.5).tip_m),
        lambda row: tuple(PAIR.zero_clearance(*row).tip_m),
        lambda row: PAIR.history().advance(*row).deviation_m,
        lambda row: PAIR.walker().bound(*row).position_m,
    )
    alone = [[ask(row) for row in rows] for ask in asked]
    with ThreadPoolExecutor(4) as pool:
        together = [[pool.submit(ask, row) for row in rows] for ask in asked]
        assert [[future.result() for future in futures] for futures in together] == alone


def test_what_stays_in_its_process_says_how_it_is_made_anew() -> None:
    collars = np.zeros(2), np.array([0.0, -0.017])
    follower = PAIR.observer(1e-3)
    follower.observe(*collars, PAIR.solve(*collars).tip_m)
    for kept, instead in (
        (PAIR.walker(), "Robot.walker"),
        (PAIR.history(), "Robot.history"),
        (follower, "Robot.observer and show it the same rows"),
        (PAIR.mechanics.friction_states(*collars), "Mechanics.friction_states"),
    ):
        with pytest.raises(InputError, match=f"a {type(kept).__name__} stays in its process.*{instead}"):
            pickle.dumps(kept)
    with pytest.raises(InputError, match="a HistoryState stays in its process.*the same path and save that"):
        pickle.dumps(follower.state())
