"""The local matcher on stereo pairs with exact disparity, and against a slow reference."""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
import pytest
from dot_stereo import Rig, bias_by_fraction, plane, sphere
from numpy.typing import NDArray

from sensors.stereo import make_matcher
from sensors.stereo.local_options import LocalMatcherOptions
from sensors.stereo.numba_backend import median_rows, remove_speckles
from std_toolkit.errors import ToolkitError

TILTED = plane((0.15, 0.1, 1), 0.5)
# What a window of half this size sees reaches over the border.
MARGIN = 10


def interior(shape: tuple[int, ...], left: int = 70) -> NDArray[np.bool_]:
    inside = np.zeros(shape, dtype=bool)
    inside[MARGIN:-MARGIN, left:-MARGIN] = True
    return inside


@pytest.mark.slow
@pytest.mark.parametrize("cost", ["census", "zncc"])
@pytest.mark.parametrize("rig", [Rig(), Rig(dot_px=0.7), Rig(noise=3, seed=1)], ids=str)
def test_plane_is_recovered_without_bias(cost: str, rig: Rig) -> None:
    left, right, exact = rig.pair(TILTED)
    found = make_matcher("local", cost=cost).match(left, right)
    inside = interior(exact.shape)
    assert (found[inside] > 0).mean() > 0.995
    inside &= found > 0
    error = (found - exact)[inside]
    assert abs(error).max() < 0.5
    assert abs(error.mean()) <= 0.02
    assert abs(bias_by_fraction(error, exact[inside])).max() <= 0.02
    assert error.std() <= 0.05


def test_quadratic_fit_of_census_locks_to_pixels() -> None:
    """Why it is not the default: no error in the mean, but one that swings within each pixel."""
    left, right, exact = Rig().pair(TILTED)
    found = make_matcher("local", subpixel="quadratic").match(left, right)
    inside = interior(exact.shape) & (found > 0)
    error = (found - exact)[inside]
    assert abs(error.mean()) <= 0.02
    assert 0.05 < abs(bias_by_fraction(error, exact[inside])).max() < 0.15


@pytest.mark.parametrize("options", [{}, {"cost": "zncc", "aggregation_px": 5}], ids=str)
def test_sphere_is_recovered_without_bias(options: dict[str, object]) -> None:
    rig = Rig(width=480, height=320)
    centre = (0.02, 0, 0.65)
    left, right, exact = rig.pair(sphere(centre, 0.15, plane((0, 0, 1), 0.7)))
    found = make_matcher("local", **options).match(left, right)
    # Away from the rim, where a window sees wall and ball.
    ball = cv2.erode((exact > 35.8).astype(np.uint8), np.ones((15, 15))) > 0
    assert ball.sum() > 25000
    assert (found[ball] > 0).mean() > 0.99
    ball &= found > 0
    error = (found - exact)[ball]
    # A window sees the mean of a curved surface: the ball shrinks, the more the larger the window.
    assert abs(error.mean()) <= 0.02
    assert np.median(abs(error)) <= 0.04
    # In metres: a fit through the points has the ball's own centre and radius.
    z = rig.focal_px * rig.baseline_m / found[ball]
    v, u = np.nonzero(ball)
    x, y = (u - 239.5) / rig.focal_px * z, (v - 159.5) / rig.focal_px * z
    design = np.stack([2 * x, 2 * y, 2 * z, np.ones_like(z)], axis=1)
    fit, *_ = np.linalg.lstsq(design, x**2 + y**2 + z**2, rcond=None)
    assert fit[:3] == pytest.approx(centre, abs=0.003)
    assert np.sqrt(fit[3] + (fit[:3] ** 2).sum()) == pytest.approx(0.15, abs=0.003)


