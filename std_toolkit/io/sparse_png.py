"""16-bit RGB PNG files of maps that are mostly background, written in a fifth of zlib's time.

The pixels of objects are stored: their low bytes are noise, and deflate's Huffman codes would save
a quarter of their size for most of the time. The background between them is deflated as runs. Any
reader of PNG reads the files: deflate mixes both.

Source: RFC 1950 (zlib), RFC 1951 (deflate), "Portable Network Graphics Specification", w3.org.
"""

from __future__ import annotations

import struct
import zlib
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

# Background between two runs of a row that is stored with them, pixels.
_SHORTEST_GAP = 12
_LONGEST_STORED = 65535
_ADLER = 65521
_PIXEL_BYTES = 6


def sparse_png(image: NDArray[np.uint16], covered: NDArray[np.generic]) -> bytes:
    """Encode a map; equal maps give equal bytes.

    Args:
        image: (H,W,3) uint16 RGB, 0 where `covered` is 0.
        covered: (H,W), not 0 at pixels of objects.

    Returns:
        The PNG file.
    """
    height, width = covered.shape
    head = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    return b"".join(
        [
            b"\x89PNG\r\n\x1a\n",
            *_chunk(b"IHDR", head),
            *_chunk(b"IDAT", _deflated(image, covered)),
            *_chunk(b"IEND", b""),
        ]
    )


def _chunk(kind: bytes, data: bytes) -> tuple[bytes, ...]:
    check = zlib.crc32(data, zlib.crc32(kind))
    return struct.pack(">I", len(data)), kind, data, struct.pack(">I", check)


def _deflated(image: NDArray[np.uint16], covered: NDArray[np.generic]) -> bytes:
    """The zlib stream of the rows, each after its filter byte, 0."""
    height, width = covered.shape
    row_bytes = 1 + width * _PIXEL_BYTES
    pixels = image.astype(">u2").tobytes()
    lengths = struct.Struct("<HH").pack
    parts = [b"\x78\x01"]
    low, high = 1, 0  # halves of Adler's checksum
    done = 0  # bytes of the rows so far
    for row, first, end in _runs(covered):
        start = row * row_bytes + 1 + first * _PIXEL_BYTES
        at = (row * width + first) * _PIXEL_BYTES
        stop = at + (end - first) * _PIXEL_BYTES
        gap = start - done
        high = (high + gap * low) % _ADLER
        parts.append(_zeros(gap))
        done = start + stop - at
        while True:
            data = pixels[at : min(stop, at + _LONGEST_STORED)]
            size = len(data)
            parts.append(lengths(size, size ^ 0xFFFF))
            parts.append(data)
            sums = zlib.adler32(data, high << 16 | low)
            high, low = sums >> 16, sums & 0xFFFF
            at += size
            if at == stop:
                break
            parts.append(b"\0")
    rest = height * row_bytes - done
    if rest:
        high = (high + rest * low) % _ADLER
        parts += (_zeros(rest), b"\0\0\xff\xff")
    parts += (b"\x01\0\0\xff\xff", struct.pack(">HH", high, low))
    return b"".join(parts)


def _runs(covered: NDArray[np.generic]) -> list[tuple[int, int, int]]:
    """Row, first column and end of runs of pixels, short gaps between them included."""
    height, width = covered.shape
    padded = np.zeros((height, width + 1), bool)  # no run goes on in the next row
    np.not_equal(covered, 0, out=padded[:, :-1])
    flat = padded.reshape(-1)
    steps = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    if flat[0]:
        steps = np.insert(steps, 0, 0)
    first, end = steps[::2], steps[1::2]
    if not len(first):
        return []
    rows = first // (width + 1)
    joined = (rows[1:] == rows[:-1]) & (first[1:] - end[:-1] < _SHORTEST_GAP)
    begins, ends = np.append(True, ~joined), np.append(~joined, True)
    rows, first, end = rows[begins], first[begins], end[ends]
    offset = rows * (width + 1)
    return list(zip(rows.tolist(), (first - offset).tolist(), (end - offset).tolist(), strict=True))


@lru_cache(maxsize=1 << 14)
def _zeros(count: int) -> bytes:
    """A block of zeros in fixed codes, and the first byte of a stored block behind it."""
    copies, left = divmod(count - 1, 258)
    bits, size = 0b010 | _ZERO << 3, 11  # not the last block, fixed codes; the first zero
    bits |= (int.from_bytes(_COPIES * (copies // 8 + 1), "little") & (1 << 13 * copies) - 1) << size
    size += 13 * copies
    codes = _copy(left) if left >= 3 else ((_ZERO, 8),) * left
    # The end of the block. Then a stored block, not the last one, which begins at the next byte.
    for value, width in (*codes, (0, 7), (0, 3)):
        bits |= value << size
        size += width
    return bits.to_bytes(-(-size // 8), "little")


def _copy(length: int) -> tuple[tuple[int, int], ...]:
    """Codes and widths that repeat the last byte 3 to 257 times: the length with its extra bits,
    and the distance 1."""
    base, code, extra = 3, 257, 0
    while length >= base + (1 << extra):
        base, code = base + (1 << extra), code + 1
        extra = max(0, (code - 261) // 4)
    symbol = (_reversed(code - 256, 7), 7) if code < 280 else (_reversed(code - 88, 8), 8)
    return symbol, (length - base, extra), (0, 5)


def _reversed(code: int, width: int) -> int:
    """Codes begin with their highest bit, other numbers with the lowest."""
    return int(f"{code:0{width}b}"[::-1], 2)


_ZERO = _reversed(0x30, 8)
# Eight times the code of 258 copies and that of the distance 1, 13 bits.
_COPIES = sum(_reversed(285 - 88, 8) << 13 * i for i in range(8)).to_bytes(13, "little")
