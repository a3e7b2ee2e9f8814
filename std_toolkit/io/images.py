"""Image files: 8-bit colour, 16-bit depth, masks. Headers are checked before decoding pixels."""

import io
import os
import re
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from std_toolkit.errors import ToolkitError
from std_toolkit.io import atomic, exr, image_header
from std_toolkit.log import logger

COLOR_SUFFIXES = (".png", ".jpg", ".jpeg")

# How the lines of libjpeg begin, whose decoder goes on behind damage.
_LIBJPEG = (b"Corrupt JPEG data", b"Premature end of JPEG", b"Invalid SOS", b"Inconsistent progr")
_EXTRANEOUS = re.compile(r"(\d+) extraneous bytes? before marker 0xd9")
# Of 297 flipped bits in the scan of a JPEG that left bytes over, none left fewer than 7.
_FEW_BYTES = 4
# Decoders round differently, grey levels.
_DECODERS_DIFFER = 8
_DECODING = threading.Lock()

# Photographs and depth: half the time and the size of OpenCV's level 3.
_PNG_PARAMETERS = [cv2.IMWRITE_PNG_COMPRESSION, 1]
if hasattr(cv2, "IMWRITE_PNG_FILTER"):
    _PNG_PARAMETERS += [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_PAETH]
_PNG_PARAMETERS += [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]


def image_size(path: Path | str) -> tuple[int, int]:
    """(width, height) from the file's header, without decoding the pixels.

    Raises:
        ToolkitError: not found, not a PNG, JPEG or EXR image, or of an implausible size.
    """
    path = Path(path)
    if path.suffix.lower() == ".exr":
        return exr.exr_size(path)
    header = image_header.read_header(path)
    return header.width, header.height


def read_color(path: Path | str, *, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """RGB image (H, W, 3) uint8 from an 8-bit PNG or JPEG.

    Grey is copied to three channels, a palette is applied and an alpha channel is dropped. The
    orientation in the metadata is ignored: intrinsics belong to the stored pixels.

    Args:
        size: expected (width, height).

    Raises:
        ToolkitError: unreadable, truncated, not 8-bit, CMYK, or of another size.
    """
    path = Path(path)
    header = image_header.read_header(path)
    if header.bits > 8:
        raise ToolkitError(
            "colour must be 8-bit",
            path=path,
            value=f"{header.bits} bits",
            hint="convert it; is this a depth image?",
        )
    if header.format == "jpeg" and header.channels not in (1, 3):
        raise ToolkitError("colour must be RGB or grey", path=path, value=f"{header.channels} inks")
    image = _decode(path, header, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION, size)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)  # type: ignore[arg-type, return-value]


def decode_color(data: bytes, path: Path | str) -> NDArray[np.uint8]:
    """RGB image (H, W, 3) uint8 from the bytes of a PNG or JPEG within another file.

    Args:
        data: of the image.
        path: of the file that holds it, for errors.

    Raises:
        ToolkitError: as `read_color`.
    """
    path = Path(path)
    header = image_header.header_of(data, path)
    if header.bits > 8 or header.channels not in (1, 3):
        problem = f"colour must be 8-bit RGB or grey, not {header.channels} of {header.bits} bits"
        raise ToolkitError(problem, path=path)
    image = _pixels(path, data, header, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)  # type: ignore[arg-type, return-value]


