"""From where a mesh is looked at when it is shown alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from annotator.placing.dropping import upright_rotation
from std_toolkit.geometry import so3_exp

Array = NDArray[np.float64]

# From the front right and above: of the three sides of a thing most people draw these.
AZIMUTH_DEG, ELEVATION_DEG = 35.0, 24.0


def front_rotation(axis: int) -> Array:
    """(3, 3) mesh axes into eye axes (x right, y down, z forward), the mesh standing upright.

    Args:
        axis: the coordinate axis of the mesh (0, 1, 2) that is up.
    """
    azimuth, elevation = np.deg2rad([AZIMUTH_DEG, ELEVATION_DEG])
    up = np.array([0.0, -np.cos(elevation), -np.sin(elevation)])
    rotation: Array = so3_exp(-azimuth * up) @ upright_rotation(up, axis)
    return rotation
