"""The pictures of a film: the robot in its anatomy at each pose, with the time and the friction error at that moment.

The anatomy is glass, or a wall where the eye is within it. Letters tell which way the patient's right, left, front,
back, head and feet are for the camera. Pictures become a GIF, an MP4, or one PNG.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import tempfile
import zlib
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ctrplan.anatomy.patient_frame import ENDS, Frame
from ctrplan.base.arrays import Array
from ctrplan.base.surface import Rod, capsule
from ctrplan.certificate.friction_states import bound_allowance_m
from ctrplan.errors import CtrplanError, InputError
from ctrplan.plans.planned_motion import joints_at
from ctrplan.reports import looks
from ctrplan.reports.plan_scene import WrittenMotion
from ctrplan.reports.render.camera import View, camera_of
from ctrplan.reports.render.rasteriser import Body, Camera, Picture, Stage
from ctrplan.reports.robot_surface import RobotPose, anatomy_surface, stand
from ctrplan.reports.words import millimetres
from ctrplan.storage.output_folder import write_atomically


def stated_error_m(motion: WrittenMotion) -> Array:
    """(F,) [m] at each pose: never above what is stated of the way, at the goal what is stated there.

    NaN where the plan has no number.
    """
    walked_m, certificate = motion.at("bound_m"), motion.plan.certificate
    robot = motion.scenario.robot
    joints = joints_at(motion.plan, np.array(motion.times_s))
    fine = robot.mechanics.bound_many(*robot.drive.collars(joints), accuracy="certificate").position_m
    fine = fine + bound_allowance_m(robot, "certificate") + np.nan_to_num(motion.at("parameter_bound_m"))
    result = np.fmax(walked_m, fine)
    if certificate["worst_bound_m"] is not None:
        result = np.minimum(result, certificate["worst_bound_m"])
    if motion.times_s[-1] == motion.plan.time_s[-1] and certificate["goal_bound_m"] is not None:
        result[-1] = certificate["goal_bound_m"]
    return np.asarray(np.where(np.isfinite(walked_m), result, np.nan))


def rgb(colour: str) -> Array:
    """(3,) in [0, 1] of "#RRGGBB"."""
    return np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255


TRIANGLES = 60_000  # of a part of the anatomy
SIDES = 24  # of tubes and their envelope
GLASS = {"avoid": (0.30, 0.85), "inside": (0.06, 0.75)}  # opacity seen squarely and along the surface
PATH_M, MARK_M = 0.0022, 0.009  # thickness of the tip's path and size of targets, shares of the robot's length
LINE_M, APART_M, BEAD_M = 0.8e-3, 5e-3, 0.7e-3  # along the path as a line and as beads, and their size
NEAREST_BEAD = 5.0  # radii: nearer ones would cover what lies ahead
WALL = np.array([0.86, 0.52, 0.46])  # of a lumen seen from inside
SKY = np.stack([rgb("#FFFFFF"), rgb("#E4EAF0")])
DARK = np.stack([rgb("#14090A"), rgb("#14090A")])
SAMPLES = {True: 1, False: 2}  # rays a pixel each way, where the camera moves and where it stands
TEXT = 0.026  # height of letters, of the picture's
COMPASS = 3.0  # letters from the middle of the patient's sides to the picture's edge
SHORTEST_AXIS = 0.25  # of its length that an axis has to show for its letters to be told apart
AXES = (("", "x"), ("", "y"), ("", "z"))  # of an anatomy whose frame nobody says


def film(motion: WrittenMotion, view: View, width: int, height: int) -> Iterator[Picture]:
    """A picture (height, width, 3) for each pose."""
    inside = view == "inside"
    camera, still = camera_of(view, motion, width / height), _still_bodies(motion, inside)
    captions, stage = _captions(motion), None
    for pose, caption in zip(motion.path, captions, strict=True):
        if stage is None or camera(pose) is not stage.camera:
            stage = Stage(still, camera(pose), width, height, SAMPLES[inside], DARK if inside else SKY)
        yield _labelled(stage.with_moving(_moving_bodies(pose, motion, inside)), motion, caption, inside, stage.camera)


def _captions(motion: WrittenMotion) -> list[str]:
    bound, clearance, last = stated_error_m(motion), motion.at("clearance_m"), motion.times_s[-1]
    texts = []
    for time_s, bound_m, clearance_m in zip(motion.times_s, bound.tolist(), clearance.tolist(), strict=True):
        words = [f"{time_s:.1f} of {last:.1f} s"]
        if np.isfinite(bound_m):
            words.append(f"worst-case friction error {millimetres(bound_m)}")
        if np.isfinite(clearance_m):
            words.append(f"clearance {millimetres(clearance_m)}")
        texts.append("    ".join(words))
    return texts


def _labelled(picture: Picture, motion: WrittenMotion, caption: str, inside: bool, camera: Camera) -> Picture:
    image = Image.fromarray(picture)
    draw, size = ImageDraw.Draw(image), max(11, round(TEXT * image.height))
    ink = "#F3ECEA" if inside else looks.INK
    margin = round(0.8 * size)
    halo: dict[str, Any] = {"stroke_width": max(1, size // 9), "stroke_fill": "#1D0F0F" if inside else "#F4F7F9"}
    draw.text((margin, margin), motion.scenario.name, fill=ink, font=_font(size, bold=True), **halo)
    draw.text((margin, image.height - margin), caption, fill=ink, font=_font(size), anchor="ls", **halo)
    _bar(draw, image.size, caption, motion)
    _key(draw, image.width - margin, margin, size, motion, ink, inside, halo)
    corner = (image.width - margin - COMPASS * size, image.height - margin - COMPASS * size)
    frame = motion.scenario.frame
    _draw_compass(draw, corner, (COMPASS - 0.5) * size, camera, frame, _font(round(0.85 * size)), ink, halo)
    return np.asarray(image)


def _bar(draw: ImageDraw.ImageDraw, shape: tuple[int, int], caption: str, motion: WrittenMotion) -> None:
    """How much of the time has passed, along the lower edge."""
    share = float(caption.split(" of ")[0]) / max(motion.times_s[-1], 1e-9)
    draw.rectangle((0, shape[1] - 4, share * shape[0], shape[1]), fill=looks.TIP_PATH.colour)


def _key(
    draw: ImageDraw.ImageDraw,
    right: int,
    top: int,
    size: int,
    motion: WrittenMotion,
    ink: str,
    inside: bool,
    halo: dict[str, Any],
) -> None:
    """Names and colours, in the upper right corner."""
    entries = [looks.TIP_PATH, looks.GOAL_LOOK]
    if not inside:
        tubes = [looks.tube_look(tube) for tube in range(motion.scenario.robot.n)]
        entries = [*tubes, looks.ENVELOPE_LOOK, *entries, *looks.anatomy_looks(motion.scenario)]
    font = _font(round(0.85 * size))
    for row, look in enumerate(entries):
        y = top + round(1.35 * size * row)
        draw.rectangle((right - 0.8 * size, y, right, y + 0.8 * size), fill=look.colour)
        draw.text((right - 1.2 * size, y + 0.4 * size), look.name, fill=ink, font=font, anchor="rm", **halo)


def write_caption(image: Image.Image, text: str) -> None:
    """Writes a line along the lower edge."""
    size = max(11, round(TEXT * image.height))
    place = (0.8 * size, image.height - 0.8 * size)
    halo: dict[str, Any] = {"stroke_width": max(1, size // 9), "stroke_fill": "#F4F7F9"}
    ImageDraw.Draw(image).text(place, text, fill=looks.INK, font=_font(size), anchor="ls", **halo)


@cache
def _font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """DejaVu, which comes with matplotlib."""
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(str(folder / f"DejaVuSans{'-Bold' if bold else ''}.ttf"), size)


def letters(camera: Camera, frame: Frame | None) -> dict[str, tuple[float, float]]:
    """Where each letter stands around a middle: to the right and up, at most 1 away.

    Letters of axes that point to the eye or away from it are left out. Without a frame they are those of x, y and z.
    """
    ends = AXES if frame is None else ENDS[frame]
    places = dict[str, tuple[float, float]]()
    for axis, (minus, plus) in enumerate(ends):
        right, up = float(camera.axes[0, axis]), float(camera.axes[1, axis])
        if np.hypot(right, up) >= SHORTEST_AXIS:
            places |= {plus: (right, up)} | ({minus: (-right, -up)} if minus else {})
    return places


def _draw_compass(
    draw: ImageDraw.ImageDraw,
    middle: tuple[float, float],
    radius: float,
    camera: Camera,
    frame: Frame | None,
    font: ImageFont.FreeTypeFont,
    ink: str,
    halo: dict[str, Any],
) -> None:
    """Draws axes and letters around a pixel, letters `radius` pixels away where axes lie in the picture."""
    for letter, (right, up) in letters(camera, frame).items():
        place = (middle[0] + radius * right, middle[1] - radius * up)
        inner = (middle[0] + 0.7 * radius * right, middle[1] - 0.7 * radius * up)
        draw.line((*middle, *inner), fill=ink, width=max(1, round(radius / 24)))
        draw.text(place, letter, fill=ink, font=font, anchor="mm", **halo)


def _still_bodies(motion: WrittenMotion, inside: bool) -> list[Body]:
    """Anatomy, plate, the tip's path and the targets."""
    return [*_anatomy(motion, inside), *_marks(motion, inside)]


