"""Image files: 8-bit colour, 16-bit depth, masks. Sizes are checked before pixels are decoded."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.exr import LARGEST_PIXEL_COUNT, exr_size, read_exr_depth

COLOR_SUFFIXES = (".png", ".jpg", ".jpeg")


def image_size(path: Path | str) -> tuple[int, int]:
    """(width, height) from the file's header, without decoding the pixels.

    Raises:
        ToolkitError: not found, not an image, or of an implausible size.
    """
    path = Path(path)
    if not path.is_file():
        raise ToolkitError("image file not found", path=path)
    if path.suffix.lower() == ".exr":
        return exr_size(path)
    try:
        # Pillow's own bomb check would only warn at this size; ours below refuses.
        with Image.open(path) as header:
            size = header.size
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError, EOFError) as error:
        raise ToolkitError(
            "not a readable image (empty, truncated or mislabelled?)", path=path
        ) from error
    except Image.DecompressionBombError as error:
        raise ToolkitError("the image claims an implausible size", path=path) from error
    if size[0] * size[1] > LARGEST_PIXEL_COUNT:
        raise ToolkitError(
            "the image claims an implausible size", path=path, value=f"{size[0]}x{size[1]}"
        )
    return size


def read_color(path: Path | str, *, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """RGB image (H, W, 3) uint8 from PNG or JPEG; an alpha channel is dropped.

    Args:
        size: expected (width, height).

    Raises:
        ToolkitError: unreadable, truncated, not 8-bit, or of another size.
    """
    image = _decode(Path(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION, size)
    if image.dtype != np.uint8:
        raise ToolkitError("colour must be 8-bit", path=path, value=str(image.dtype))
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)  # type: ignore[arg-type, return-value]


def write_color(path: Path | str, image: NDArray[np.uint8], *, quality: int = 95) -> None:
    """Write an RGB image (H, W, 3) uint8; the suffix (.png, .jpg) chooses the format."""
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    if Path(path).suffix.lower() == ".png":
        _encode(path, bgr, [cv2.IMWRITE_PNG_COMPRESSION, 3])
    else:
        _encode(path, bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])


def read_depth(
    path: Path | str, *, scale: float | None, size: tuple[int, int] | None = None
) -> NDArray[np.float32]:
    """z-depth (H, W) float32 metres, 0 = no measurement, from a 16-bit PNG or an EXR in metres.

    Args:
        scale: metres per unit of a 16-bit PNG (0.001 for millimetres); unused for EXR.
        size: expected (width, height).

    Raises:
        ToolkitError: unreadable, not single-channel 16-bit, of another size, or holding values
            that are not finite or negative (import converts a foreign encoding of "missing").
    """
    path = Path(path)
    if path.suffix.lower() == ".exr":
        _check_size(path, exr_size(path), size)
        depth = read_exr_depth(path)
        if not np.isfinite(depth).all() or (depth < 0).any():
            raise ToolkitError(
                "depth holds NaN, infinite or negative values",
                path=path,
                hint="missing depth is 0; import the recording again",
            )
        return depth
    raw = _decode(path, cv2.IMREAD_UNCHANGED, size)
    if raw.dtype != np.uint16 or raw.ndim != 2:
        raise ToolkitError(
            "depth must be a single-channel 16-bit PNG or an EXR",
            path=path,
            value=f"{raw.dtype} {raw.shape}",
        )
    if scale is None or not np.isfinite(scale) or scale <= 0:
        raise ToolkitError(
            "a 16-bit depth image needs its scale (metres per unit)", path=path, value=scale
        )
    return raw.astype(np.float32) * np.float32(scale)


def write_depth_png16(path: Path | str, depth: NDArray[np.floating], *, scale: float) -> None:
    """Write z-depth (H, W) in metres as 16-bit PNG with `scale` metres per unit, 0 = missing.

    Raises:
        ToolkitError: a depth does not fit 16 bits at this scale, or is negative or not finite.
    """
    units = np.rint(np.asarray(depth, dtype=np.float64) / scale)
    if not np.isfinite(units).all() or units.min(initial=0) < 0 or units.max(initial=0) > 65535:
        raise ToolkitError(
            f"depth does not fit a 16-bit PNG at {scale} m per unit",
            path=path,
            value=float(np.nanmax(depth)),
            hint="use a coarser scale",
        )
    write_png(path, units.astype(np.uint16))


def read_mask(
    path: Path | str, *, size: tuple[int, int] | None = None
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Mask (H, W) of ids, uint8 or uint16.

    Raises:
        ToolkitError: unreadable, of another size or with several channels.
    """
    mask = _decode(Path(path), cv2.IMREAD_UNCHANGED, size)
    if mask.ndim != 2 or mask.dtype not in (np.uint8, np.uint16):
        raise ToolkitError(
            "a mask must be a single-channel 8- or 16-bit PNG",
            path=path,
            value=f"{mask.dtype} {mask.shape}",
        )
    return mask  # type: ignore[return-value]


def read_png(path: Path | str, *, size: tuple[int, int] | None = None) -> NDArray[np.generic]:
    """Any PNG as stored: (H, W) or (H, W, 3) in RGB order, uint8 or uint16."""
    image = _decode(Path(path), cv2.IMREAD_UNCHANGED, size)
    return image if image.ndim == 2 else np.ascontiguousarray(image[..., 2::-1])


def write_png(path: Path | str, image: NDArray[np.generic], *, compression: int = 1) -> None:
    """Write (H, W) or RGB (H, W, 3), uint8 or uint16, losslessly and byte-deterministically."""
    pixels = image if image.ndim == 2 else np.ascontiguousarray(image[..., ::-1])
    _encode(path, pixels, [cv2.IMWRITE_PNG_COMPRESSION, compression])


def _decode(path: Path, flags: int, size: tuple[int, int] | None) -> NDArray[np.generic]:
    _check_size(path, image_size(path), size)
    data = np.fromfile(path, dtype=np.uint8)
    if data[:2].tobytes() == b"\xff\xd8" and b"\xff\xd9" not in data[-64:].tobytes():
        # OpenCV fills the missing part of a truncated JPEG with grey and says nothing.
        raise ToolkitError("the JPEG file is truncated", path=path)
    if data[:4].tobytes() == b"\x89PNG" and b"IEND" not in data[-64:].tobytes():
        raise ToolkitError("the PNG file is truncated", path=path)
    try:
        image = cv2.imdecode(data, flags)
    except cv2.error as error:
        raise ToolkitError(f"cannot decode the image: {error.err}", path=path) from error
    if image is None:
        raise ToolkitError("cannot decode the image", path=path, hint="the file is damaged")
    return image  # type: ignore[return-value]


def _check_size(path: Path, actual: tuple[int, int], expected: tuple[int, int] | None) -> None:
    if expected is not None and actual != tuple(expected):
        raise ToolkitError(
            f"image size is not the camera's {expected[0]}x{expected[1]}",
            path=path,
            value=f"{actual[0]}x{actual[1]}",
            hint="intrinsics belong to one image size; depth must be aligned to colour",
        )


def _encode(path: Path | str, image: NDArray[np.generic], parameters: list[int]) -> None:
    done, data = cv2.imencode(Path(path).suffix, image, parameters)  # type: ignore[arg-type]
    if not done:
        raise ToolkitError("cannot encode the image", path=path)
    write_bytes_atomic(path, data.data)
