"""The solver: stability and branches, any number of tubes, repeatability, threads, kernels, and what it refuses."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_up_input import FUZZ
from places import ROBOTS
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot, robot_from_dict
from ctrplan.mechanics.core import Mechanics, kernel_name
from ctrplan.mechanics.history import History
from ctrplan.mechanics.shapes import Accuracy, Status
from ctrplan.mechanics.tube import Contact, Loads, Tube, TubeSection
from ctrplan.mechanics.walk import Field, PathDensity

ROBOT_FILE = ROBOTS / "three_tube.toml"
ROBOT = load_robot(ROBOT_FILE)
THREE_TUBES = ROBOT.mechanics
RETRACTED = [0.0, -0.017, -0.1204]
RESIDUAL = 1e-8  # of EI x precurvature, what the solver promises
GOOD = [0.0, 1.0, 2.0], [0.0, -0.017, -0.08]


def random_joints(seed: int, count: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    l_b = np.tile([0.0, -0.017, 0.0], (count, 1))
    l_b[:, 2] = rng.uniform(-0.1204, -0.034, count)
    return rng.uniform(-np.pi, np.pi, (count, 3)), l_b


def random_robot(n: int, rng: np.random.Generator) -> tuple[Mechanics, Array, Array]:
    """n telescoping tubes, each bent in its own plane, and joints that nest, all bases behind the plate."""
    tubes: list[Tube] = []
    clearance_m = rng.uniform(2e-5, 1e-4, n - 1)
    diameter, base_m, reach_m = 5e-3, rng.uniform(-0.02, 0.0), 0.0
    l_b = []
    for i in range(n):
        reach_m += rng.uniform(0.02, 0.05) + (0.03 if i == 0 else 0)
        curved_m = rng.uniform(0.03, reach_m)
        section = TubeSection(curved_m, *rng.uniform(-8, 8, 2))
        straight = TubeSection(reach_m - base_m - curved_m, 0.0, 0.0)
        wall = rng.uniform(1.5e-4, 3e-4)
        stiffness = 0.1 * (diameter / 5e-3) ** 3
        tubes.append(Tube(diameter, diameter - 2 * wall, stiffness, rng.uniform(-0.3, 0.5), (straight, section), 0.01))
        l_b.append(base_m)
        base_m -= 0.01 + rng.uniform(0, 0.02)
        if i < n - 1:
            diameter -= 2 * (wall + clearance_m[i])
    return Mechanics(tubes, clearance_m, rng.uniform(0, 0.4, n - 1)), rng.uniform(-np.pi, np.pi, n), np.array(l_b)


@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_any_number_of_tubes_solves(n: int) -> None:
    rng = np.random.default_rng(n)
    for _ in range(40 if n < 4 else 12):
        model, theta_b, l_b = random_robot(n, rng)
        bound = model.bound(theta_b, l_b)
        assert len(bound.corners) == 2 ** (n - 1)
        for shape in (bound.frictionless, *bound.corners):
            assert shape.status in (Status.CONVERGED, Status.UNSTABLE)
            assert shape.residual <= RESIDUAL
        assert 0 <= bound.position_m < 0.1


def test_random_configurations_solve() -> None:
    """FAILED at most 1 in 500 here, all among the bistable ones near (0, 0, 180) deg retracted."""
    count = 1500 if FUZZ else 500
    theta_b, l_b = random_joints(7, count)
    bounds = THREE_TUBES.bound_many(theta_b, l_b)
    failed = bounds.status == Status.FAILED
    assert failed.sum() <= count // 500
    assert bounds.residual[~failed].max() <= RESIDUAL
    assert np.array_equal(np.isnan(bounds.position_m), failed)
    assert np.all((bounds.stability > 0) == np.isin(bounds.status, [Status.CONVERGED, Status.MULTIPLE]))


@pytest.mark.parametrize("retraction_m", [0.1204, 0.11, 0.1])
def test_saddle_between_two_shapes_is_called_unstable(retraction_m: float) -> None:
    """Symmetric joints start and stay symmetric; the zero-clearance state is a saddle for l_3b < -92 mm."""
    q = [0.0, 0.0, np.pi], [0.0, -0.017, -retraction_m]
    shape, zero_clearance = THREE_TUBES.solve(*q), THREE_TUBES.zero_clearance(*q)
    assert abs(shape.tip_m[1]) < 1e-6
    assert shape.status is zero_clearance.status is Status.UNSTABLE
    assert shape.stability <= 0


def test_stability_changes_sign_where_the_saddle_begins() -> None:
    theta_b = np.tile([0.0, 0.0, np.pi], (60, 1))
    l_b = np.tile([0.0, -0.017, 0.0], (60, 1))
    l_b[:, 2] = np.linspace(-0.034, -0.1204, 60)
    bounds = THREE_TUBES.bound_many(theta_b, l_b)
    assert np.all(np.diff(bounds.stability) < 1e-3)  # constant while the curved part is in front of everything else
    first = l_b[bounds.stability <= 0, 2][0]
    assert -0.100 < first < -0.092  # clearance delays the 92 mm of the zero-clearance model


def test_stability_falls_to_zero_before_the_robot_snaps() -> None:
    """Small steps without friction: one branch is followed beyond 180 deg, and its stability announces the end."""
    frictionless = Mechanics(ROBOT.tubes, ROBOT.clearance_m, [0.0, 0.0])
    angle = np.deg2rad([[0, 0, 100], [0, 0, 260]])
    density = PathDensity(rotation_rad=0.01, motion_m=1e-3)
    path = frictionless.check_path(angle, np.tile(RETRACTED, (2, 1)), density=density)
    assert path.status[-1] == Status.UNSTABLE
    assert np.all(path.status[:-1] == Status.CONVERGED)
    assert 190 < 100 + 160 * path.fraction[-1] < 200
    assert path.stability[:-1].min() < 0.7
    assert path.motion_m[:-1].max() < 2e-3 < path.motion_m[-1]


def test_a_snap_ends_a_path_whatever_the_density() -> None:
    """The snap from (0, 0, 180) deg to its mirror image moves the tip by 20 mm; default density."""
    frictionless = Mechanics(ROBOT.tubes, ROBOT.clearance_m, [0.0, 0.0])
    for retraction_m in (0.1204, 0.11, 0.1):
        l_b = np.tile([0.0, -0.017, -retraction_m], (2, 1))
        path = frictionless.check_path(np.deg2rad([[0, 0, 100], [0, 0, 260]]), l_b)
        assert path.status[-1] == Status.UNSTABLE


@pytest.mark.parametrize("seed", range(6))
def test_a_path_finds_what_separate_solves_find(seed: int) -> None:
    """Warm starts return the branch and the numbers of cold ones."""
    theta_b, l_b = random_joints(seed, 2)
    theta_b[1] = theta_b[0] + np.array([0.0, 0.8, -0.5])
    if seed % 2:
        l_b[1] = l_b[0]  # rotation alone keeps the mesh
    path = THREE_TUBES.check_path(theta_b, l_b)
    assert path.fraction[-1] == 1
    at = path.fraction[:, None]
    bounds = THREE_TUBES.bound_many(theta_b[0] + at * (theta_b[1] - theta_b[0]), l_b[0] + at * (l_b[1] - l_b[0]))
    np.testing.assert_allclose(path.tip_m, bounds.tip_m, rtol=0, atol=1e-7)
    np.testing.assert_allclose(path.position_m, bounds.position_m, rtol=0, atol=1e-7)
    np.testing.assert_allclose(path.stability, bounds.stability, rtol=1e-2)


@pytest.mark.parametrize(
    "l_b",
    [
        *([l_1, -0.0604] for l_1 in (-1e-17, -1e-9, -9e-6)),  # a collar that is taken to stand at the plate
        [0.0, -9e-6],
        [-9e-6, -1.8e-5],  # collars that are taken to stand at one place, the plate a third
    ],
)
def test_a_base_turns_with_its_actuator_wherever_the_mesh_puts_its_collar(l_b: list[float]) -> None:
    section = TubeSection(0.15, 0.0, 1 / 0.15)
    tubes = [Tube(2.64e-3, 2.39e-3, 0.0507, 0.3, (section,)), Tube(2.305e-3, 1.95e-3, 0.0507, 0.3, (section, section))]
    model = Mechanics(tubes, [4.25e-5], [0.2])
    path = model.check_path([[0.0, 2.0], [1.0, 2.0]], [l_b, l_b])
    bound = model.bound([1.0, 2.0], l_b)
    np.testing.assert_allclose(path.tip_m[-1], bound.frictionless.tip_m, rtol=0, atol=1e-7)
    assert path.position_m[-1] == pytest.approx(bound.position_m, abs=1e-7)
    history = History(model)
    history.advance([0.0, 2.0], l_b)
    step = history.advance([1.0, 2.0], l_b)
    assert step.shape.tubes[0].theta_rad[0] == pytest.approx(1.0, abs=1e-4)


def test_a_collar_just_behind_the_plate_and_a_joint_just_in_front_of_it_solve() -> None:
    tubes = [
        Tube(2.64e-3, 2.39e-3, 0.0507, 0.3, (TubeSection(0.15, 0.0, 1 / 0.15),)),
        Tube(2.305e-3, 1.95e-3, 0.0507, 0.3, (TubeSection(0.017, 0.0, 0.0), TubeSection(0.15, 0.0, 1 / 0.15))),
    ]
    model = Mechanics(tubes, [4.25e-5], [0.2])
    bound = model.bound([0.0, 2.0], [-9e-6, -0.017 + 3e-6])
    assert bound.position_m == pytest.approx(model.bound([0.0, 2.0], [0.0, -0.017]).position_m, abs=1e-5)


def test_an_outer_tube_that_ends_at_the_plate_leaves_the_zero_clearance_model_finite() -> None:
    bent = TubeSection(0.15, 0.0, 1 / 0.265)
    tubes = [
        Tube(2.64e-3, 2.39e-3, 0.0507, 0.3, (bent,)),
        Tube(2.305e-3, 1.95e-3, 0.0507, 0.3, (TubeSection(0.067, 0.0, 0.0), bent)),
        Tube(1.825e-3, 1.6e-3, 0.0145, 0.3, (TubeSection(0.184, 0.0, 0.0), TubeSection(0.0864, 0.0, 1 / 0.055))),
    ]
    model = Mechanics(tubes, [4.25e-5, 6.25e-5], [0.2, 0.2])
    near, beyond = (
        model.zero_clearance([0.0, 1.0, 2.0], [-0.15 + inside_m, -0.18, -0.22]) for inside_m in (5e-8, 1e-6)
    )
    assert near.status == Status.CONVERGED
    np.testing.assert_allclose(near.tip_m, beyond.tip_m, rtol=0, atol=1e-5)


def test_a_walk_over_the_fold_of_a_corner_mirrors() -> None:
    """Lanes that repeat a corner go on from where it was found, too."""
    tubes = [
        Tube(2.64e-3, 2.39e-3, 0.0507, 0.3, (TubeSection(0.15, 0.0, 10.7),)),
        Tube(2.305e-3, 1.95e-3, 0.0507, 0.3, (TubeSection(0.03, 0.0, 0.0), TubeSection(0.15, 0.0, 10.7))),
    ]
    model = Mechanics(tubes, [4.25e-5], [0.41])
    walked = []
    for direction in (1, -1):
        theta_b = [[0.0, np.pi - 0.4 * direction], [0.0, np.pi + 0.4 * direction]]
        density = PathDensity(rotation_rad=0.00501, motion_m=1.0, near_m=1.0)
        walked.append(model.check_path(theta_b, [[0.0, -0.02]] * 2, density=density))
    np.testing.assert_allclose(walked[0].position_m, walked[1].position_m, rtol=0, atol=1e-5)
    assert walked[0].position_m.max() > 0.1 > walked[0].position_m[0] > 0


def test_the_motion_between_samples_is_that_of_every_shape() -> None:
    """A certificate takes half of it off a clearance, which is that of corners too."""
    for seed in range(4):
        theta_b, l_b = random_joints(seed, 2)
        l_b[1], theta_b[1] = l_b[0], theta_b[0] + [0.0, 1.0, -2.0]
        path = THREE_TUBES.check_path(theta_b, l_b, density=PathDensity(motion_m=5e-4, near_m=5e-4))
        moved = np.linalg.norm(np.diff(path.corner_tip_m, axis=0), axis=2).max(axis=1)
        assert np.all(moved <= path.motion_m[1:] + 1e-9)
        assert path.motion_m.max() <= 5e-4  # no corner leaps here


def test_the_body_of_a_walk_reaches_the_tip_of_the_outer_tube() -> None:
    """Which stands beside the inner tube's centreline by up to the clearance."""
    section = TubeSection(0.15, 0.0, 1 / 0.15)
    tubes = [
        Tube(2.64e-3, 2.39e-3, 0.0507, 0.3, (section,)),
        Tube(1.79e-3, 1.5e-3, 0.0507, 0.3, (TubeSection(0.05, 0.0, 0.0), section), collar_length_m=0.017),
    ]
    model = Mechanics(tubes, [0.3e-3], [0.2])
    joints = [0.0, 2.0], [0.0, -0.017]
    points = model.check_path(*([row] for row in joints), bodies=True).bodies[0][:, :3]
    shape = model.bound(*joints).frictionless
    tip_m, inside_m = shape.tubes[0].centreline_m[-1], shape.tubes[1].centreline_m
    assert np.linalg.norm(inside_m - tip_m, axis=1).min() > 1e-4
    assert np.linalg.norm(points - tip_m, axis=1).min() < 3e-5  # each tube of a shape is integrated by itself


