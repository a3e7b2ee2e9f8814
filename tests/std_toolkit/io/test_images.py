"""Image files: what is stored comes back, and what is wrong is refused before it is decoded."""

from __future__ import annotations

import io
import os
import struct
import warnings
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from std_toolkit.errors import ToolkitError
from std_toolkit.io import images
from std_toolkit.io.images import (
    image_size,
    read_color,
    read_depth,
    read_mask,
    read_png,
    write_color,
    write_depth_png16,
    write_png,
)

RNG = np.random.default_rng(0)
COLOUR = RNG.integers(0, 256, (30, 40, 3), dtype=np.uint8)
SMOOTH = cv2.resize(RNG.integers(0, 256, (4, 5, 3), dtype=np.uint8), (40, 30))


# --- what is stored comes back -----------------------------------------------------------------


def test_png_colour_is_lossless_rgb(tmp_path: Path) -> None:
    write_color(tmp_path / "a.png", COLOUR)
    np.testing.assert_array_equal(read_color(tmp_path / "a.png"), COLOUR)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), COLOUR)
    assert image_size(tmp_path / "a.png") == (40, 30)


@pytest.mark.parametrize("suffix", [".jpg", ".jpeg", ".JPG"])
def test_jpeg_quality_is_obeyed_for_every_spelling_of_the_suffix(
    tmp_path: Path, suffix: str
) -> None:
    """A peer compares the suffix without its dot, so that its quality setting never counts."""
    sizes = []
    for quality in (20, 95):
        path = tmp_path / f"q{quality}{suffix}"
        write_color(path, SMOOTH, quality=quality)
        sizes.append(path.stat().st_size)
    assert sizes[0] < 0.8 * sizes[1]
    error = read_color(tmp_path / f"q95{suffix}").astype(int) - SMOOTH
    assert np.abs(error).mean() < 5
    assert image_size(tmp_path / f"q95{suffix}") == (40, 30)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(7, 5), (7, 5, 3), (1, 1)])
def test_png_round_trip(tmp_path: Path, dtype: type, shape: tuple) -> None:
    image = RNG.integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype)
    write_png(tmp_path / "a.png", image)
    again = read_png(tmp_path / "a.png")
    assert again.dtype == dtype
    np.testing.assert_array_equal(again, image)
    first = (tmp_path / "a.png").read_bytes()
    write_png(tmp_path / "a.png", image)
    assert (tmp_path / "a.png").read_bytes() == first


@pytest.mark.parametrize("scale", [0.001, 0.0001, 0.00025, 1 / 5000])
def test_every_16_bit_depth_survives_its_scale(tmp_path: Path, scale: float) -> None:
    units = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    write_png(tmp_path / "d.png", units)
    depth = read_depth(tmp_path / "d.png", scale=scale)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, units * scale, rtol=1e-6)
    write_depth_png16(tmp_path / "again.png", depth, scale=scale)
    np.testing.assert_array_equal(read_png(tmp_path / "again.png"), units)


@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf, 65.536])
def test_depth_that_16_bits_cannot_hold_is_not_written(tmp_path: Path, value: float) -> None:
    with pytest.raises(ToolkitError, match=r"d\.png: depth does not fit"):
        write_depth_png16(tmp_path / "d.png", np.array([[0.5, value]]), scale=0.001)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_masks_keep_ids(tmp_path: Path, dtype: type) -> None:
    mask = np.array([[0, 1, 254]], dtype=dtype)
    write_png(tmp_path / "m.png", mask)
    again = read_mask(tmp_path / "m.png", size=(3, 1))
    assert again.dtype == dtype
    np.testing.assert_array_equal(again, mask)


# --- decisions: grey, palette, alpha, 16 bits, orientation ---------------------------------------


def test_grey_colour_is_copied_to_three_channels(tmp_path: Path) -> None:
    grey = Image.fromarray(COLOUR[..., 0])
    grey.save(tmp_path / "a.png")
    np.testing.assert_array_equal(
        read_color(tmp_path / "a.png"), np.repeat(COLOUR[..., :1], 3, axis=2)
    )
    grey.save(tmp_path / "a.jpg", quality=95)
    assert read_color(tmp_path / "a.jpg").shape == (30, 40, 3)


def test_alpha_is_dropped_without_mixing_colours(tmp_path: Path) -> None:
    alpha = RNG.integers(0, 256, (30, 40, 1), dtype=np.uint8)
    Image.fromarray(np.concatenate([COLOUR, alpha], axis=2)).save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_color(tmp_path / "a.png"), COLOUR)
    np.testing.assert_array_equal(read_png(tmp_path / "a.png"), COLOUR)


def test_a_palette_is_looked_up(tmp_path: Path) -> None:
    picture = Image.fromarray(COLOUR).quantize(16)
    picture.save(tmp_path / "a.png")
    np.testing.assert_array_equal(
        read_color(tmp_path / "a.png"), np.asarray(picture.convert("RGB"))
    )