def _moving_bodies(pose: RobotPose, motion: WrittenMotion, inside: bool) -> list[Body]:
    """Tubes, and the envelope of friction around them; an endoscope sees the way that is left instead."""
    if inside:
        return list(_way_ahead(pose, motion))
    tubes = [
        Body(rod.surface(SIDES), rgb(looks.tube_look(tube).colour))
        for tube, rod in enumerate(pose.tubes)
        if rod.radius_m.any()
    ]
    return [*tubes, Body(pose.envelope.surface(SIDES), rgb(looks.ENVELOPE_LOOK.colour), 0.14, 0.6)]


def _anatomy(motion: WrittenMotion, inside: bool) -> Iterator[Body]:
    for part in motion.scenario.anatomy:
        surface = anatomy_surface(part, TRIANGLES)
        if inside:
            yield Body(surface, WALL if part.role == "inside" else rgb(looks.ANATOMY_LOOK["avoid"].colour))
        else:
            yield Body(surface, rgb(looks.ANATOMY_LOOK[part.role].colour), *GLASS[part.role])


def _marks(motion: WrittenMotion, inside: bool) -> Iterator[Body]:
    if inside:
        return
    length = _length(motion)
    yield Body(stand(motion.scenario), rgb(looks.PLATE_LOOK.colour))
    line = _beads(motion.tip_m, LINE_M)
    if len(line) > 1:
        tangent = np.gradient(line, axis=0)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
        yield Body(Rod(line, tangent, np.full(len(line), PATH_M * length)).surface(8), rgb(looks.TIP_PATH.colour))
    for point in motion.targets.values():
        yield Body(capsule(point, point, MARK_M * length, 24), rgb(looks.GOAL_LOOK.colour), 0.75, 1.0)


