"""From where a mesh is looked at when it is shown alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from annotator.placing.upright import round_axis

Array = NDArray[np.float64]

# From the front right and above: of the three sides of a thing most people draw these.
AZIMUTH_DEG, ELEVATION_DEG = 35.0, 24.0


def front_rotation(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Array:
    """(3, 3) mesh axes into eye axes (x right, y down, z forward), the mesh standing upright.

    Data sets differ in which axis is up: z where nothing speaks against it, else the axis about
    which the mesh is nearly round, as bottles, cans, bowls and mugs are.
    """
    axis = round_axis(vertices, faces)
    up = np.eye(3)[2 if axis is None else axis]
    side = np.roll(up, 1)
    front = np.cross(up, side)
    azimuth, elevation = np.deg2rad([AZIMUTH_DEG, ELEVATION_DEG])
    across = np.sin(azimuth) * side - np.cos(azimuth) * front
    forward = -(np.cos(elevation) * across + np.sin(elevation) * up)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation: Array = np.stack([right, np.cross(forward, right), forward])
    return rotation