@pytest.mark.parametrize("cost", ["census", "zncc"])
def test_whole_shift_is_exact(cost: str) -> None:
    image = np.random.default_rng(3).integers(0, 256, (60, 200), dtype=np.uint8)
    left, right = image[:, :160], image[:, 17:177]
    found = make_matcher("local", cost=cost, subpixel="none").match(left, right)
    # In column 17 a shift of 18 px, the winner's neighbour, leads out of the right image.
    assert (found[:, 18:] == 17).all()
    assert not found[:, :18].any()


@pytest.mark.parametrize("cost", ["census", "zncc"])
def test_what_cannot_be_matched_stays_empty(cost: str) -> None:
    rng = np.random.default_rng(4)
    left, right, _ = Rig().pair(plane((0, 0, 1), 0.6))
    left[60:120, 120:220] = rng.normal(40, 2, (60, 100)).round()
    right[60:120, 70:190] = rng.normal(40, 2, (60, 120)).round()
    found = make_matcher("local", cost=cost).match(left, right)
    assert (found[70:110, 130:210] > 0).mean() < 0.02
    assert (found[:40, 70:-MARGIN] > 0).mean() > 0.99
    flat = np.full((80, 200), 77, dtype=np.uint8)
    assert not make_matcher("local", cost=cost).match(flat, flat).any()


def test_strip_that_only_the_left_camera_sees_is_empty() -> None:
    """A near board hides 14 px of the far wall from the right camera, left of the board."""
    rng = np.random.default_rng(5)
    far = rng.integers(0, 256, (80, 260), dtype=np.uint8)
    near = rng.integers(0, 256, (80, 60), dtype=np.uint8)
    left, right = far[:, :240].copy(), far[:, 20:].copy()
    left[:, 120:180] = near
    right[:, 120 - 34 : 180 - 34] = near
    found = make_matcher("local").match(left, right)
    assert (abs(found[:, 126:174] - 34) < 0.6).mean() > 0.99
    assert (abs(found[:, 30:100] - 20) < 0.6).mean() > 0.99
    assert (found[:, 110:116] > 0).mean() < 0.1


@pytest.mark.parametrize("cost", ["census", "zncc"])
def test_agrees_with_slow_reference(cost: str) -> None:
    """Costs by their definition, pixel by pixel, borders and all."""
    rng = np.random.default_rng(6)
    base = cv2.GaussianBlur(rng.integers(0, 256, (14, 60)).astype(np.uint8), (3, 3), 0)
    left, right = base[:, :44], base[:, 6:50]
    options = {
        "cost": cost, "zncc_px": 5, "aggregation_px": 3, "min_disparity": 2, "max_disparity": 14,
        "left_right_px": None, "uniqueness_percent": 3, "median_px": 1, "speckle_px": 0,
        "subpixel": "quadratic",
    }  # fmt: skip
    found = make_matcher("local", **options).match(left, right)
    exact = _reference(left, right, LocalMatcherOptions(**options))
    assert ((found > 0) == (exact > 0)).mean() > 0.995  # ZNCC is rounded to 1/4096
    both = (found > 0) & (exact > 0)
    assert both.mean() > 0.5
    error = np.where(both, abs(found - exact), 0)
    # Sums of windows that reach over the border are rounded, and so is ZNCC.
    assert error.max() < 0.02
    assert error[1:-1, 16:-1].max() < (1e-5 if cost == "census" else 2e-3)