def write_color(path: Path | str, image: NDArray[np.uint8], *, quality: int = 95) -> None:
    """Write an RGB image (H, W, 3) uint8; the suffix (.png, .jpg) selects the format."""
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
        ToolkitError: unreadable, not single-channel 16-bit, of another size, or with values that
            are not finite or negative (import converts other encodings of missing depth).
    """
    path = Path(path)
    if path.suffix.lower() == ".exr":
        _check_size(path, exr.exr_size(path), size)
        depth = exr.read_exr_depth(path)
        if not np.isfinite(depth).all() or (depth < 0).any():
            raise ToolkitError(
                "depth contains NaN, infinite or negative values",
                path=path,
                hint="missing depth must be 0; import the recording again",
            )
        return depth
    header = _png_header(path, "depth must be a single-channel 16-bit PNG or an EXR")
    if header.bits != 16 or header.channels != 1:
        raise ToolkitError(
            "depth must be a single-channel 16-bit PNG or an EXR",
            path=path,
            value=f"{header.channels} channels of {header.bits} bits",
        )
    if scale is None or not np.isfinite(scale) or scale <= 0:
        raise ToolkitError(
            "a 16-bit depth image needs its scale (metres per unit)", path=path, value=scale
        )
    raw = _decode(path, header, cv2.IMREAD_UNCHANGED, size)
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
            value=f"{np.min(depth):.6g} to {np.max(depth):.6g} m",
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
    path = Path(path)
    header = _png_header(path, "a mask must be a PNG")
    if header.channels != 1 or header.bits not in (8, 16):
        raise ToolkitError(
            "a mask must be a single-channel 8- or 16-bit PNG",
            path=path,
            value=f"{header.channels} channels of {header.bits} bits",
        )
    return _decode(path, header, cv2.IMREAD_UNCHANGED, size)  # type: ignore[return-value]


def read_png(path: Path | str, *, size: tuple[int, int] | None = None) -> NDArray[np.generic]:
    """Any PNG as stored: (H, W) or (H, W, 3) in RGB order, uint8 or uint16; alpha is dropped.

    Raises:
        ToolkitError: unreadable, damaged, not a PNG or of another size.
    """
    path = Path(path)
    image = _decode(path, _png_header(path, "must be a PNG"), cv2.IMREAD_UNCHANGED, size)
    return image if image.ndim == 2 else np.ascontiguousarray(image[..., 2::-1])


def write_png(path: Path | str, image: NDArray[np.generic]) -> None:
    """Write (H, W) or RGB (H, W, 3), uint8 or uint16, losslessly and byte-deterministically."""
    if image.dtype not in (np.uint8, np.uint16) or image.shape[2:] not in ((), (3,)):
        raise ToolkitError(
            "a PNG must be (H, W) or (H, W, 3) of uint8 or uint16",
            path=path,
            value=f"{image.dtype} {image.shape}",
        )
    pixels = image if image.ndim == 2 else np.ascontiguousarray(image[..., ::-1])
    _encode(path, pixels, _PNG_PARAMETERS)


def _png_header(path: Path, requirement: str) -> image_header.ImageHeader:
    header = image_header.read_header(path)
    if header.format != "png":
        raise ToolkitError(requirement, path=path, value=header.format)
    return header


def _decode(
    path: Path, header: image_header.ImageHeader, flags: int, size: tuple[int, int] | None
) -> NDArray[np.generic]:
    _check_size(path, (header.width, header.height), size)
    with image_header.open_regular(path) as file:
        return _pixels(path, file.read(), header, flags)


def _pixels(
    path: Path, data: bytes, header: image_header.ImageHeader, flags: int
) -> NDArray[np.generic]:
    image_header.check_whole(path, data, header)
    try:
        if header.format == "jpeg":
            with _decoder_warnings() as warnings:
                image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
            if warnings and not _is_benign(path, warnings, image, data):
                raise ToolkitError(
                    "the JPEG file is damaged", path=path, value=warnings[0],
                    hint="copy or record it again",
                )  # fmt: skip
        else:
            image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error as error:
        raise ToolkitError(f"cannot decode the image: {error.err}", path=path) from error
    if image is None or image.shape[:2] != (header.height, header.width):
        raise ToolkitError("cannot decode the image", path=path, hint="the file is damaged")
    return image


def _is_benign(
    path: Path, warnings: list[str], image: NDArray[np.generic] | None, data: bytes
) -> bool:
    """Whether a decoder only met bytes between the parts of a file, which some cameras write.

    They are padding, or a few, and a second decoder must find the same pixels.
    """
    counts = [match for line in warnings if (match := _EXTRANEOUS.search(line))]
    if image is None or len(counts) != len(warnings):
        return False
    # A flipped bit, too, may leave bytes over, but more of them, and no padding.
    padding = data[: data.rindex(b"\xff\xd9")][-max(int(m.group(1)) for m in counts) :]
    if len(padding) > _FEW_BYTES and len(set(padding)) > 1:
        return False
    try:
        with Image.open(io.BytesIO(data), formats=["JPEG"]) as second:
            pixels = np.asarray(second.convert("RGB" if image.ndim == 3 else "L"))
    except Exception:  # the decoders of Pillow raise many kinds of errors
        return False
    expected = pixels[..., ::-1] if image.ndim == 3 else pixels
    if expected.shape != image.shape:
        return False
    if float(np.abs(expected.astype(np.int16) - image.astype(np.int16)).max()) > _DECODERS_DIFFER:
        return False
    logger.warning("%s: %s; its pixels are whole", path, warnings[0])
    return True


@contextmanager
def _decoder_warnings() -> Iterator[list[str]]:
    """Lines that libjpeg prints in the block.

    It reports damage on the standard error of the process alone, and fills the rest of the image
    with grey. Lines of others are passed on.
    """
    said: list[str] = []
    with _DECODING, ExitStack() as stack:
        try:
            before = os.dup(2)
        except OSError:  # closed
            yield said
            return
        stack.callback(os.close, before)
        caught = os.memfd_create("stderr")
        stack.callback(os.close, caught)
        os.dup2(caught, 2)
        try:
            yield said
        finally:
            os.dup2(before, 2)
            text = os.pread(caught, 1 << 16, 0)
            for line in text.splitlines(keepends=True):
                if line.startswith(_LIBJPEG):
                    said.append(line.decode(errors="replace").strip())
                else:
                    os.write(2, line)


def _check_size(path: Path, actual: tuple[int, int], expected: tuple[int, int] | None) -> None:
    if expected is not None and actual != tuple(expected):
        raise ToolkitError(
            f"image size differs from that of the camera, {expected[0]}x{expected[1]}",
            path=path,
            value=f"{actual[0]}x{actual[1]}",
            hint="intrinsics belong to one image size; depth must be aligned to colour",
        )


def _encode(path: Path | str, image: NDArray[np.generic], parameters: list[int]) -> None:
    suffix = Path(path).suffix.lower()
    if suffix not in COLOR_SUFFIXES:
        raise ToolkitError(
            "unsupported image format for writing", path=path, hint=f"one of {COLOR_SUFFIXES}"
        )
    done, data = cv2.imencode(suffix, image, parameters)  # type: ignore[arg-type]
    if not done:
        raise ToolkitError("cannot encode the image", path=path)
    atomic.write_bytes_atomic(path, data.data)
