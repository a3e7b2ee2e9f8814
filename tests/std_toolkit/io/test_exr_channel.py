"""One channel of an EXR, read quickly: the same values and the same refusals as reading all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.io.exr import COMPRESSIONS, read_exr, read_exr_channel, read_exr_header, write_exr

RAMP = np.repeat(np.arange(37, dtype=np.float32)[:, None], 50, axis=1)


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_the_channel_is_as_stored(tmp_path: Path, compression: str, kind: type) -> None:
    values = np.random.default_rng(0).random((3, 37, 50)).astype(kind)
    values[0, 3, 4] = np.nan
    path = tmp_path / "a.exr"
    write_exr(path, dict(zip("RGB", values, strict=True)), compression=compression)
    for name in "RGB":
        read = read_exr_channel(path, (name,))
        assert read.dtype == kind
        np.testing.assert_array_equal(read, read_exr(path)[name])


def test_the_best_name_that_is_there_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, {"R": RAMP, "Z": RAMP + 1})
    np.testing.assert_array_equal(read_exr_channel(path), RAMP + 1)
    np.testing.assert_array_equal(read_exr_channel(path, ("V", "R", "Z")), RAMP)
    write_exr(path, {"something": RAMP})
    np.testing.assert_array_equal(read_exr_channel(path), RAMP)
    write_exr(path, {"A": RAMP, "B": RAMP})
    with pytest.raises(ToolkitError, match="no channel Y or Z or V or R"):
        read_exr_channel(path)


def test_equal_channels_are_equal_in_nan_too(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    holes = np.where(RAMP == 3, np.float32(np.nan), RAMP)
    write_exr(path, {"R": holes, "G": holes, "B": holes})
    np.testing.assert_array_equal(read_exr_channel(path, require_equal=True), holes)
    write_exr(path, {"R": holes, "G": holes, "B": RAMP})
    with pytest.raises(ToolkitError, match=r"a\.exr: the EXR file is a picture"):
        read_exr_channel(path, require_equal=True)
    np.testing.assert_array_equal(read_exr_channel(path), holes)


def test_a_flipped_bit_is_noticed_or_changes_nothing(tmp_path: Path, capfd) -> None:
    """The decoder compares zlib's checksums by itself; the last bits of a stream mean nothing."""
    whole = tmp_path / "whole.exr"
    write_exr(whole, {"R": RAMP, "G": RAMP, "B": RAMP}, compression="zip")
    data, start = whole.read_bytes(), read_exr_header(whole).end
    path = tmp_path / "a.exr"
    rng = np.random.default_rng(3)
    noticed = 0
    for at in rng.integers(start, len(data), 150):
        damaged = bytearray(data)
        damaged[at] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        try:
            np.testing.assert_array_equal(read_exr_channel(path), RAMP)
        except ToolkitError as error:
            assert "a.exr" in str(error)
            noticed += 1
    assert noticed > 140


@pytest.mark.parametrize("share", [0, 0.05, 0.3, 0.7, 0.99])
def test_a_cut_file_is_refused(tmp_path: Path, share: float, capfd) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, {"Z": RAMP}, compression="zip")
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(ToolkitError, match=r"a\.exr"):
        read_exr_channel(path)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match="not found"):
        read_exr_channel(tmp_path / "a.exr")
