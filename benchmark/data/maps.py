"""Reading the maps of foreign data sets quickly: depth, masks, NOCS."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import BACKGROUND
from std_toolkit.errors import ToolkitError
from std_toolkit.importers.depth_source import FARTHEST_MEDIAN_M
from std_toolkit.io.exr import read_exr_channel
from std_toolkit.io.images import read_png

# Renderers write 1e10 or the largest half float where a ray meets nothing.
NOTHING_BEYOND_M = 1000.0


def read_depth_map(path: Path) -> NDArray[np.float32]:
    """Depth (H, W) in metres of an EXR file; 0 where nothing was measured.

    NaN, infinity, zero and negative numbers (DREDS writes -0.001) mean that nothing was measured.

    Raises:
        ToolkitError: missing, damaged, no depth, or not in metres.
    """
    stored = read_exr_channel(path, require_equal=True)
    depth = stored.astype(np.float32, copy=False)
    # NaN passes no comparison.
    depth[~((depth > 0) & (depth < NOTHING_BEYOND_M))] = 0
    sample = depth[::8, ::8]
    measured = sample[sample > 0]
    if measured.size and np.median(measured) > FARTHEST_MEDIAN_M:
        raise ToolkitError(
            "the median depth is implausible: the file seems not to be in metres",
            path=path,
            value=f"{np.median(measured):.4g}",
        )
    return depth


def read_id_mask(path: Path) -> NDArray[np.uint8]:
    """Instance ids (H, W) uint8 of a PNG, or of an EXR that holds id/255 in its channel R.

    The EXR's numbers are rounded. Public loaders truncate, which half floats get wrong by one for
    every second id.

    Raises:
        ToolkitError: missing, damaged or no mask.
    """
    if path.suffix == ".exr":
        values = read_exr_channel(path, names=("R",)).astype(np.float32) * np.float32(255)
        low, high = float(values.min()), float(values.max())
        if not (low > -0.5 and high < 255.5):
            raise ToolkitError(
                "a mask in EXR holds id/255 between 0 and 1",
                path=path,
                value=(low / 255, high / 255),
            )
        return np.rint(values).astype(np.uint8)
    image = read_png(path)
    if image.ndim == 3:
        if not (image == image[..., :1]).all():
            raise ToolkitError("a mask holds ids in one channel or in equal ones", path=path)
        image = np.ascontiguousarray(image[..., 0])
    if image.dtype != np.uint8:
        raise ToolkitError("a mask is 8-bit", path=path, value=str(image.dtype))
    return image  # type: ignore[return-value]


def read_binary_mask(path: Path, inside: int) -> NDArray[np.uint8]:
    """A mask that tells only whether, as instance `inside` and `BACKGROUND`.

    Raises:
        ToolkitError: missing, damaged or no mask.
    """
    return np.where(read_id_mask(path) > 0, np.uint8(inside), np.uint8(BACKGROUND))


def read_coord_picture(path: Path, mask: NDArray[np.uint8]) -> NDArray[np.float32]:
    """NOCS (H, W, 3) in 0..1 of an 8-bit picture with R = x, G = y, B = 1 - z; 0 off the objects.

    Raises:
        ToolkitError: missing, damaged, no such picture or of another size than the mask.
    """
    picture = read_png(path, size=(mask.shape[1], mask.shape[0]))
    if picture.ndim != 3 or picture.dtype != np.uint8:
        raise ToolkitError(
            "a NOCS picture is 8-bit RGB", path=path, value=f"{picture.dtype} {picture.shape}"
        )
    nocs = picture.astype(np.float32) / np.float32(255)
    nocs[..., 2] = 1 - nocs[..., 2]
    nocs[mask == BACKGROUND] = 0
    return nocs
