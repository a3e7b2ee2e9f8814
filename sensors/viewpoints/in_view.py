"""Which objects a view is too narrow for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3


@dataclass(frozen=True, kw_only=True)
class ViewMargins:
    """Part of the image, as shares of its width and height, that an object's centre must lie in.

    The defaults are those of the DREDS generator.
    """

    horizontal: tuple[float, float] = (0.03, 0.97)
    vertical: tuple[float, float] = (0.05, 0.95)

    def __post_init__(self) -> None:
        for name in ("horizontal", "vertical"):
            low, high = getattr(self, name)
            if not 0 <= low < high <= 1:
                raise ToolkitError("must rise within 0..1", field=name, value=(low, high))


def hidden_objects(
    T_world_cam: SE3,
    camera: Camera,
    centres: Mapping[int, ArrayLike],
    margins: ViewMargins | None = None,
) -> tuple[int, ...]:
    """Ids of the objects that are left out of a view because their centre is at its edge or beyond.

    An object of which a sliver reaches into the image would count as one that a method missed.

    Args:
        T_world_cam: of the view.
        camera: intrinsics; a share of 0 is the outer edge of the first pixel.
        centres: (3,) of every object in the world, metres, by instance id.
        margins: what lies outside is left out.

    Returns:
        Rising ids.
    """
    margins = margins or ViewMargins()
    T_cam_world = T_world_cam.inverse()
    hidden = []
    for key, centre in centres.items():
        u, v = camera.project(T_cam_world @ np.asarray(centre, dtype=np.float64))
        x, y = (u + 0.5) / camera.width, (v + 0.5) / camera.height
        # Comparisons with the NaN of a point behind the camera are false.
        if not (
            margins.horizontal[0] <= x <= margins.horizontal[1]
            and margins.vertical[0] <= y <= margins.vertical[1]
        ):
            hidden.append(key)
    return tuple(sorted(hidden))