def _reference(
    left: NDArray[np.uint8], right: NDArray[np.uint8], o: LocalMatcherOptions
) -> NDArray[np.float64]:
    height, width = left.shape

    def window(image: NDArray[np.uint8], x: int, y: int, side: int) -> NDArray[np.float64]:
        rows = np.clip(range(y - side // 2, y + side // 2 + 1), 0, height - 1)
        columns = np.clip(range(x - side // 2, x + side // 2 + 1), 0, width - 1)
        return image[np.ix_(rows, columns)].astype(float)

    def cost(x: int, y: int, d: int) -> float:
        if o.cost == "census":
            a, b = window(left, x, y, 7), window(right, x - d, y, 7)
            return float(((a < a[3, 3]) != (b < b[3, 3])).sum())
        a, b = window(left, x, y, o.zncc_px), window(right, x - d, y, o.zncc_px)
        a, b = a - a.mean(), b - b.mean()
        # One grey level of noise is part of every spread.
        return 1 - (a * b).mean() / np.sqrt(((a**2).mean() + 1) * ((b**2).mean() + 1))

    volume = np.full((height, width, o.count), np.nan)
    for y, x, i in product(range(height), range(width), range(o.count)):
        if x >= o.min_disparity + i:
            volume[y, x, i] = cost(x, y, o.min_disparity + i)
    out = np.zeros((height, width))
    radius = o.aggregation_px // 2
    for y, x in product(range(height), range(width)):
        box = volume[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1]
        reach = min(o.count, x - o.min_disparity + 1)
        if reach < 3:
            continue
        c = np.array([np.nanmean(box[..., i]) for i in range(reach)])
        best = int(c.argmin())
        others = np.delete(c, [k for k in (best - 1, best, best + 1) if 0 <= k < reach])
        unique = not len(others) or c[best] < others.min() * (1 - o.uniqueness_percent / 100)
        if 0 < best < reach - 1 and unique:
            a, b, m = c[best - 1], c[best + 1], c[best]
            out[y, x] = o.min_disparity + best + (a - b) / (2 * (a + b - 2 * m))
    return out


def _holey(seed: int) -> NDArray[np.float32]:
    """Blobs of disparities in sixteenths, with holes."""
    rng = np.random.default_rng(seed)
    smooth = cv2.GaussianBlur(rng.normal(size=(90, 120)), (0, 0), 3)
    values = np.rint((20 + 80 * smooth) * 16).astype(np.float32) / 16
    return np.where(rng.random(values.shape) < 0.2, 0, np.maximum(values, 0)).astype(np.float32)


def test_speckle_filter_agrees_with_opencv() -> None:
    disparity = _holey(7)
    expected = (disparity * 16).astype(np.int16)
    # OpenCV drops patches of up to so many pixels, and holes are patches of their own there.
    cv2.filterSpeckles(expected, 0, 49, 16)
    remove_speckles(disparity, 50, np.float32(1.0))
    assert 0 < (disparity > 0).sum() < (_holey(7) > 0).sum()
    np.testing.assert_array_equal(disparity, expected.astype(np.float32) / 16)


def test_median_takes_valid_neighbours_only() -> None:
    disparity = _holey(8)
    out = np.empty_like(disparity)
    median_rows(disparity, 5, 0, 90, out)
    padded = np.pad(disparity, 2)
    for y, x in product(range(90), range(120)):
        around = padded[y : y + 5, x : x + 5]
        around = np.sort(around[around > 0])
        expected = around[(len(around) - 1) // 2] if disparity[y, x] else 0
        assert out[y, x] == expected


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("cost", "sad"), ("aggregation_px", 8), ("zncc_px", 15), ("median_px", 0),
        ("max_disparity", 4), ("max_disparity", 900), ("uniqueness_percent", 100),
        ("left_right_px", -1), ("threads", 0), ("subpixel", "gaussian"), ("backend", "opencl"),
    ],
)  # fmt: skip
def test_options_that_cannot_be(field: str, value: object) -> None:
    with pytest.raises(ToolkitError, match=field):
        make_matcher("local", **{field: value})


def test_images_that_are_no_pair() -> None:
    matcher = make_matcher("local")
    grey = np.zeros((40, 60), dtype=np.uint8)
    with pytest.raises(ToolkitError, match="differ in size"):
        matcher.match(grey, grey[:, :50])
    with pytest.raises(ToolkitError, match=r"right.*grey"):
        matcher.match(grey, np.zeros((40, 60, 3), dtype=np.uint8))
    with pytest.raises(ToolkitError, match=r"left.*float64"):
        matcher.match(grey.astype(float), grey)  # type: ignore[arg-type]
