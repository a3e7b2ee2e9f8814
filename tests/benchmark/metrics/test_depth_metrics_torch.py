"""Torch's half gives numpy's figures."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.metrics import Missing
from benchmark.metrics.depth import depth_numpy
from std_toolkit.errors import ToolkitError

torch = pytest.importorskip("torch")

from benchmark.metrics.depth import depth_torch  # noqa: E402 - there is nothing to import without torch

MISSING = list(Missing)
REPORTED = [Missing.COUNTED, Missing.AS_GIVEN]


def batch(dtype: type, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depths with holes of every kind, and one image of three without any pixel to compare."""
    rng = np.random.default_rng(seed)
    true = rng.uniform(0.3, 2, (4, 37, 53)).astype(dtype)
    pred = (true * rng.normal(1, 0.06, true.shape)).astype(dtype)
    for bad in (0, -0.5, np.inf, np.nan):
        pred[rng.random(true.shape) < 0.05] = bad
    for bad in (0, -1, np.nan, np.inf):
        true[rng.random(true.shape) < 0.05] = bad
    valid = rng.random(true.shape) < 0.6
    valid[2] = False
    return pred, true, valid


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
@pytest.mark.parametrize("missing", MISSING)
def test_functions(dtype: type, missing: Missing) -> None:
    pred, true, valid = batch(dtype)
    tensors = [torch.from_numpy(a) for a in (pred, true, valid)]
    for name, options in (
        ("rmse", {}),
        ("mae", {}),
        ("rel", {}),
        ("delta", {"threshold": 1.05}),
        ("delta", {"threshold": 1.25}),
    ):
        found = getattr(depth_torch, name)(*tensors, missing=missing, **options)
        one = getattr(depth_numpy, name)
        expected = [
            one(*image, missing=missing, **options) for image in zip(pred, true, valid, strict=True)
        ]
        assert found.dtype == torch.float64
        np.testing.assert_allclose(found.numpy(), expected, rtol=1e-13, atol=0, err_msg=name)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("missing", REPORTED)
@pytest.mark.parametrize("masked", [True, False])
def test_all_at_once(dtype: type, missing: Missing, masked: bool) -> None:
    pred, true, valid = batch(dtype, 3)
    tensors = [torch.from_numpy(a) for a in (pred, true)]
    found = depth_torch.depth_errors(
        *tensors, torch.from_numpy(valid) if masked else None, missing=missing
    )
    for i in range(len(pred)):
        expected = depth_numpy.depth_errors(
            pred[i], true[i], valid[i] if masked else None, missing=missing
        ).as_dict()
        assert list(found) and set(found) == set(expected)
        for name, value in expected.items():
            exact = name.startswith(("n_", "d1", "cov"))
            np.testing.assert_allclose(
                found[name][i].item(), value, rtol=0 if exact else 1e-13, err_msg=name
            )


def test_coverage() -> None:
    pred, true, valid = batch(np.float32)
    found = depth_torch.coverage(*(torch.from_numpy(a) for a in (pred, true, valid)))
    expected = [depth_numpy.coverage(*image) for image in zip(pred, true, valid, strict=True)]
    np.testing.assert_array_equal(found.numpy(), expected)


def test_brain_floats_are_read_as_single() -> None:
    pred, true = torch.full((1, 4), 1.01).bfloat16(), torch.ones(1, 4).bfloat16()
    assert depth_torch.mae(pred, true).item() == abs(pred.double() - 1).mean().item()


def test_predictions_that_carry_gradients() -> None:
    pred = torch.full((1, 4), 1.5, requires_grad=True)
    found = depth_torch.rmse(pred, torch.ones(1, 4))
    assert found.item() == 0.5
    assert not found.requires_grad


def test_what_is_refused() -> None:
    one = torch.ones(2, 3)
    with pytest.raises(ToolkitError, match="one shape"):
        depth_torch.rmse(one, torch.ones(3, 2))
    with pytest.raises(ToolkitError, match="floating-point metres"):
        depth_torch.mae(one.int(), one)
    with pytest.raises(ToolkitError, match="batch"):
        depth_torch.rel(one[0], one[0])
    with pytest.raises(ToolkitError, match="above 1"):
        depth_torch.delta(one, one, threshold=0.9)
    with pytest.raises(ToolkitError, match="no way to count"):
        depth_torch.depth_errors(one, one, missing=Missing.LEFT_OUT)
