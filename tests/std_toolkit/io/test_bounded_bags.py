"""Compressed recordings of ROS unpack to what is plausible, and no more."""

from __future__ import annotations

import bz2
import io
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("rosbags")

from rosbags.rosbag1 import reader as rosbag1
from rosbags.rosbag2 import reader as rosbag2
from rosbags.rosbag2 import storage_mcap

from std_toolkit.errors import ToolkitError
from std_toolkit.io import bounded_bags


def lz4(data: bytes) -> bytes:
    from lz4.frame import compress

    return bytes(compress(data))


def zstd(data: bytes) -> bytes:
    return bytes(storage_mcap.zstd.compress(data))


EVERY: list[tuple[Callable[..., bytes], Callable[[bytes], bytes]]] = [
    (rosbag1.decompressors["bz2"], bz2.compress),
    (rosbag1.decompressors["lz4"], lz4),
    (storage_mcap.DECOMPRESSORS["lz4"], lz4),
    (storage_mcap.DECOMPRESSORS["zstd"], zstd),
    (rosbag2.zstd.decompress, zstd),
]


@pytest.mark.parametrize(("unpack", "pack"), EVERY)
def test_chunks_are_unpacked_as_before(
    unpack: Callable[..., bytes], pack: Callable[[bytes], bytes]
) -> None:
    for data in (b"", b"a", bytes(range(256)) * 20_000):
        assert unpack(pack(data)) == data
    assert unpack(pack(b"one") + pack(b"two")) == b"onetwo"
    with pytest.raises((ToolkitError, OSError, RuntimeError, EOFError)):
        unpack(pack(bytes(range(256)) * 100)[:-20])


@pytest.mark.parametrize(("unpack", "pack"), EVERY)
def test_a_chunk_that_unpacks_without_end_is_refused(
    unpack: Callable[..., bytes],
    pack: Callable[[bytes], bytes],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(bounded_bags, "LARGEST_CHUNK_BYTES", 2**22)
    with pytest.raises(ToolkitError, match="unpacks to more than 4 MB"):
        unpack(pack(bytes(2**24)))


@pytest.mark.parametrize(("unpack", "pack"), EVERY)
def test_empty_streams_without_end_are_refused(
    unpack: Callable[..., bytes], pack: Callable[[bytes], bytes]
) -> None:
    with pytest.raises(ToolkitError, match="more than 1000 compressed streams"):
        unpack(pack(b"") * 1001)


def test_a_file_that_unpacks_without_end_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.zstd"
    path.write_bytes(zstd(b"plain" * 1000))
    with path.open("rb") as packed, rosbag2.zstd.open(packed, "rb") as file:
        assert io.BufferedReader(file).read() == b"plain" * 1000
    monkeypatch.setattr(bounded_bags, "LARGEST_CHUNK_BYTES", 2**20)
    path.write_bytes(zstd(bytes(2**26)))
    with (
        path.open("rb") as packed,
        rosbag2.zstd.open(packed, "rb") as file,
        pytest.raises(ToolkitError, match="more than 100 times"),
    ):
        while file.read(2**20):
            pass