def test_16_bit_colour_is_refused_instead_of_cut_to_8_bits(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", COLOUR.astype(np.uint16) * 257)
    with pytest.raises(ToolkitError, match=r"a\.png: colour must be 8-bit.*depth image"):
        read_color(tmp_path / "a.png")


def test_cmyk_is_refused(tmp_path: Path) -> None:
    Image.fromarray(COLOUR).convert("CMYK").save(tmp_path / "a.jpg")
    with pytest.raises(ToolkitError, match="RGB or grey"):
        read_color(tmp_path / "a.jpg")


def test_orientation_in_the_metadata_is_ignored(tmp_path: Path) -> None:
    """Intrinsics belong to the pixels as they are stored."""
    exif = Image.Exif()
    exif[0x0112] = 6  # to be turned by 90 degrees
    Image.fromarray(SMOOTH).save(tmp_path / "a.jpg", exif=exif, quality=95)
    assert image_size(tmp_path / "a.jpg") == (40, 30)
    assert read_color(tmp_path / "a.jpg").shape == (30, 40, 3)


def test_progressive_jpeg_with_a_thumbnail_is_read(tmp_path: Path) -> None:
    thumbnail = io.BytesIO()
    Image.fromarray(SMOOTH).resize((8, 6)).save(thumbnail, "jpeg")
    exif = b"Exif\0\0II*\0\x08\0\0\0\0\0\0\0\0\0" + thumbnail.getvalue()
    Image.fromarray(SMOOTH).save(tmp_path / "a.jpg", progressive=True, exif=exif, quality=90)
    assert read_color(tmp_path / "a.jpg").shape == (30, 40, 3)
    data = (tmp_path / "a.jpg").read_bytes()
    (tmp_path / "a.jpg").write_bytes(data + b"\0" * 100)  # padding of a camera
    assert read_color(tmp_path / "a.jpg").shape == (30, 40, 3)
    # The thumbnail's end marker does not make a truncated picture whole.
    (tmp_path / "a.jpg").write_bytes(data[:-200])
    with pytest.raises(ToolkitError, match="truncated"):
        read_color(tmp_path / "a.jpg")


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((4, 4), np.uint8),
        np.zeros((4, 4, 3), np.uint16),
        np.zeros((4, 4, 3), np.uint8),
    ],
    ids=["8_bit", "colour_16_bit", "colour"],
)
def test_depth_must_be_16_bit_grey(tmp_path: Path, image: np.ndarray) -> None:
    write_png(tmp_path / "d.png", image)
    with pytest.raises(ToolkitError, match=r"d\.png: depth must be a single-channel 16-bit PNG"):
        read_depth(tmp_path / "d.png", scale=0.001)


@pytest.mark.parametrize("scale", [None, 0, -0.001, np.nan, np.inf])
def test_depth_needs_its_scale(tmp_path: Path, scale: float | None) -> None:
    write_png(tmp_path / "d.png", np.ones((4, 4), np.uint16))
    with pytest.raises(ToolkitError, match="needs its scale"):
        read_depth(tmp_path / "d.png", scale=scale)


def test_colour_masks_and_lossy_masks_are_refused(tmp_path: Path) -> None:
    write_png(tmp_path / "m.png", COLOUR)
    with pytest.raises(ToolkitError, match="single-channel"):
        read_mask(tmp_path / "m.png")
    Image.fromarray(COLOUR[..., 0]).save(tmp_path / "m.jpg")
    with pytest.raises(ToolkitError, match="must be a PNG"):
        read_mask(tmp_path / "m.jpg")


def test_unwritable_images_are_refused(tmp_path: Path) -> None:
    for image in (np.zeros((2, 2), np.float32), np.zeros((2, 2, 4), np.uint8)):
        with pytest.raises(ToolkitError, match="a PNG must be"):
            write_png(tmp_path / "a.png", image)
    with pytest.raises(ToolkitError, match="unsupported image format"):
        write_color(tmp_path / "a.gif", COLOUR)
    assert list(tmp_path.iterdir()) == []


# --- what is wrong is refused before it is decoded -----------------------------------------------


def png_claiming(width: int, height: int, bits: int = 8, colour: int = 2) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    pixels = zlib.compress(b"\0" * 1_000_000)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")
    )


def encoded(suffix: str, image: np.ndarray = SMOOTH) -> bytes:
    return cv2.imencode(suffix, image)[1].tobytes()


