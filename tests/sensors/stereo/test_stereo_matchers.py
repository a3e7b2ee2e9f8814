"""The registry, the two other matchers, and depth from disparity."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from dot_stereo import Rig, plane

from sensors.depth_models import DepthModelOptions
from sensors.depth_models.stereo import ActiveStereo
from sensors.specs import load_sensor
from sensors.stereo import MATCHERS, disparity_to_depth, make_matcher
from std_toolkit.errors import ToolkitError


@pytest.mark.parametrize(("name", "limit_px"), [("sgbm", 0.2), ("dreds", 0.06)])
def test_plane(name: str, limit_px: float) -> None:
    left, right, exact = Rig().pair(plane((0.15, 0.1, 1), 0.5))
    found = make_matcher(name).match(left, right)
    assert found.dtype == np.float32
    inside = np.zeros(exact.shape, dtype=bool)
    inside[12:-12, 130:-12] = True
    assert (found[inside] > 0).mean() > 0.98
    error = (found - exact)[inside & (found > 0)]
    # OpenCV cuts off below a sixteenth.
    assert abs(error.mean()) < (0.04 if name == "sgbm" else 0.02)
    assert np.sqrt((error**2).mean()) < limit_px


def test_soft_minimum_lies_between_two_surfaces() -> None:
    """Half of the light comes from 20 px, half from 24: the soft minimum may answer neither."""
    rng = np.random.default_rng(0)
    base = cv2.GaussianBlur(rng.integers(0, 256, (80, 260)).astype(np.uint8), (3, 3), 0)
    left = base[:, 20:220]
    right = ((base[:, 40:240].astype(int) + base[:, 44:244]) // 2).astype(np.uint8)
    soft = make_matcher("dreds", left_right_px2=1e6).match(left, right)[10:-10, 130:-12]
    between = (soft > 20.5) & (soft < 23.5)
    assert between.mean() > 0.05
    hard = make_matcher("local", cost="zncc").match(left, right)[10:-10, 130:-12]
    assert ((hard > 20.5) & (hard < 23.5)).mean() < between.mean() / 4


def test_dreds_edges_and_holes() -> None:
    left, right, _ = Rig().pair(plane((0, 0, 1), 0.5))
    left[60:100, 150:200] = np.random.default_rng(1).integers(0, 256, (40, 50))
    found = make_matcher("dreds").match(left, right)
    assert not found[:3].any() and not found[:, :7].any() and not found[:, -3:].any()
    assert (found[68:92, 158:192] > 0).mean() < 0.5
    assert ((found == 0) | ((found >= 3) & (found <= 110))).all()


def test_registry() -> None:
    assert MATCHERS.names()[:3] == ["local", "dreds", "sgbm"]
    with pytest.raises(ToolkitError, match="known: local, dreds, sgbm"):
        make_matcher("psmnet")
    with pytest.raises(ToolkitError, match=r"stereo matcher sgbm.*blocks"):
        make_matcher("sgbm", blocks=3)
    with pytest.raises(ToolkitError, match=r"disparities.*multiple of 16"):
        make_matcher("sgbm", disparities=100)
    with pytest.raises(ToolkitError, match="median_px"):
        make_matcher("dreds", median_px=7)


def test_matcher_by_its_path() -> None:
    found = make_matcher("sensors.stereo.builtin_matchers:sgbm_matcher", block_px=3)
    assert found.options.block_px == 3  # type: ignore[attr-defined]


def test_depth_of_disparity() -> None:
    disparity = np.array([[0, 24.3, 48.6], [1.0, 243.0, 30.0]], dtype=np.float32)
    depth = disparity_to_depth(
        disparity, focal_px=443.9146, baseline_m=0.0547804, range_m=(0.16, 10.0)
    )
    assert depth.dtype == np.float32
    fb = 443.9146 * 0.0547804
    assert depth == pytest.approx(np.array([[0, fb / 24.3, fb / 48.6], [0, 0, fb / 30]]), rel=1e-6)


@pytest.mark.parametrize("name", ["local", "sgbm", "dreds"])
def test_a_simulated_camera_takes_every_matcher(name: str) -> None:
    sensor = load_sensor("d415")
    model = ActiveStereo(sensor, DepthModelOptions(width=320, height=180, matcher=name))
    left = np.random.default_rng(0).integers(0, 256, (180, 320)).astype(np.uint8)
    right = np.roll(left, -20, axis=1)
    depth = model.read((left / np.float32(255), right / np.float32(255)), seed=1).depth
    expected = model.camera.fx * sensor.baseline_m / 20
    assert np.median(depth[depth > 0]) == pytest.approx(expected, rel=0.02)