@pytest.mark.parametrize("accuracy", ["search", "certificate", "exact"])
@pytest.mark.parametrize("force_N", [0.3, 1.0, 3.0, -1.0])
def test_one_tube_under_a_load_is_an_elastica(force_N: float, accuracy: Accuracy) -> None:
    length_m, curvature, stiffness = 0.15, 10.0, 0.01

    def line(reach_m: float) -> Array:
        """Angle, x, z at the tip, if the force bends as it does with the tip at z = reach_m."""

        def slopes(_s: float, y: Array) -> list[float]:
            return [curvature + force_N * (reach_m - y[2]) / stiffness, np.sin(y[0]), np.cos(y[0])]

        return np.asarray(solve_ivp(slopes, (0, length_m), [0.0, 0.0, 0.0], rtol=1e-10, atol=1e-12).y[:, -1])

    reach_m = brentq(lambda z: line(z)[2] - z, 0.0, length_m)
    model = Mechanics(
        [Tube(1.2e-3, 0.9e-3, stiffness, 0.3, (TubeSection(length_m, 0.0, curvature),))],
        [],
        [],
        Loads(tip_force_N=(force_N, 0.0, 0.0)),
    )
    bound = model.bound([0.0], [0.0], accuracy=accuracy)
    assert bound.position_m < 1e-9
    tip_m = [line(reach_m)[1], 0.0, reach_m]
    np.testing.assert_allclose(bound.frictionless.tip_m, tip_m, rtol=0, atol=1e-4)  # bent by 75 mm at 3 N


