"""The renderer's laws on bodies whose picture is known, and films of a plan read back."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from written_plan_files import write_small_plan

from ctrplan.__main__ import main
from ctrplan.anatomy.patient_frame import Frame
from ctrplan.base.surface import Surface, capsule
from ctrplan.errors import InputError
from ctrplan.files.plan_file import WrittenPlan
from ctrplan.plans.plan import Plan
from ctrplan.reports.plan_scene import WrittenMotion, written_motion
from ctrplan.reports.render.camera import VIEWS, camera_of, look_at, robot_points
from ctrplan.reports.render.film import film, film_suffix, letters, stated_error_m, write_film
from ctrplan.reports.render.rasteriser import Body, Camera, Stage, fragments
from ctrplan.reports.slicer_case import case_files

SIZE = 120
UP = np.array([0.0, 0.0, 1.0])
WHITE = np.ones((2, 3))


def camera(apart_m: float = 0.1) -> Camera:
    return look_at(np.array([-apart_m, 0.0, 0.0]), np.zeros(3), UP, half_view=0.5)


def square(x_m: float, half_m: float, colour: list[float], opacity: float = 1.0) -> Body:
    """Upright, facing the camera, at a place along its line of sight."""
    corners = np.array([[x_m, -half_m, -half_m], [x_m, half_m, -half_m], [x_m, half_m, half_m], [x_m, -half_m, half_m]])
    return Body(Surface(corners, np.array([[0, 1, 2], [0, 2, 3]])), np.array(colour), opacity, opacity)


def picture(bodies: list[Body], still: int = 0) -> np.ndarray:
    return Stage(bodies[:still], camera(), SIZE, SIZE, 1, WHITE).with_moving(bodies[still:])


def test_a_square_covers_the_pixels_that_it_should_each_once() -> None:
    found = fragments(square(0.0, 0.02, [1, 0, 0]), camera(), SIZE, SIZE)
    assert len(np.unique(found.pixel)) == len(found.pixel)  # also along the edge that its triangles share
    assert len(found.pixel) == 48**2  # 0.02 m to either side of 0.1 m x 0.5, of half the picture


def test_a_ball_is_as_large_as_its_outline() -> None:
    radius_m, apart_m = 0.02, 0.1
    ball = Body(capsule(np.zeros(3), np.zeros(3), radius_m, 96), np.ones(3))
    found = fragments(ball, camera(apart_m), SIZE * 4, SIZE * 4)
    seen = radius_m / np.sqrt(apart_m**2 - radius_m**2) / 0.5 * SIZE * 2  # radius of its outline in pixels
    assert len(np.unique(found.pixel)) == pytest.approx(np.pi * seen**2, rel=5e-3)


@pytest.mark.parametrize("still", [0, 1, 2])
@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_what_is_nearer_covers_what_is_behind(order: tuple[int, int], still: int) -> None:
    bodies = [square(0.0, 0.01, [1, 0, 0]), square(0.02, 0.02, [0, 0, 1])]
    image = picture([bodies[k] for k in order], still)
    red, blue = image[SIZE // 2, SIZE // 2], image[SIZE // 2, SIZE // 2 - 15]
    assert red[0] > 2 * red[2] and blue[2] > 2 * blue[0]
    assert np.all(image[2, 2] == 255)


@pytest.mark.parametrize("still", [0, 1, 2])
def test_glass_lets_through_what_it_does_not_cover(still: int) -> None:
    glass, wall = square(0.0, 0.03, [1, 0, 0], 0.25), square(0.02, 0.03, [0, 0, 1])
    middle = (SIZE // 2, SIZE // 2)
    alone = [picture([body])[middle].astype(float) for body in (square(0.0, 0.03, [1, 0, 0]), wall)]
    np.testing.assert_allclose(picture([glass, wall], still)[middle], 0.25 * alone[0] + 0.75 * alone[1], atol=2)


def test_two_lines_of_sight_meet_at_the_same_pixel_whatever_the_shape_is_clipped_by() -> None:
    """A floor that goes on behind the eye fills all pixels below the horizon."""
    floor = np.array([[-5.0, -5, -0.02], [5, -5, -0.02], [5, 5, -0.02], [-5, 5, -0.02]])
    body = Body(Surface(floor, np.array([[0, 1, 2], [0, 2, 3]])), np.ones(3))
    found = fragments(body, camera(), SIZE, SIZE)
    rows = np.bincount(found.pixel // SIZE, minlength=SIZE)
    assert rows[: SIZE // 2].sum() == 0 and np.all(rows[SIZE // 2 + 2 :] == SIZE)


@pytest.fixture(scope="module")
def motion(plan: Plan) -> WrittenMotion:
    return written_motion(WrittenPlan.of(plan), 3)


@pytest.mark.parametrize("view", ["side", "plate"])
def test_overviews_have_all_of_the_robot_in_them(motion: WrittenMotion, view: str) -> None:
    aspect = 4 / 3
    seen_from = camera_of(view, motion, aspect)(motion.path[0])  # type: ignore[arg-type]
    right, up, forward = seen_from.seen(robot_points(motion)).T
    assert np.all(forward > seen_from.near_m)
    assert np.all(np.abs(up / forward) < seen_from.half_view) and np.all(
        np.abs(right / forward) < seen_from.half_view * aspect
    )


def test_the_endoscope_is_at_the_tip_and_does_not_turn_about_itself(motion: WrittenMotion) -> None:
    seen_from = camera_of("inside", motion, 1.0)
    for pose in motion.path:
        here = seen_from(pose)
        np.testing.assert_allclose(here.eye_m, pose.tip_m)
        np.testing.assert_allclose(here.axes @ here.axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(here.axes) < 0  # right, up, forward
        assert here.axes[2] @ pose.tubes[-1].tangent[-1] == pytest.approx(1)


@pytest.mark.parametrize("view", VIEWS)
def test_pictures_of_a_motion_differ_and_show_the_robot(motion: WrittenMotion, view: str) -> None:
    images = list(film(motion, view, 160, 120))  # type: ignore[arg-type]
    assert [image.shape for image in images] == [(120, 160, 3)] * 3
    assert all(np.any(a != b) for a, b in zip(images[:-1], images[1:], strict=True))
    assert all(len(np.unique(image[20:100].reshape(-1, 3), axis=0)) > 50 for image in images)


def test_the_last_picture_states_what_the_plan_states(motion: WrittenMotion) -> None:
    """Samples have the bounds of a coarser mesh: what a film shows of the goal is the number of plan and report."""
    shown, certificate = stated_error_m(motion), motion.plan.certificate
    assert certificate["goal_bound_m"] > motion.plan.column("bound_m")[-1]  # else this says nothing
    assert shown[-1] == certificate["goal_bound_m"]
    assert np.all(shown <= certificate["worst_bound_m"]) and np.all(shown >= motion.at("bound_m"))


@pytest.mark.parametrize("frame", ["RAS", "LPS"])
def test_letters_stand_where_the_sides_of_the_patient_are(frame: Frame) -> None:
    """Seen from the front, upright, the patient's right is on the left of the picture; from below, front is up."""
    front = np.array([0, 1.0, 0]) if frame == "RAS" else np.array([0, -1.0, 0])
    upright = letters(look_at(0.1 * front, np.zeros(3), UP, 0.5), frame)
    assert {name: np.round(place).tolist() for name, place in upright.items()} == {
        **{"R": [-1, 0], "L": [1, 0]},
        **{"S": [0, 1], "I": [0, -1]},
    }
    below = letters(look_at(-0.1 * UP, np.zeros(3), front, 0.5), frame)
    assert np.round(below["A"]).tolist() == [0, 1] and np.round(below["R"]).tolist() == [-1, 0]


