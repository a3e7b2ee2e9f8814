"""Noise of the disparity: its deviation and correlation, and that holes stay holes."""

from __future__ import annotations

import numpy as np
import pytest

from sensors.depth_models.stereo import with_noise


def test_noise_has_its_deviation_and_correlation() -> None:
    exact = np.full((400, 600), 30.0, np.float32)
    noise = with_noise(exact, np.random.default_rng(0), noise_px=0.06, spread_px=2) - exact
    assert noise.dtype == np.float32
    assert noise.std() == pytest.approx(0.06, rel=0.05)
    assert abs(noise.mean()) < 0.005
    for step, least, most in ((1, 0.9, 0.97), (2, 0.72, 0.82), (4, 0.3, 0.5), (12, -0.1, 0.1)):
        for a, b in ((noise[:, :-step], noise[:, step:]), (noise[:-step], noise[step:])):
            assert least < np.corrcoef(a.ravel(), b.ravel())[0, 1] < most


def test_holes_stay_holes() -> None:
    found = np.where(np.arange(100) % 3 == 0, 0, 20).astype(np.float32)[None].repeat(50, axis=0)
    noisy = with_noise(found, np.random.default_rng(1))
    np.testing.assert_array_equal(noisy == 0, found == 0)
    np.testing.assert_array_equal(noisy, with_noise(found, np.random.default_rng(1)))
    np.testing.assert_array_equal(with_noise(found, np.random.default_rng(1), noise_px=0.0), found)
