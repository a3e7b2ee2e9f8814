"""The matchers on a real D415's infrared pair, against the depth that the camera itself gave."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from real_pair import compare, load_pair

from sensors.stereo import make_matcher

pytestmark = pytest.mark.real


@pytest.mark.parametrize("options", [{}, {"cost": "zncc"}, {"subpixel": "quadratic"}], ids=str)
def test_local_matcher_is_near_the_camera(test_data: Path, options: dict[str, str]) -> None:
    pair = load_pair(test_data)
    found = compare(pair, make_matcher("local", **options).match(pair.left, pair.right))
    assert found.scale == pytest.approx(1.012, abs=0.001)
    assert found.median_mm <= 1.0
    assert found.within_10_mm >= 0.98
    assert abs(found.complete - found.camera_complete) <= 0.05


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sgbm", "dreds"])
def test_other_matchers_see_the_same_scene(test_data: Path, name: str) -> None:
    pair = load_pair(test_data)
    found = compare(pair, make_matcher(name).match(pair.left, pair.right))
    assert found.scale == pytest.approx(1.012, abs=0.001)
    assert found.median_mm <= 1.1
    assert found.within_10_mm >= 0.97
    assert found.complete > 0.75


@pytest.mark.slow
def test_backends_agree_on_the_real_pair(test_data: Path) -> None:
    pytest.importorskip("torch")
    pair = load_pair(test_data)
    compiled = make_matcher("local").match(pair.left, pair.right)
    tensors = make_matcher("local", backend="torch").match(pair.left, pair.right)
    np.testing.assert_array_equal(compiled > 0, tensors > 0)
    np.testing.assert_allclose(compiled, tensors, rtol=0, atol=1e-4)
