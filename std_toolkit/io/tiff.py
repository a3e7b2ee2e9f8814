"""TIFF images of one channel: depth and grey of BOP's data set ITODD."""

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL.TiffImagePlugin import TiffImageFile

from std_toolkit.errors import ToolkitError
from std_toolkit.io import image_header

TIFF_SUFFIXES = (".tif", ".tiff")
# Pillow's modes of one channel, and their types.
_MODES = {"L": "uint8", "I;16": "uint16", "I;16B": "uint16", "F": "float32"}
_DAMAGE = (OSError, SyntaxError, ValueError, LookupError, TypeError, EOFError)


def tiff_size(path: Path) -> tuple[int, int]:
    """(width, height) from the header.

    Raises:
        ToolkitError: not found, not a TIFF image, or of an implausible size.
    """
    with image_header.open_regular(path) as file:
        try:
            width, height = TiffImageFile(file).size
        except _DAMAGE as error:
            raise _damaged(path, error) from error
    image_header.check_plausible_size(path, width, height)
    return width, height


def read_tiff(path: Path) -> NDArray[np.generic]:
    """(H, W) uint8, uint16 or float32 values of an image of one channel, as stored.

    Raises:
        ToolkitError: not found, damaged, of several channels, or of an implausible size.
    """
    tiff_size(path)
    with image_header.open_regular(path) as file:
        data = file.read()
    try:
        image = TiffImageFile(io.BytesIO(data))
        mode = image.mode
        values = np.asarray(image)
    except _DAMAGE as error:
        raise _damaged(path, error) from error
    if mode not in _MODES:
        raise ToolkitError(
            "must have one channel of 8 or 16 bits or float32", path=path, value=mode
        )
    return np.ascontiguousarray(values, dtype=_MODES[mode])


def _damaged(path: Path, error: BaseException) -> ToolkitError:
    return ToolkitError(f"not a readable TIFF image: {error}", path=path)
