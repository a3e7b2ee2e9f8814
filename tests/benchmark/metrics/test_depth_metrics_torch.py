"""Tensors of torch give numpy's figures."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark import metrics
from benchmark.metrics import FIGURES, NAMES, Errors, Missing, depth_errors, image_errors
from benchmark.metrics.depth.figures import Pixels
from std_toolkit.errors import ToolkitError

torch = pytest.importorskip("torch")

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
    for name, options in (
        ("rmse", {}),
        ("mae", {}),
        ("rel", {}),
        ("delta", {"threshold": 1.05}),
        ("delta", {"threshold": 1.25}),
    ):
        one = getattr(metrics, name)
        for image in zip(pred, true, valid, strict=True):
            found = one(*map(torch.from_numpy, image), missing=missing, **options)
            expected = one(*image, missing=missing, **options)
            assert isinstance(found, float)
            np.testing.assert_allclose(found, expected, rtol=1e-13, atol=0, err_msg=name)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("missing", REPORTED)
@pytest.mark.parametrize("masked", [True, False])
@pytest.mark.parametrize("library", ["torch", "numpy"])
def test_all_at_once(dtype: type, missing: Missing, masked: bool, library: str) -> None:
    pred, true, valid = batch(dtype, 3)
    arrays = [torch.from_numpy(a) if library == "torch" else a for a in (pred, true, valid)]
    found = image_errors(*arrays[:2], arrays[2] if masked else None, missing=missing)
    for i in range(len(pred)):
        expected = depth_errors(
            pred[i], true[i], valid[i] if masked else None, missing=missing
        ).as_dict()
        assert list(found) and set(found) == set(expected)
        for name, value in expected.items():
            exact = name.startswith(("n_", "d1", "cov"))
            np.testing.assert_allclose(
                found[name][i].item(), value, rtol=0 if exact else 1e-13, err_msg=name
            )


def test_a_figure_is_the_same_at_each_pixel() -> None:
    pred, true, _ = (a.reshape(-1) for a in batch(np.float32, 5))
    there = (pred > 0) & (true > 0) & np.isfinite(pred) & np.isfinite(true)
    for dtype in (np.float32, np.float64):
        p, g = pred[there].astype(dtype), true[there].astype(dtype)
        for figure in FIGURES:
            one = figure.of(Pixels(p, g))
            other = figure.of(Pixels(torch.from_numpy(p), torch.from_numpy(g)))
            assert one.dtype == (bool if figure.is_share else np.float64)
            np.testing.assert_allclose(one, other.numpy(), rtol=3e-16, err_msg=figure.name)


def test_errors_have_a_field_for_each_figure() -> None:
    names = [*NAMES, "coverage", *(f"{name}_answered" for name in NAMES)]
    assert list(Errors.__dataclass_fields__) == ["n_pixels", "n_answered", *names]


def test_coverage() -> None:
    for image in zip(*batch(np.float32), strict=True):
        found = metrics.coverage(*map(torch.from_numpy, image))
        np.testing.assert_equal(found, metrics.coverage(*image))


def test_brain_floats_are_read_as_single() -> None:
    pred, true = torch.full((1, 4), 1.01).bfloat16(), torch.ones(1, 4).bfloat16()
    expected = abs(pred.double() - 1).mean().item()
    assert metrics.mae(pred, true) == image_errors(pred, true)["mae"].item() == expected


def test_predictions_that_carry_gradients() -> None:
    pred = torch.full((1, 4), 1.5, requires_grad=True)
    found = image_errors(pred, torch.ones(1, 4))["rmse"]
    assert found.item() == metrics.rmse(pred, torch.ones(1, 4)) == 0.5
    assert not found.requires_grad and found.dtype == torch.float64


def test_what_is_refused() -> None:
    one = torch.ones(2, 3)
    with pytest.raises(ToolkitError, match="one shape"):
        metrics.rmse(one, torch.ones(3, 2))
    with pytest.raises(ToolkitError, match="one shape"):
        image_errors(one, torch.ones(3, 2))
    with pytest.raises(ToolkitError, match="floating-point metres"):
        metrics.mae(one.int(), one)
    with pytest.raises(ToolkitError, match="batch"):
        image_errors(one[0], one[0])
    with pytest.raises(ToolkitError, match="above 1"):
        metrics.delta(one, one, threshold=0.9)
    with pytest.raises(ToolkitError, match="no way to count"):
        image_errors(one, one, missing=Missing.LEFT_OUT)