def test_clearance_along_a_path_is_that_of_the_body() -> None:
    """A field that grows linearly has its least value at a body point, whatever the grid."""
    nodes = np.stack(np.meshgrid(*[np.linspace(-0.3, 0.3, 13)] * 3, indexing="ij"), axis=-1)
    direction = np.array([0.6, 0.64, 0.48])
    field = Field((nodes @ direction + 0.1).astype(np.float32), np.full(3, -0.3), 0.05, np.eye(3), np.zeros(3))
    path = THREE_TUBES.check_path([GOOD[0]], [GOOD[1]], field)
    points, radius_m = THREE_TUBES.body(*GOOD)
    assert path.clearance_m[0] == pytest.approx(np.min(points @ direction + 0.1 - radius_m), abs=1e-4)


def test_answers_repeat_to_the_last_bit() -> None:
    """Also from a workspace that has seen other meshes, and from a fresh model."""
    first = THREE_TUBES.bound(*GOOD)
    THREE_TUBES.bound([0.0, -2.0, 0.3], [0.0, -0.017, -0.1], accuracy="certificate")
    THREE_TUBES.check_path([GOOD[0], [0.0, 1.5, 2.0]], [GOOD[1], GOOD[1]])
    fresh = Mechanics(ROBOT.tubes, ROBOT.clearance_m, ROBOT.friction[:, 1])
    for again in (THREE_TUBES.bound(*GOOD), fresh.bound(*GOOD)):
        assert again.envelope_m.tobytes() == first.envelope_m.tobytes()
        for a, b in zip(again.corners, first.corners, strict=True):
            assert a.centreline_m.tobytes() == b.centreline_m.tobytes()