def test_a_gif_plays_all_pictures_at_its_pace(tmp_path: Path) -> None:
    pictures = [np.full((20, 30, 3), shade, np.uint8) for shade in (0, 90, 180, 250)]
    write_film(str(tmp_path / "film.gif"), iter(pictures), fps=10)
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.n_frames == 4 and gif.size == (30, 20)
        for k, wanted in enumerate((0, 90, 180, 250)):
            gif.seek(k)
            assert abs(int(np.asarray(gif.convert("L")).mean()) - wanted) <= 2
            assert k == 3 or gif.info["duration"] == 100


FFMPEG = """#!{python}
import pathlib, sys
data = sys.stdin.buffer.read()
pathlib.Path(sys.argv[-1]).write_bytes(" ".join(sys.argv[1:]).encode() + b"|" + str(len(data)).encode())
"""


def test_ffmpeg_gets_every_picture_and_its_shape(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "ffmpeg"
    program.write_text(FFMPEG.format(python=sys.executable))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    write_film(str(tmp_path / "film.mp4"), iter([np.zeros((20, 30, 3), np.uint8)] * 5), fps=12)
    said, _, count = (tmp_path / "film.mp4").read_text().rpartition("|")
    assert int(count) == 5 * 20 * 30 * 3
    assert "-s 30x20" in said and "-r 12" in said and "libx264" in said


def test_other_files_are_refused_before_anything_is_solved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"must end with .mp4, .gif or .png"):
        film_suffix(str(tmp_path / "film.avi"))
    with pytest.raises(InputError, match="must be in a folder that there is"):
        film_suffix(str(tmp_path / "nowhere" / "film.gif"))
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"pip install ctrplan\[video\]"):
        film_suffix(str(tmp_path / "film.mp4"))


def test_the_command_draws_a_written_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_small_plan(tmp_path)
    command = ["render", str(tmp_path / "plan.json"), "--allow-outside", "-o", str(tmp_path / "goal.png")]
    assert main([*command, "--size", "big"]) == 2
    assert "--size = 'big': must be such as 960x720" in capsys.readouterr().err
    assert main([*command, "--size", "96x64", "--camera", "target"]) == 0
    assert Image.open(io.BytesIO((tmp_path / "goal.png").read_bytes())).size == (96, 64)


def test_a_plan_that_takes_no_time_is_one_picture(make_plan: Callable[..., Plan], tmp_path: Path) -> None:
    rest = written_motion(WrittenPlan.of(make_plan([[0, 0], [0, 0]], robot="robots/table_1_pair.toml")), 5)
    for view in VIEWS:
        (image,) = film(rest, view, 80, 60)  # type: ignore[arg-type]
        write_film(str(tmp_path / "rest.gif"), iter([image]), fps=10)
        with Image.open(tmp_path / "rest.gif") as gif:
            assert gif.size == (80, 60)
    assert "scene.mrml" in case_files(rest, "LPS")
