"""The picture of the place for which a mesh was refused: a file that whoever reads the refusal can open."""

from __future__ import annotations

import os
import sys
import tempfile
from contextlib import suppress

from ctrplan.errors import CtrplanError


def tell_picture(error: CtrplanError) -> None:
    """Draws the place of a refused mesh and says where the picture is; nothing for any other error."""
    defect = getattr(error, "defect", None)
    if defect is None:
        return
    from ctrplan.reports.mesh_defect_picture import mesh_defect_png

    with suppress(OSError):  # the sentence has been said, a picture that can't be written is no failure
        png = mesh_defect_png(defect)
        number, name = tempfile.mkstemp(prefix=f"ctrplan_{defect.file.stem[:40]}_", suffix=".png")
        with os.fdopen(number, "wb") as file:
            file.write(png)
        print(f"ctrplan: a picture of the place: {name}", file=sys.stderr)
