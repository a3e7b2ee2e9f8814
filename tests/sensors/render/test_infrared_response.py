"""From infrared light to grey values: lens, exposure, noise."""

from __future__ import annotations

import numpy as np
import pytest

from sensors.render.infrared_image import InfraredResponse, expose_pair, exposure_for

QUIET = InfraredResponse(noise=False)


def test_a_pair_shares_one_exposure_and_has_shot_noise() -> None:
    left = np.full((200, 200), 0.02)
    left[:, 150:] = 0.08
    right = left * 1.0
    right[:, :100] = 0.01
    a, b, exposure = expose_pair(
        left, right, rng=np.random.default_rng(0), response=InfraredResponse(blur_px=0)
    )
    assert a.dtype == b.dtype == np.uint8
    assert np.concatenate([a, b]).mean() == pytest.approx(54, abs=0.1)
    for light, grey in ((left, a), (right, b)):
        for value in (0.01, 0.02, 0.08):
            part = grey[light == value].astype(float)
            if not len(part):
                continue
            level = value * exposure
            assert part.mean() == pytest.approx(level, abs=0.1)
            # Shot noise of 130 electrons a step, read noise, rounding.
            expected = np.sqrt(level / 130 + 0.2**2 + 1 / 12)
            assert part.std() == pytest.approx(expected, rel=0.05)
    again = expose_pair(
        left, right, rng=np.random.default_rng(0), response=InfraredResponse(blur_px=0)
    )
    np.testing.assert_array_equal(a, again[0])


def test_noise_can_be_switched_off_and_bright_pixels_saturate() -> None:
    light = np.full((64, 64), 0.5)
    light[20, 20] = 50
    response = InfraredResponse(noise=False, blur_px=0)
    grey, _, _ = expose_pair(light, light, rng=np.random.default_rng(0), response=response)
    assert grey[20, 20] == 255
    # The white spot counts as white, however bright it is.
    assert np.delete(grey.ravel(), 20 * 64 + 20).tolist() == [54] * (64 * 64 - 1)


@pytest.mark.parametrize("share", [0.0, 0.05, 0.15])
def test_the_mean_comes_to_the_target_with_what_is_white(share: float) -> None:
    light = np.full(1000, 0.3)
    light[: int(1000 * share)] = 900.0
    exposure = exposure_for(light, 54)
    assert np.minimum(light * exposure, 255).mean() == pytest.approx(54)


def test_too_little_light_is_made_white_and_darkness_stays_dark() -> None:
    light = np.zeros(1000)
    light[:20] = 4.0
    assert light.max() * exposure_for(light, 54) == pytest.approx(255)
    dark = np.zeros((8, 8))
    grey, _, _ = expose_pair(dark, dark, rng=np.random.default_rng(0), response=QUIET)
    assert not grey.any()


def test_the_lens_spreads_a_dot_by_half_a_pixel_of_640() -> None:
    light = np.full((65, 640), 0.1)
    light[32, 320] = 0.5
    grey, _, exposure = expose_pair(light, light, rng=np.random.default_rng(0), response=QUIET)
    spot = grey[31:34, 319:322] - 0.1 * exposure
    beside = np.exp(-1 / (2 * 0.5**2))
    assert spot[1, 0] / spot[1, 1] == pytest.approx(beside, abs=0.01)
    assert spot[0, 1] / spot[1, 1] == pytest.approx(beside, abs=0.01)
    assert spot.sum() == pytest.approx(0.4 * exposure, rel=0.03)
