"""A small volume whose place is known, as files of the field have it: what every reader has to give back."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ctrplan.anatomy.image import Image

Array = Any
SIZE, SPACING = (12, 14, 10), np.array([0.8, 0.9, 1.1])
TURN = Rotation.from_rotvec([0.2, -0.1, 0.4]).as_matrix()
AFFINE = np.column_stack([TURN * SPACING, [-30.0, 12.0, -44.0]])  # of indices to RAS mm
VOXELS = np.zeros(SIZE, np.int16)  # (nx, ny, nz)
VOXELS[3:7, 4:9, 2:6] = 3
VOXELS[0, 0, 0] = 5
PLACE = AFFINE[:, :3] @ [4.5, 6.0, 3.5] + AFFINE[:, 3]


def check(image: Image, sign: Array = 1.0, values: Any = (0, 3, 5)) -> None:
    assert np.unique(image.voxels).tolist() == list(values)
    z, y, x = np.nonzero(image.voxels == values[1])
    place = image.place_m(np.column_stack([x, y, z]).astype(float)).mean(axis=0) * 1e3
    np.testing.assert_allclose(place * sign, PLACE, atol=1e-4)
