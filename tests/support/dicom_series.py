"""A volume as a DICOM series: a file for each slice, with the tags that say where it is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK

from ctrplan.anatomy.image_file import kept_locale


@kept_locale()
def write_series(folder: Path, made: Any, uid: str, skip: int = -1, order: int = 1) -> None:
    writer = SimpleITK.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    direction = np.array(made.GetDirection()).reshape(3, 3)
    for k in range(made.GetSize()[2]):
        if k == skip:
            continue
        one = made[:, :, k]
        position = made.TransformIndexToPhysicalPoint((0, 0, k))
        tags = {
            "0008|0060": "CT",
            "0008|103e": f"series {uid}",
            "0020|000e": f"1.2.826.{uid}",
            "0020|000d": "1.2.826.9",
            "0008|0018": f"1.2.826.{uid}.{k + 1}",
            "0020|0013": str(k),
            "0020|0032": "\\".join(f"{x:.9f}" for x in position),
            "0020|0037": "\\".join(f"{x:.12f}" for x in direction[:, :2].T.ravel()),
        }
        for key, value in tags.items():
            one.SetMetaData(key, value)
        writer.SetFileName(str(folder / f"{uid}_{order * k + 500}.dcm"))
        writer.Execute(one)
