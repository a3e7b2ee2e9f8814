"""EXR files: types kept, depth found in what tools write, damage refused."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from std_toolkit.errors import ToolkitError
from std_toolkit.io.exr import COMPRESSIONS, exr_size, read_exr, write_exr
from std_toolkit.io.images import image_size, read_depth

RNG = np.random.default_rng(0)
DEPTH = (RNG.uniform(0.3, 2, (37, 50)) * (RNG.random((37, 50)) > 0.2)).astype(np.float32)


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.uint32])
def test_channels_keep_type_and_values(tmp_path: Path, dtype: type, compression: str) -> None:
    channels = {name: (RNG.random((37, 50)) * 100).astype(dtype) for name in ("R", "G", "B")}
    write_exr(tmp_path / "a.exr", channels, compression=compression)
    again = read_exr(tmp_path / "a.exr")
    assert sorted(again) == ["B", "G", "R"]
    for name, values in channels.items():
        assert again[name].dtype == dtype
        np.testing.assert_array_equal(again[name], values)
    assert exr_size(tmp_path / "a.exr") == image_size(tmp_path / "a.exr") == (50, 37)
    first = (tmp_path / "a.exr").read_bytes()
    write_exr(tmp_path / "a.exr", channels, compression=compression)
    assert (tmp_path / "a.exr").read_bytes() == first


def test_types_may_differ_between_channels(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", {"Z": DEPTH, "id": np.ones((37, 50), np.uint32)})
    assert {n: c.dtype for n, c in read_exr(tmp_path / "a.exr").items()} == {
        "Z": np.float32,
        "id": np.uint32,
    }


@pytest.mark.parametrize(
    "channels",
    [
        {"Y": DEPTH},
        {"Z": DEPTH, "A": np.ones_like(DEPTH)},
        {"depth": DEPTH},
        {"R": DEPTH, "G": DEPTH, "B": DEPTH},
        {"R": DEPTH, "G": DEPTH, "B": DEPTH, "A": np.ones_like(DEPTH)},
    ],
    ids=["Y", "Z", "only", "three_equal", "with_alpha"],
)
def test_depth_is_found_in_what_tools_write(tmp_path: Path, channels: dict) -> None:
    write_exr(tmp_path / "d.exr", channels)
    depth = read_depth(tmp_path / "d.exr", scale=None, size=(50, 37))
    assert depth.dtype == np.float32
    np.testing.assert_array_equal(depth, DEPTH)


def test_half_precision_depth_is_widened(tmp_path: Path) -> None:
    write_exr(tmp_path / "d.exr", {"Y": DEPTH.astype(np.float16)})
    np.testing.assert_allclose(read_depth(tmp_path / "d.exr", scale=None), DEPTH, rtol=1e-3)


@pytest.mark.parametrize(
    ("channels", "problem"),
    [
        ({"R": DEPTH, "G": DEPTH * 2, "B": DEPTH}, "R, G and B differ"),
        ({"R": DEPTH, "G": DEPTH}, "R, G and B differ"),
        ({"X": DEPTH, "N": DEPTH}, "no depth channel"),
        ({"Z": (DEPTH * 1000).astype(np.uint32)}, "float16 or float32"),
        ({"Z": np.where(DEPTH > 1, np.nan, DEPTH)}, "NaN, infinite or negative"),
        ({"Z": np.where(DEPTH > 1, np.inf, DEPTH)}, "NaN, infinite or negative"),
        ({"Z": -DEPTH}, "NaN, infinite or negative"),
    ],
)
def test_what_cannot_be_depth_is_refused(tmp_path: Path, channels: dict, problem: str) -> None:
    write_exr(tmp_path / "d.exr", channels)
    with pytest.raises(ToolkitError, match=rf"d\.exr.*{problem}"):
        read_depth(tmp_path / "d.exr", scale=None)


def test_depth_of_another_size_is_refused(tmp_path: Path) -> None:
    write_exr(tmp_path / "d.exr", {"Z": DEPTH})
    with pytest.raises(ToolkitError, match="that of the camera, 100x74"):
        read_depth(tmp_path / "d.exr", scale=None, size=(100, 74))


@pytest.mark.parametrize(
    ("channels", "options"),
    [
        ({}, {}),
        ({"Z": DEPTH.astype(np.float64)}, {}),
        ({"Z": DEPTH[None]}, {}),
        ({"Z": DEPTH, "Y": DEPTH[:5]}, {}),
        ({"Z": DEPTH}, {"compression": "jpeg"}),
    ],
)
def test_unwritable_channels_are_refused(tmp_path: Path, channels: dict, options: dict) -> None:
    with pytest.raises(ToolkitError):
        write_exr(tmp_path / "a.exr", channels, **options)
    assert list(tmp_path.iterdir()) == []


def whole(tmp_path: Path, compression: str = "zips") -> bytes:
    write_exr(tmp_path / "whole.exr", {"Z": DEPTH}, compression=compression)
    return (tmp_path / "whole.exr").read_bytes()


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_truncated_files_are_refused_in_silence(
    tmp_path: Path, compression: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """The decoder itself would print to the terminal."""
    data = whole(tmp_path, compression)
    path = tmp_path / "cut.exr"
    for share in np.linspace(0, 0.999, 25):
        path.write_bytes(data[: int(len(data) * share)])
        with pytest.raises(ToolkitError, match=r"cut\.exr"):
            read_exr(path)
    path.write_bytes(data[:-1])
    with pytest.raises(ToolkitError, match=r"cut\.exr"):
        read_exr(path)
    assert capfd.readouterr() == ("", "")


def with_window(data: bytes, name: bytes, window: tuple[int, int, int, int]) -> bytes:
    at = data.index(name + b"\0box2i\0") + len(name) + 11
    return data[:at] + struct.pack("<4i", *window) + data[at + 16 :]


def test_bombs_crops_and_other_kinds_are_refused(tmp_path: Path) -> None:
    data = whole(tmp_path)
    kinds = {
        "gigapixels": with_window(
            with_window(data, b"dataWindow", (0, 0, 99999, 99999)),
            b"displayWindow",
            (0, 0, 99999, 99999),
        ),
        "backwards": with_window(data, b"dataWindow", (0, 0, -10, -10)),
        "crop": with_window(data, b"displayWindow", (0, 0, 639, 479)),
        "deep": data[:5] + bytes([data[5] | 0x08]) + data[6:],
        "several_parts": data[:5] + bytes([data[5] | 0x10]) + data[6:],
        "version_9": data[:4] + b"\x09" + data[5:],
        "png": b"\x89PNG\r\n\x1a\n" + data[8:],
        "text": b"not an image",
        "nul": b"\0" * 1000,
    }
    for name, content in kinds.items():
        (tmp_path / f"{name}.exr").write_bytes(content)
        with pytest.raises(ToolkitError, match=rf"{name}\.exr"):
            read_exr(tmp_path / f"{name}.exr")
    for missing in (tmp_path / "missing.exr", tmp_path):
        with pytest.raises(ToolkitError):
            exr_size(missing)


def test_a_subsampled_channel_is_refused(tmp_path: Path) -> None:
    data = bytearray(whole(tmp_path))
    at = data.index(b"channels\0chlist\0") + 20
    struct.pack_into("<i", data, at + 10, 2)  # xSampling of the one channel "Z"
    (tmp_path / "half.exr").write_bytes(data)
    with pytest.raises(ToolkitError, match="subsampled"):
        read_exr(tmp_path / "half.exr")


def test_tiled_files_are_read(tmp_path: Path) -> None:
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.tiledimage,
        "tiles": OpenEXR.TileDescription(),
    }
    with OpenEXR.File(header, {"Z": DEPTH}) as file:
        file.write(str(tmp_path / "tiled.exr"))
    np.testing.assert_array_equal(read_exr(tmp_path / "tiled.exr")["Z"], DEPTH)


@pytest.mark.slow
@settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(at=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_in_the_pixels_is_noticed(tmp_path: Path, at: float, bit: int) -> None:
    """zlib's checksum covers every compressed line (lines of pure noise are stored as they are)."""
    depth = np.repeat(np.arange(37, dtype=np.float32)[:, None], 50, axis=1)
    write_exr(tmp_path / "whole.exr", {"Z": depth})
    data = bytearray((tmp_path / "whole.exr").read_bytes())
    index = int(len(data) * at)
    data[index] ^= 1 << bit
    (tmp_path / "a.exr").write_bytes(data)
    try:
        channels = read_exr(tmp_path / "a.exr")
    except ToolkitError as error:
        assert "a.exr" in str(error)
        return
    # What passes is outside of the pixels: a name, a type, a comment, an ignored attribute.
    read_as_floats = list(channels) == ["Z"] and channels["Z"].dtype == np.float32
    assert not read_as_floats or np.array_equal(channels["Z"], depth)


@pytest.mark.real
def test_real_captures_have_three_equal_half_channels(test_data: Path) -> None:
    folder = test_data / "cleargrasp_real"
    path = min(folder.rglob("*-opaque-depth-img.exr"))
    channels = read_exr(path)
    assert sorted(channels) == ["B", "G", "R"]
    assert {c.dtype for c in channels.values()} == {np.dtype(np.float16)}
