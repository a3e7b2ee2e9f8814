"""The nearest measurement."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from benchmark.methods.filling.filler import Filler
from std_toolkit.geometry.camera import Camera

Number = TypeVar("Number", bound=np.generic)


class Nearest(Filler):
    """Every missing pixel takes the depth of the measured pixel nearest to it in the image.

    The distance is Euclidean, in pixels. It is the simplest filling there is and the least that
    any other must beat.
    """

    name = "nearest"

    def fill(
        self,
        color: NDArray[np.uint8],  # noqa: ARG002
        depth: NDArray[np.float64],
        missing: NDArray[np.bool_],
        camera: Camera,  # noqa: ARG002
    ) -> NDArray[np.floating]:
        return fill_nearest(depth, missing)


def fill_nearest(values: NDArray[Number], missing: NDArray[np.bool_]) -> NDArray[Number]:
    """(h, w) values, those at missing pixels replaced by that of the nearest other pixel."""
    rows, columns = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return values[rows, columns]
