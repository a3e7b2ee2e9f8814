"""Compressed recordings of ROS: what is unpacked is bounded.

A chunk of a few kilobytes can unpack to gigabytes, and `rosbags` unpacks chunks and files whole.
`std_toolkit.libraries` calls `bound` for each of its modules that unpacks, when it is imported.
"""

import bz2
import io
import sys
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any, BinaryIO

from std_toolkit.errors import ToolkitError

LARGEST_CHUNK_BYTES = 512 * 2**20
"""Of a chunk or message: writers cut chunks at some megabytes, and no image is as large."""

LARGEST_MESSAGE_BYTES = 128 * 2**20
"""Of an image: raw colour of 8K has 100 MB. While it is decoded, about seven copies are held."""

_RATIO = 100  # of a compressed file; images and depth shrink to a twentieth at best
_STEP = 2**20
# What follows a stream is copied: millions of empty ones would take time with the square of them.
_MOST_STREAMS = 1000


def bound(module: ModuleType) -> None:
    """Replace what a module of rosbags unpacks with; a module of another layout stays."""
    for name in ("decompressors", "DECOMPRESSORS"):
        known = getattr(module, name, None)
        if not isinstance(known, dict):
            continue
        for kind, make in (("bz2", _bz2), ("lz4", _lz4), ("zstd", _zstd(module))):
            if kind in known and make is not None:
                known[kind] = unpacker_of(make)
    zstd = getattr(module, "zstd", None)
    make = _zstd(module)
    if module.__name__.endswith("rosbag2.reader") and zstd is not None and make is not None:
        module.zstd = SimpleNamespace(  # type: ignore[attr-defined]
            open=lambda file, mode: _Bounded(zstd.open(file, mode), file),
            decompress=unpacker_of(make),
            ZstdError=getattr(zstd, "ZstdError", ValueError),
        )


def _bz2() -> Any:
    return bz2.BZ2Decompressor()


def _lz4() -> Any:
    # rosbags brings and imports it.
    return sys.modules["lz4.frame"].LZ4FrameDecompressor()


def _zstd(module: ModuleType) -> Callable[[], Any] | None:
    return getattr(getattr(module, "zstd", None), "ZstdDecompressor", None)


def unpacker_of(make: Callable[[], Any], largest_bytes: int | None = None) -> Callable[..., bytes]:
    """Return a function that unpacks bytes.

    Args:
        make: a decompressor as those of `bz2` are.
        largest_bytes: of what it gives (`LARGEST_CHUNK_BYTES`).

    The function raises ToolkitError for data that are cut off, unpack to more, or are more than a
    thousand streams.
    """

    def decompress(data: bytes, *_: object) -> bytes:
        most = LARGEST_CHUNK_BYTES if largest_bytes is None else largest_bytes
        parts, size, rest, streams = [], 0, data, 0
        while rest:  # several streams may follow each other
            streams += 1
            if streams > _MOST_STREAMS:
                raise ToolkitError(f"a chunk of more than {_MOST_STREAMS} compressed streams")
            unpacker = make()
            fed = rest
            while True:
                part = unpacker.decompress(fed, max_length=_STEP)
                parts.append(part)
                size += len(part)
                if size > most:
                    raise ToolkitError(
                        f"a chunk of {len(data)} bytes unpacks to more than {most // 2**20} MB"
                    )
                fed = b""
                if unpacker.eof or (not part and unpacker.needs_input):
                    break
            if not unpacker.eof:
                raise ToolkitError("a compressed chunk is cut off")
            rest = unpacker.unused_data or b""
        return b"".join(parts)

    return decompress


class _Bounded(io.RawIOBase):
    """A file that is unpacked while it is read, up to a multiple of its size."""

    def __init__(self, unpacked: BinaryIO, packed: BinaryIO) -> None:
        super().__init__()
        self._file = unpacked
        at = packed.tell()
        size = packed.seek(0, io.SEEK_END)
        packed.seek(at)
        self._left = LARGEST_CHUNK_BYTES + _RATIO * size

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        data = self._file.read(len(buffer))
        self._left -= len(data)
        if self._left < 0:
            raise ToolkitError(f"the compressed recording unpacks to more than {_RATIO} times")
        buffer[: len(data)] = data
        return len(data)

    def close(self) -> None:
        self._file.close()
        super().close()
