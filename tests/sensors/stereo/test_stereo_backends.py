"""Compiled code and torch give the same disparities."""

from __future__ import annotations

import multiprocessing
import sys

import cv2
import numpy as np
import pytest
from dot_stereo import Rig, plane, sphere
from numpy.typing import NDArray

import sensors.stereo
from sensors.stereo import make_matcher
from std_toolkit.errors import ToolkitError

Pair = tuple[NDArray[np.uint8], NDArray[np.uint8]]


@pytest.fixture(scope="module")
def pair() -> Pair:
    """A ball before a wall, with noise, a flat patch and one that does not match."""
    rig = Rig(width=200, height=120, noise=3)
    left, right, _ = rig.pair(sphere((0.0, 0, 0.5), 0.06, plane((0.1, 0, 1), 0.6)))
    left[:30, 60:110] = 40
    right[:30, 30:90] = 40
    right[80:, 100:140] = cv2.flip(right[80:, 100:140], 0)
    return left, right


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"subpixel": "quadratic", "median_px": 1, "speckle_px": 0},
        {"subpixel": "none", "left_right_px": None, "uniqueness_percent": 0, "median_px": 7},
        {"aggregation_px": 1, "min_disparity": 0, "max_disparity": 250},
        {"aggregation_px": 21, "left_right_px": 3, "speckle_step_px": 0.25},
        {"cost": "zncc"},
        {"cost": "zncc", "subpixel": "quadratic", "zncc_px": 13, "aggregation_px": 1},
        {"cost": "zncc", "subpixel": "equiangular", "zncc_px": 3, "uniqueness_percent": 20},
    ],
    ids=str,
)
def test_backends_agree(pair: Pair, options: dict[str, object]) -> None:
    pytest.importorskip("torch")
    compiled = make_matcher("local", **options).match(*pair)
    tensors = make_matcher("local", backend="torch", device="cpu", **options).match(*pair)
    assert 0.2 < (compiled > 0).mean() < 0.98
    np.testing.assert_array_equal(compiled > 0, tensors > 0)
    np.testing.assert_allclose(compiled, tensors, rtol=0, atol=1e-4)


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (5, 9), (47, 33), (46, 130)], ids=str)
@pytest.mark.parametrize("cost", ["census", "zncc"])
def test_backends_agree_on_small_images(shape: tuple[int, int], cost: str) -> None:
    pytest.importorskip("torch")
    image = np.random.default_rng(1).integers(0, 256, (shape[0], shape[1] + 8), dtype=np.uint8)
    left, right = image[:, : shape[1]], image[:, 8:]
    compiled = make_matcher("local", cost=cost, speckle_px=5).match(left, right)
    tensors = make_matcher("local", cost=cost, speckle_px=5, backend="torch").match(left, right)
    np.testing.assert_allclose(compiled, tensors, rtol=0, atol=1e-4)
    assert compiled.shape == shape


def test_number_of_threads_does_not_matter(pair: Pair) -> None:
    expected = make_matcher("local", threads=1).match(*pair)
    np.testing.assert_array_equal(make_matcher("local", threads=5).match(*pair), expected)


@pytest.mark.slow
def test_forked_process_matches_too(pair: Pair) -> None:
    """A compiler's own threads do not survive a fork; those of a closed pool need not."""
    expected = make_matcher("local").match(*pair)
    with multiprocessing.get_context("fork").Pool(1) as pool:
        found = pool.apply_async(make_matcher("local").match, pair).get(timeout=60)
    np.testing.assert_array_equal(found, expected)


def test_arrays_of_any_layout(pair: Pair) -> None:
    pytest.importorskip("torch")
    left, right = (np.asfortranarray(image)[::-1] for image in pair)
    left.flags.writeable = False
    expected = make_matcher("local").match(left.copy(), right.copy())
    for backend in ("numba", "torch"):
        np.testing.assert_array_equal(
            make_matcher("local", backend=backend).match(left, right), expected
        )


def test_missing_torch_is_reported(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "sensors.stereo.torch_backend", raising=False)
    monkeypatch.delattr(sensors.stereo, "torch_backend", raising=False)
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(ToolkitError, match=r"not installed.*std-toolkit\[train\]"):
        make_matcher("local", backend="torch").match(*pair)


def test_unknown_device_is_told(pair: Pair) -> None:
    pytest.importorskip("torch")
    with pytest.raises(ToolkitError, match=r"device.*abacus"):
        make_matcher("local", backend="torch", device="abacus").match(*pair)
    import torch

    if not torch.cuda.is_available():
        with pytest.raises(ToolkitError, match=r"device.*cuda:0"):
            make_matcher("local", backend="torch", device="cuda:0").match(*pair)