def test_many_bounds_are_bounds_on_any_number_of_threads() -> None:
    theta_b, l_b = random_joints(8, 24)
    batch, again = (THREE_TUBES.bound_many(theta_b, l_b, threads=threads) for threads in (1, 3))
    for name in ("position_m", "tangent_rad", "stability", "max_strain", "residual", "status", "tip_m", "tip_tangent"):
        np.testing.assert_array_equal(getattr(batch, name), getattr(again, name))
    for k in range(6):
        bound = THREE_TUBES.bound(theta_b[k], l_b[k])
        assert (bound.position_m, bound.tangent_rad) == (batch.position_m[k], batch.tangent_rad[k])
        np.testing.assert_array_equal(bound.frictionless.tip_m, batch.tip_m[k])
        assert bound.frictionless.status == batch.status[k]
    assert THREE_TUBES.bound_many(np.zeros((0, 3)), np.zeros((0, 3))).position_m.shape == (0,)


BASELINE_SCRIPT = """
import sys, numpy as np
from ctrplan.mechanics.core import kernel_name
from ctrplan.files.robot_file import load_robot
joints = np.load(sys.argv[2])
bounds = load_robot(sys.argv[1]).bound_many(joints[0], joints[1])
np.savez(sys.argv[3], tip_m=bounds.tip_m, position_m=bounds.position_m, kernel=kernel_name())
"""


