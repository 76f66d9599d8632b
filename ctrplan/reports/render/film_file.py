"""Pictures -> a GIF, an MP4, or one PNG."""

from __future__ import annotations

import io
import shutil
import subprocess
import tempfile
import zlib
from collections.abc import Iterable
from pathlib import Path

from PIL import Image

from ctrplan.errors import CtrplanError, InputError
from ctrplan.reports.render.rasteriser import Picture
from ctrplan.storage.output_folder import write_atomically

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
        ffmpeg()
    return suffix


def write_film(path: str, pictures: Iterable[Picture], fps: float) -> None:
    """Writes the file by its name's end, whole or not at all. A PNG is the last picture. Raises CtrplanError."""
    write = {".gif": _gif, ".mp4": _mp4, ".png": _png}[film_suffix(path)]
    write_atomically(path, write(pictures, fps))


def ffmpeg() -> str:
    """The program that makes MP4: the one on this machine, or that of the extra. Raises InputError without any."""
    if installed := shutil.which("ffmpeg"):
        return installed
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError:
        rule = "needs ffmpeg: pip install ctrplan[video], or write a .gif"
        raise InputError(rule, key="--output", value=".mp4") from None
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
    command = [ffmpeg(), "-loglevel", "error", "-y", *raw, "-c:v", "libx264", "-crf", "20", *even, str(file)]
    quiet = subprocess.DEVNULL
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=quiet)
