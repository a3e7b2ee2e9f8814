"""One photo as cameras write it: JPEG, PNG or HEIC, its orientation, lens and focal length."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from std_toolkit.errors import ToolkitError, missing_extra
from std_toolkit.io.image_header import check_plausible_size, open_regular
from std_toolkit.io.images import COLOR_SUFFIXES, image_size, read_color

HEIC_SUFFIXES = (".heic", ".heif")
PHOTO_SUFFIXES = (*COLOR_SUFFIXES, *HEIC_SUFFIXES)

# Tags of EXIF, and its further block.
_MAKE, _MODEL, _ORIENTATION, _BLOCK = 0x010F, 0x0110, 0x0112, 0x8769
_FOCAL_MM, _FOCAL_35_MM, _LENS, _ZOOM = 0x920A, 0xA405, 0xA434, 0xA404
# Diagonal of the frame of 35 mm film.
_DIAGONAL_MM = 43.27

# By EXIF orientation: quarter turns to the left of the stored pixels, and a flip before them.
_UPRIGHT = {1: (0, False), 2: (0, True), 3: (2, False), 4: (2, True),
            5: (1, True), 6: (3, False), 7: (3, True), 8: (1, False)}  # fmt: skip


@dataclass(frozen=True)
class PhotoHeader:
    """What a photo says of itself.

    Attributes:
        size: (width, height) upright, pixels.
        orientation: of the stored pixels, as EXIF has it; 1 is upright.
        lens: maker, model, lens, focal length and digital zoom; "" if the file has none of it.
        focal_px: focal length in pixels by the 35 mm equivalent; None if unknown.
    """

    size: tuple[int, int]
    orientation: int = 1
    lens: str = ""
    focal_px: float | None = None


def read_photo_header(path: Path, *, stored: bool = False) -> PhotoHeader:
    """Size, orientation and lens of a photo, without decoding its pixels where that can be.

    Args:
        path: a file with one of `PHOTO_SUFFIXES`.
        stored: leave the pixels as they are stored: given intrinsics belong to these.

    Raises:
        ToolkitError: unreadable, or HEIC without the extra.
    """
    if path.suffix.lower() in HEIC_SUFFIXES:
        file = _open_heic(path)
        width, height = file.size
        exif = Image.Exif()
        if file.info.get("exif"):
            exif.load(file.info["exif"])
        # The decoder turns the image by properties of its own; EXIF would turn it twice.
        return _header((width, height), 1, exif)
    size = image_size(path)
    try:
        with open_regular(path) as opened, Image.open(opened) as image:
            exif = image.getexif()
            exif.get_ifd(_BLOCK)
    except (OSError, SyntaxError, ValueError, LookupError, TypeError):
        return PhotoHeader(size)  # metadata beside the pixels, which are whole
    turned = exif.get(_ORIENTATION, 1)
    return _header(size, turned if turned in _UPRIGHT and not stored else 1, exif)


def read_photo(path: Path, orientation: int = 1) -> NDArray[np.uint8]:
    """RGB image (H, W, 3) of a photo, upright.

    Args:
        path: a file with one of `PHOTO_SUFFIXES`.
        orientation: of its header.

    Raises:
        ToolkitError: unreadable or damaged, or HEIC without the extra.
    """
    if path.suffix.lower() in HEIC_SUFFIXES:
        file = _open_heic(path)
        try:
            image = np.asarray(file.to_pillow().convert("RGB"), np.uint8)
        except Exception as error:  # the decoder raises errors of many kinds
            raise _damaged(path) from error
    else:
        image = read_color(path)
    turns, flipped = _UPRIGHT[orientation]
    if flipped:
        image = np.asarray(cv2.flip(image, 1), np.uint8)
    return np.ascontiguousarray(np.rot90(image, turns))


def _header(size: tuple[int, int], orientation: int, exif: Image.Exif) -> PhotoHeader:
    block = exif.get_ifd(_BLOCK)
    words = [exif.get(_MAKE), exif.get(_MODEL), block.get(_LENS)]
    focal, zoom = _number(block.get(_FOCAL_MM)), _number(block.get(_ZOOM))
    equivalent = _number(block.get(_FOCAL_35_MM))
    lens = [str(w).strip("\0 ") for w in words if w]
    lens += [f"{focal:.2f} mm"] if focal else []
    lens += [f"{equivalent:.0f} mm on 35 mm film"] if equivalent else []
    lens += [f"zoom {zoom:.2f}"] if zoom and zoom != 1 else []
    turned = _UPRIGHT[orientation][0] % 2 == 1
    width, height = (size[1], size[0]) if turned else size
    pixels = equivalent / _DIAGONAL_MM * float(np.hypot(*size)) if equivalent else None
    return PhotoHeader((width, height), orientation, ", ".join(lens), pixels)


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if np.isfinite(number) and number > 0 else None


def _open_heic(path: Path) -> Any:
    """The opened file of `pillow_heif`; its pixels are decoded later."""
    try:
        import pillow_heif
    except ModuleNotFoundError as error:
        missing = missing_extra(error)
        if missing is None:
            raise
        raise missing.revised(
            problem="HEIC photos need pillow-heif, which is not installed", path=path,
            hint=f"{missing.hint}; or convert them to JPEG, as with `heif-convert` or the export "
            "of the phone's photo program",
        ) from error  # fmt: skip
    with open_regular(path) as opened:
        data = opened.read()
    try:
        file = pillow_heif.open_heif(data, convert_hdr_to_8bit=True)
    except Exception as error:
        raise _damaged(path) from error
    check_plausible_size(path, *file.size)
    return file


def _damaged(path: Path) -> ToolkitError:
    return ToolkitError("the HEIC file is damaged", path=path, hint="copy it again from the phone")