@pytest.mark.skipif(kernel_name() == "baseline", reason="this CPU runs the baseline kernel anyway")
def test_baseline_kernel_agrees(tmp_path: Path) -> None:
    theta_b, l_b = random_joints(9, 30)
    np.save(tmp_path / "joints.npy", np.stack([theta_b, l_b]))
    command = [
        sys.executable,
        "-c",
        BASELINE_SCRIPT,
        *map(str, (ROBOT_FILE, tmp_path / "joints.npy", tmp_path / "out.npz")),
    ]
    # away from the source tree, which would hide the installed package
    subprocess.run(command, env={**os.environ, "CTRPLAN_KERNEL": "baseline"}, cwd=tmp_path, check=True)
    ours, theirs = THREE_TUBES.bound_many(theta_b, l_b), np.load(tmp_path / "out.npz")
    assert str(theirs["kernel"]) == "baseline"
    np.testing.assert_allclose(theirs["tip_m"], ours.tip_m, rtol=0, atol=1e-9)
    np.testing.assert_allclose(theirs["position_m"], ours.position_m, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("theta_b", "l_b", "words"),
    [
        ([0, 1], GOOD[1], r"shape \(3,\)"),
        ([GOOD[0]], GOOD[1], r"shape \(3,\)"),
        ([0, 1, np.nan], GOOD[1], "theta_b of tube 3 = nan rad"),
        ([0, np.inf, 1], GOOD[1], "theta_b of tube 2 = inf rad"),
        (GOOD[0], [0, -0.017, np.nan], "l_b of tube 3 = nan m"),
        (GOOD[0], [1e-3, -0.017, -0.08], "l_b of tube 1 = 0.001 m: must not be in front"),
        (GOOD[0], [0, -0.016, -0.08], "l_b of tube 2 = -0.016 m: must lie behind .* collar"),
        (GOOD[0], [0, -0.017, -0.1205], "l_b of tube 3 = -0.1205 m: must let the tube's tip"),
        (GOOD[0], [-0.2, -0.217, -0.25], "l_b of tube 1 = -0.2 m: must leave the tube's tip"),
    ],
)
def test_joints_that_are_refused(theta_b: list[float], l_b: list[float], words: str) -> None:
    for ask in (THREE_TUBES.bound, THREE_TUBES.solve, THREE_TUBES.zero_clearance, THREE_TUBES.body):
        with pytest.raises(InputError, match=words):
            ask(theta_b, l_b)


