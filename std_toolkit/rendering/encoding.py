"""How ground-truth maps are stored, and why. data_spec.md repeats it normatively.

==========  ============================  =====================================================
map         file                          encoding
==========  ============================  =====================================================
depth       gt/depth/NNNNNN.exr           one float32 channel `Z`, metres, ZIP: lossless
mask        gt/mask/NNNNNN.png            8 bit, object id, 0 = background
NOCS        gt/nocs/NNNNNN.png            3 x 16 bit RGB = XYZ, round(65535 n), background 0 0 0
normals     gt/normals/NNNNNN.png         3 x 16 bit RGB = XYZ, round(65535 (n + 1) / 2),
                                          background 0 0 0
==========  ============================  =====================================================

16 bits resolve 5 um of a 0.3 m object in NOCS and 0.001 degrees in normals. 0 0 0 is no value of
either (a NOCS point lies within 0.5 of the cube's centre, and (-1, -1, -1) is no unit vector).

Measured on 2 cores with a 1280x720 frame of six objects (155,000 object pixels), per map:
float32 EXR 15 ms and 0.6 MB for depth, 44 ms and 1.9 MB for normals; 16-bit PNG as OpenCV writes it
60 ms and 0.75 MB; with the filter fixed to "up" and run-length matching 18 ms and 0.72 MB.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import read_depth, read_mask, read_png

# Row differences turn flat background and smooth ramps into runs, which is all that fast
# matching needs; trying every filter per row costs three times as much and gains 5 %.
_PNG_PARAMETERS = [cv2.IMWRITE_PNG_COMPRESSION, 1]
if hasattr(cv2, "IMWRITE_PNG_FILTER"):
    _PNG_PARAMETERS += [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP]
_PNG_PARAMETERS += [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]


def write_depth(path: Path, depth: np.ndarray) -> None:
    """Store (H,W) float32 z-depth in metres, 0 = background, without loss."""
    write_exr(path, {"Z": np.ascontiguousarray(depth, np.float32)}, compression="zip")


def write_mask(path: Path, mask: np.ndarray) -> None:
    """Store an (H,W) uint8 mask of object ids, 0 = background."""
    _write_png(path, np.ascontiguousarray(mask, np.uint8))


def write_nocs(path: Path, nocs: np.ndarray) -> None:
    """Store (H,W,3) float32 NOCS coordinates in 0..1, 0 0 0 in the background."""
    _write_png(path, (np.clip(nocs, 0, 1) * np.float32(65535) + np.float32(0.5)).astype(np.uint16))


def write_normals(path: Path, normals: np.ndarray, mask: np.ndarray) -> None:
    """Store (H,W,3) float32 unit normals of the pixels where `mask` is not 0."""
    half = np.float32(32767.5)
    stored = (np.clip(normals, -1, 1) * half + (half + np.float32(0.5))).astype(np.uint16)
    stored[mask == 0] = 0
    _write_png(path, stored)


def load_depth(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(H,W) float32 metres."""
    return read_depth(path, scale=None, size=size)


def load_mask(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(H,W) uint8."""
    return read_mask(path, size=size)


def load_nocs(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(H,W,3) float32 in 0..1, 0 in the background."""
    return _load_triples(path, size).astype(np.float32) / np.float32(65535)


def load_normals(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(H,W,3) float32 unit normals, 0 in the background."""
    stored = _load_triples(path, size)
    normals = stored.astype(np.float32) / np.float32(32767.5) - np.float32(1)
    normals[~stored.any(axis=2)] = 0
    return normals


def _load_triples(path: Path, size: tuple[int, int]) -> np.ndarray:
    image = read_png(path, size=size)
    if image.ndim != 3 or image.dtype != np.uint16:
        raise ToolkitError(
            "expected a 16-bit RGB image", path=path, value=f"{image.dtype} {image.shape}"
        )
    return image


def _write_png(path: Path, image: np.ndarray) -> None:
    pixels = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    done, data = cv2.imencode(".png", pixels, _PNG_PARAMETERS)
    if not done:
        raise ToolkitError("cannot encode the image", path=path)
    write_bytes_atomic(path, data.data)
