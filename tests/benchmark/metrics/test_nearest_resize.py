"""Nearest resizing takes the very samples that torch takes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmark.data.frame import nearest_indices, pixels_taken, resize_nearest
from std_toolkit.errors import ToolkitError

SIZES = [(1280, 720), (640, 360), (224, 224), (126, 224), (224, 126), (320, 240), (7, 3)]


def test_indices_are_those_of_torch_over_many_lengths() -> None:
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(5)
    pairs = [(a, b) for a in range(1, 60) for b in range(1, 60)]
    pairs += [(int(a), int(b)) for a, b in rng.integers(1, 3000, (3000, 2))]
    pairs += [(a, b) for w in SIZES for v in SIZES for a in w for b in v]
    for length, wanted in pairs:
        row = torch.arange(length, dtype=torch.float32).reshape(1, 1, 1, length)
        taken = torch.nn.functional.interpolate(row, size=(1, wanted), mode="nearest")
        expected = taken.numpy().ravel().astype(int)
        assert np.array_equal(nearest_indices(length, wanted), expected), (length, wanted)


def test_float32_matters() -> None:
    """Double precision gives other pixels: the property above is not one of any rounding."""
    exact = [np.floor(np.arange(1869) * (2142 / 1869)).astype(int)]
    exact += [np.floor(np.arange(544) * (34161 / 544)).astype(int)]
    others = [nearest_indices(2142, 1869), nearest_indices(34161, 544)]
    assert any(not np.array_equal(a, b) for a, b in zip(exact, others, strict=True))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("wanted", SIZES)
def test_images_are_those_of_torch(size: tuple[int, int], wanted: tuple[int, int]) -> None:
    torch = pytest.importorskip("torch")
    image = np.random.default_rng(1).random((size[1], size[0], 3), dtype=np.float32)
    tensor = torch.from_numpy(image).permute(2, 0, 1)[None]
    resized = torch.nn.functional.interpolate(tensor, size=(wanted[1], wanted[0]), mode="nearest")
    expected = resized[0].permute(1, 2, 0).numpy()
    assert np.array_equal(resize_nearest(image, wanted), expected)
    assert np.array_equal(resize_nearest(image[..., 0], wanted), expected[..., 0])


@given(st.lists(st.tuples(st.integers(1, 40), st.integers(1, 40)), min_size=2, max_size=4))
def test_pixels_taken_are_those_of_resizing_step_by_step(sizes: list[tuple[int, int]]) -> None:
    width, height = sizes[0]
    image = np.arange(width * height).reshape(height, width)
    stepwise = image
    for size in sizes[1:]:
        stepwise = resize_nearest(stepwise, size)
    taken = pixels_taken(*sizes)
    assert np.array_equal(image.ravel() if taken is None else taken, stepwise.ravel())


def test_a_smaller_step_between_loses_pixels() -> None:
    assert pixels_taken((4, 4), (2, 2), (4, 4)) is not None
    assert pixels_taken((4, 4), (4, 4), (4, 4)) is None


def test_types_stay_and_the_source_is_left_alone() -> None:
    mask = np.array([[1, 255]], np.uint8)
    same = resize_nearest(mask, (2, 1))
    assert same.dtype == np.uint8
    same[:] = 0
    assert mask.tolist() == [[1, 255]]
    with pytest.raises(ValueError, match="read-only"):
        nearest_indices(9, 4)[0] = 1


@pytest.mark.parametrize(("length", "wanted"), [(0, 4), (4, 0), (-1, 4), (2**24 + 1, 4)])
def test_lengths_that_no_image_has(length: int, wanted: int) -> None:
    with pytest.raises(ToolkitError, match="no length of an image"):
        nearest_indices(length, wanted)


def test_only_images_are_resized() -> None:
    with pytest.raises(ToolkitError, match="H, W"):
        resize_nearest(np.zeros(4), (2, 2))