PNG, JPEG = encoded(".png", COLOUR), encoded(".jpg")
WRONG = {
    "empty.png": b"",
    "empty.jpg": b"",
    "text.png": b"this is not an image, whatever it is called",
    "text.jpg": b"this is not an image, whatever it is called",
    "signature_only.png": PNG[:8],
    "header_only.png": PNG[:33],
    "half.png": PNG[: len(PNG) // 2],
    "without_end.png": PNG[:-12],
    "half.jpg": JPEG[: len(JPEG) // 2],
    "without_end.jpg": JPEG[:-2],
    "header_only.jpg": JPEG[:30],
    "start_only.jpg": b"\xff\xd8\xff",
    "jpeg_inside.png": JPEG,
    "png_inside.jpg": PNG,
    "gif_inside.png": b"GIF89a" + b"\0" * 100,
    "bmp_inside.png": encoded(".bmp"),
    "webp_inside.jpg": encoded(".webp"),
    "tiff_inside.png": encoded(".tiff"),
    "picture.tiff": encoded(".tiff"),
    "no_suffix": PNG,
    "flipped_bit.png": PNG[:100] + bytes([PNG[100] ^ 1]) + PNG[101:],
    "flipped_size.png": PNG[:19] + bytes([PNG[19] ^ 1]) + PNG[20:],
    "no_pixels.png": PNG[:33] + PNG[-12:],
    "gigapixels.png": png_claiming(100_000, 100_000),
    "wide.png": png_claiming(2**31 - 1, 1),
    "nothing_wide.png": png_claiming(0, 10),
    "too_few_rows.png": png_claiming(2000, 2000),
    "odd_colour_type.png": png_claiming(10, 10, colour=5),
    "odd_bits.png": png_claiming(10, 10, bits=3),
    "gigapixels.jpg": JPEG.replace(struct.pack(">HH", 30, 40), struct.pack(">HH", 65535, 65535)),
    "no_height.jpg": JPEG.replace(struct.pack(">HH", 30, 40), struct.pack(">HH", 0, 40)),
}


@pytest.mark.parametrize("name", WRONG)
def test_damaged_images_are_refused_by_name(
    tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_bytes(WRONG[name])
    with warnings.catch_warnings(), pytest.raises(ToolkitError, match=name) as caught:
        warnings.simplefilter("error")
        read_color(path)
    assert "\n" not in str(caught.value)
    if name != "too_few_rows.png":  # only the decoder can tell, and it says so in its own way too
        assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["gigapixels.png", "wide.png", "gigapixels.jpg", "half.png"])
def test_bombs_and_torn_files_never_reach_a_decoder(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*args: object) -> None:
        raise AssertionError("decoded")

    monkeypatch.setattr(images.cv2, "imdecode", fail)
    (tmp_path / name).write_bytes(WRONG[name])
    with pytest.raises(ToolkitError):
        read_color(tmp_path / name)


def test_another_size_is_refused_before_decoding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_color(tmp_path / "a.png", COLOUR)
    monkeypatch.setattr(images.cv2, "imdecode", None)
    with pytest.raises(
        ToolkitError, match=r"a\.png: image size differs from that of the camera, 80x60"
    ):
        read_color(tmp_path / "a.png", size=(80, 60))


def test_what_is_no_file_is_refused_without_blocking(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "zero.png").symlink_to("/dev/zero")
    (tmp_path / "broken.png").symlink_to(tmp_path / "nothing")
    (tmp_path / "folder.png").mkdir()
    with (tmp_path / "huge.png").open("wb") as file:
        file.write(PNG[:100])
        file.truncate(1 << 40)
    for path in [*tmp_path.iterdir(), tmp_path / "missing.png"]:
        with pytest.raises(ToolkitError, match=path.name):
            read_color(path)


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(at=st.integers(0, len(PNG) - 1), bit=st.integers(0, 7))
def test_a_flipped_bit_of_a_png_is_noticed_or_harmless(tmp_path: Path, at: int, bit: int) -> None:
    damaged = bytearray(PNG)
    damaged[at] ^= 1 << bit
    (tmp_path / "a.png").write_bytes(damaged)
    try:
        image = read_color(tmp_path / "a.png")
    except ToolkitError as error:
        assert "a.png" in str(error)
    else:
        np.testing.assert_array_equal(image, COLOUR)


@pytest.mark.slow
@settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(source=st.sampled_from([PNG, JPEG]), cut=st.floats(0, 0.999), extra=st.binary(max_size=30))
def test_no_truncation_passes(tmp_path: Path, source: bytes, cut: float, extra: bytes) -> None:
    path = tmp_path / ("a.png" if source is PNG else "a.jpg")
    path.write_bytes(source[: int(len(source) * cut)] + extra.replace(b"\xff", b""))
    with pytest.raises(ToolkitError):
        read_color(path)


@pytest.mark.parametrize("stray", [b"\x00" * 4, b"\x00" * 40])
def test_bytes_before_the_end_of_a_jpeg_are_a_warning(
    stray: bytes, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Some cameras write a few; the pixels are whole."""
    image = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    write_color(tmp_path / "a.jpg", image)
    data = (tmp_path / "a.jpg").read_bytes()
    expected = read_color(tmp_path / "a.jpg")
    (tmp_path / "stray.jpg").write_bytes(data[:-2] + stray + data[-2:])
    assert (read_color(tmp_path / "stray.jpg") == expected).all()
    assert "extraneous bytes before marker" in caplog.text and "whole" in caplog.text
    broken = bytearray(data)
    broken[len(data) // 2 : len(data) // 2 + 40] = b"\x55" * 40
    (tmp_path / "broken.jpg").write_bytes(bytes(broken))
    with pytest.raises(ToolkitError, match=r"broken\.jpg"):
        read_color(tmp_path / "broken.jpg")