def _way_ahead(pose: RobotPose, motion: WrittenMotion) -> Iterator[Body]:
    """Beads where the tip will come, and the targets, unless the eye is there."""
    eye, size = pose.tip_m, BEAD_M
    beads = _beads(motion.tip_m, APART_M)
    passed = int(np.argmin(np.linalg.norm(beads - eye, axis=1)))
    marks = [(point, 0.6 * size, looks.TIP_PATH.colour) for point in beads[passed + 1 :]]
    marks += [(point, 1.6 * size, looks.GOAL_LOOK.colour) for point in motion.targets.values()]
    for point, radius, colour in marks:
        if np.linalg.norm(point - eye) > NEAREST_BEAD * radius:
            yield Body(capsule(point, point, radius, 24), rgb(colour))


def _beads(path: Array, apart_m: float) -> Array:
    """(K, 3) points of a path that are about `apart_m` from each other along it, both ends included."""
    s_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0.0, s_m[-1], int(s_m[-1] / apart_m) + 2)
    moves = np.diff(s_m, prepend=-1.0) > 0
    return np.stack([np.interp(at, s_m[moves], column) for column in path[moves].T], axis=1)


def _length(motion: WrittenMotion) -> float:
    line = motion.path[-1].tubes[-1].centreline_m
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


SUFFIXES = (".mp4", ".gif", ".png")
REST_MS = 1200  # of a GIF at the goal, before it starts again
COLOURS, USUAL = 256, 192  # of a GIF
PALETTE_FROM = 6  # pictures