def test_robots_and_batches_built_wrongly_by_code_are_refused_in_a_sentence() -> None:
    tubes = ROBOT.tubes
    refused: list[tuple[str, Callable[[], object]]] = [
        (
            r"tube\.2\.inner_diameter_m",
            lambda: Mechanics([tubes[0], replace(tubes[1], inner_diameter_m=1.0)], [1e-4], [0]),
        ),
        (
            r"tube\.2\.poisson_ratio = nan",
            lambda: Mechanics([tubes[0], replace(tubes[1], poisson_ratio=np.nan)], [1e-4], [0]),
        ),
        ("tubes: must be at least one", lambda: Mechanics([], [], [])),
        ("tip_force_N", lambda: Loads(tip_force_N=(1.0, 0.0))),  # type: ignore[arg-type]
        ("gravity_m_s2", lambda: Loads(gravity_m_s2=9.81)),  # type: ignore[arg-type]
        ("lowest and highest", lambda: Contact((0.3, 0.1))),
        ("lowest and highest", lambda: Contact("0.2")),  # type: ignore[arg-type]
        ("contacts = 0: must be 2", lambda: replace(ROBOT, contacts=())),
        ("threads = 1.5", lambda: THREE_TUBES.bound_many([GOOD[0]], [GOOD[1]], threads=1.5)),  # type: ignore[arg-type]
        ("progress = 3", lambda: THREE_TUBES.bound_many([GOOD[0]], [GOOD[1]], progress=3)),  # type: ignore[arg-type]
        ("executor = 3", lambda: THREE_TUBES.bound_many([GOOD[0]], [GOOD[1]], executor=3)),  # type: ignore[arg-type]
        ("phi = 2", lambda: THREE_TUBES.tips_with_friction([GOOD[0]], [GOOD[1]], [[0.5, 2.0]])),
        ("start: must be numbers", lambda: ROBOT.history(("a", "b"))),  # type: ignore[arg-type]
        ("overrides", lambda: load_robot(ROBOT_FILE, "name=x")),
        ("path of a TOML file", lambda: load_robot(None)),  # type: ignore[arg-type]
        ("must be a mapping", lambda: robot_from_dict(None)),  # type: ignore[arg-type]
    ]
    for words, build in refused:
        with pytest.raises(InputError, match=words):
            build()


@pytest.mark.parametrize("phi", [1.01, -2.0, np.nan, [0.0, 1.5], [0.0, 0.0, 0.0], "slipping"])
def test_friction_states_that_are_refused(phi: float) -> None:
    with pytest.raises(InputError, match="phi"):
        THREE_TUBES.solve(*GOOD, phi)


def test_batches_that_are_refused() -> None:
    for ask in (THREE_TUBES.bound_many, THREE_TUBES.tips, THREE_TUBES.check_path):
        with pytest.raises(InputError, match="row 1: theta_b of tube 3 = nan"):
            ask([GOOD[0], [0, 0, np.nan]], [GOOD[1], GOOD[1]])
        with pytest.raises(InputError, match="same number of rows"):
            ask([GOOD[0]], [GOOD[1], GOOD[1]])
        with pytest.raises(InputError, match=r"shape \(K, 3\)"):
            ask(*GOOD)
    with pytest.raises(InputError, match='"search", "certificate" or "exact"'):
        THREE_TUBES.bound(*GOOD, accuracy="best")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("clearance_m", "friction"),
    [([1e-4], [0.1, 0.1]), ([1e-4, -1e-4], [0.1, 0.1]), ([1e-4, 1e-4], [0.1, -0.1]), ([1e-4, np.nan], [0.1, 0.1])],
)
def test_robots_that_are_refused(clearance_m: list[float], friction: list[float]) -> None:
    with pytest.raises(InputError):
        Mechanics(ROBOT.tubes, clearance_m, friction)
