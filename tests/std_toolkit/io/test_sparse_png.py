"""PNG files of sparse maps against the decoders of OpenCV and Pillow, pixel by pixel."""

from __future__ import annotations

import io
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from std_toolkit.io.sparse_png import _write_zeros, sparse_png


def decoded(data: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(data)) as picture:
        picture.verify()  # checksums of the chunks
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return image[..., ::-1]


def a_map(shape: tuple[int, int], share: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    small = rng.random((max(1, shape[0] // 4), max(1, shape[1] // 4))).astype(np.float32)
    covered = cv2.resize(small, shape[::-1]) < share
    image = rng.integers(1, 65536, (*shape, 3)).astype(np.uint16)
    image[~covered] = 0
    return image, covered.astype(np.uint8)


@given(
    height=st.integers(1, 40),
    width=st.integers(1, 90),
    share=st.sampled_from([0.0, 0.2, 0.5, 1.1]),
    seed=st.integers(0, 9),
)
@settings(max_examples=60, deadline=None)
def test_every_pixel_comes_back(height: int, width: int, share: float, seed: int) -> None:
    image, covered = a_map((height, width), share, seed)
    np.testing.assert_array_equal(decoded(sparse_png(image, covered)), image)


@pytest.mark.parametrize("shape", [(720, 1280), (3, 12_000)])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.1])
def test_large_maps_come_back(shape: tuple[int, int], share: float) -> None:
    image, covered = a_map(shape, share, 0)
    data = sparse_png(image, covered)
    np.testing.assert_array_equal(decoded(data), image)
    assert data == sparse_png(image.copy(), covered.copy())
    assert len(data) < 2 * 6 * int(covered.sum()) + 60_000


@pytest.mark.parametrize("count", [*range(1, 800), 7681, 32768, 32769, 5_000_000])
def test_runs_of_zeros(count: int) -> None:
    out = np.empty(64 + count // 100, np.uint8)
    size = _write_zeros(out, 0, count)
    stream = out[:size].tobytes() + b"\0\0\xff\xff\x01\0\0\xff\xff"
    assert zlib.decompress(stream, -15) == bytes(count)
    assert size < 12 + count / 150


def test_pixels_that_are_not_covered_are_zero() -> None:
    image, covered = a_map((30, 200), 0.4, 3)
    dirty = np.where(covered[..., None] != 0, image, 7).astype(np.uint16)
    assert sparse_png(dirty, covered) == sparse_png(image, covered)
