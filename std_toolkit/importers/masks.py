"""Foreign instance masks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.depth_source import check_aligned
from std_toolkit.io.exr import exr_size, read_exr
from std_toolkit.io.images import read_png


def read_mask_source(path: Path, *, size: tuple[int, int] | None) -> np.ndarray:
    """Instance ids (H, W) uint8 or uint16 of a foreign mask.

    A PNG holds the ids, in one channel or in equal ones; DREDS's EXR holds id/255 as float in
    channel R. They are rounded: the public loader truncates, which half floats get wrong.

    Raises:
        ToolkitError: unreadable, of another size, or no mask.
    """
    if path.suffix.lower() == ".exr":
        if size is not None:
            check_aligned(path, exr_size(path), size)
        channels = read_exr(path)
        values = channels.get("R", next(iter(channels.values()))).astype(np.float64) * 255
        if not np.isfinite(values).all() or values.min() < 0 or values.max() > 255.5:
            raise ToolkitError("a mask in EXR holds id/255 between 0 and 1", path=path)
        return np.rint(values).astype(np.uint8)
    image = read_png(path, size=size)
    if image.ndim == 3:
        if not (image == image[..., :1]).all():
            raise ToolkitError("a mask holds ids in one channel or in equal ones", path=path)
        image = np.ascontiguousarray(image[..., 0])
    return image
