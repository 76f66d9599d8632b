"""Images that several structures are taken from are read once: kept while a scenario is made of them, and no longer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from ctrplan.anatomy.images.image import Image

MOST_BYTES = 600_000_000  # of voxels that are kept; what was read last stays
Key = tuple[Path, int, int]  # with size and time of writing
_KEPT: ContextVar[dict[Key, Image] | None] = ContextVar("kept", default=None)


@contextmanager
def images_kept() -> Iterator[None]:
    """Within it an image that was read is not read again, unless its file has changed or others took its room."""
    if _KEPT.get() is not None:
        yield
        return
    before = _KEPT.set({})
    try:
        yield
    finally:
        _KEPT.reset(before)


def image_of(path: Path) -> Image:
    """The image of a file, read where it is not kept. Raises ImageRefusal."""
    from ctrplan.anatomy.images.image_file import read_image  # readers, which few scenarios need

    images = _KEPT.get()
    if images is None:
        return read_image(path)
    told = path.stat()
    key = (path.resolve(), told.st_size, told.st_mtime_ns)
    if key not in images:
        images[key] = read_image(path)
        while len(images) > 1 and sum(image.voxels.nbytes for image in images.values()) > MOST_BYTES:
            del images[next(iter(images))]
    return images[key]