def film_suffix(path: str) -> str:
    """The format by a file's name. Raises InputError for another one, and for a film that nothing here can write."""
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"must end with {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}", key="--output", value=path)
    if not Path(path).absolute().parent.is_dir():
        raise InputError("must be in a folder that there is", key="--output", value=path)
    if suffix == ".mp4":
        ffmpeg(path)
    return suffix


def write_film(path: str, pictures: Iterable[Picture], fps: float) -> None:
    """Writes the file by its name's end, whole or not at all. A PNG is the last picture. Raises CtrplanError."""
    write = {".gif": _gif, ".mp4": _mp4, ".png": _png}[film_suffix(path)]
    write_atomically(path, write(pictures, fps))


def ffmpeg(path: str) -> str:
    """The program that makes MP4: the one on this machine, or that of the extra. Raises InputError without any."""
    if installed := shutil.which("ffmpeg"):
        return installed
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError:
        rule = "needs ffmpeg: pip install ctrplan[video], or write a .gif"
        raise InputError(rule, key="--output", value=path) from None
    program: str = get_ffmpeg_exe()
    return program


def _png(pictures: Iterable[Picture], fps: float) -> bytes:
    *_, last = pictures
    return _encoded(Image.fromarray(last), "png")


def _gif(pictures: Iterable[Picture], fps: float) -> bytes:
    """All with one set of colours, so that what stands still does not flicker; kept packed until those are known."""
    packed = [(picture.shape, zlib.compress(picture.tobytes(), 1)) for picture in pictures]

    def image(k: int) -> Image.Image:
        (height, width, _), content = packed[k]
        return Image.frombytes("RGB", (width, height), zlib.decompress(content))

    last = len(packed) - 1
    colours = _colours([image(k) for k in sorted({*range(0, last, max(1, last // PALETTE_FROM)), last})])
    shown = (image(k).quantize(palette=colours, dither=Image.Dither.NONE) for k in range(last + 1))
    frame_ms = max(20, round(100 / fps) * 10)  # a GIF counts hundredths of a second
    durations = [frame_ms] * last + [REST_MS]
    return _encoded(next(shown), "gif", save_all=True, append_images=shown, duration=durations, loop=0, disposal=1)


def _colours(images: list[Image.Image]) -> Image.Image:
    """An image with the palette: most colours by how often they are there, some by how far they are from others."""
    width, height = images[0].size
    sheet = Image.new("RGB", (width, height * len(images)))
    for row, image in enumerate(images):
        sheet.paste(image, (0, row * height))
    usual = sheet.quantize(USUAL, Image.Quantize.MEDIANCUT).getpalette() or []
    rare = sheet.quantize(COLOURS - USUAL, Image.Quantize.MAXCOVERAGE).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette(usual[: 3 * USUAL] + rare[: 3 * (COLOURS - USUAL)])
    return palette


def _encoded(image: Image.Image, kind: str, **options: object) -> bytes:
    content = io.BytesIO()
    image.save(content, kind, **options)
    return content.getvalue()


def _mp4(pictures: Iterable[Picture], fps: float) -> bytes:
    """H.264 of even width and height, which every player shows."""
    with tempfile.TemporaryDirectory() as folder:
        file, process = Path(folder) / "film.mp4", None
        try:
            for picture in pictures:
                process = process or _encoder(file, picture.shape[1], picture.shape[0], fps)
                process.stdin.write(picture.tobytes())  # type: ignore[union-attr]
        except BrokenPipeError:
            pass  # ffmpeg ended; why is asked below
        except BaseException:
            if process is not None:
                process.kill()
                process.communicate()
            raise
        if process is None or process.communicate() is None or process.returncode or not file.exists():
            raise CtrplanError("ffmpeg could not make the film.")
        return file.read_bytes()


def _encoder(file: Path, width: int, height: int, fps: float) -> subprocess.Popen[bytes]:
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps:g}", "-i", "-"]
    even = ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
    command = [ffmpeg(str(file)), "-loglevel", "error", "-y", *raw, "-c:v", "libx264", "-crf", "20", *even, str(file)]
    quiet = subprocess.DEVNULL
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=quiet)
