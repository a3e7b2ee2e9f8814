"""A lens that the intrinsics lack shows in the reprojection errors of a reconstruction."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pycolmap
import pytest

from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.se3 import so3_exp
from std_toolkit.poses.colmap import add_image, to_colmap_camera
from std_toolkit.poses.lens_check import LensCheckSettings, LensShift, lens_gate, lens_shifts

PINHOLE = Camera(320, 240, 300.0, 300.0, 160.0, 118.0)
RADIAL = replace(PINHOLE, distortion=(-0.28, 0.07, 2e-4, 1.7e-5))
FISHEYE = replace(PINHOLE, distortion=(0.03, 0.005, 6e-4, 1e-4), model="fisheye")
EIGHT = replace(PINHOLE, distortion=(5.2, 3.1, 2e-4, 1e-4, 0.2, 5.5, 4.6, 0.9))


def model_of(seen: Camera, filed: Camera, *, noise_px: float = 0.3, images: int = 8) -> Any:
    """A reconstruction with the intrinsics `filed`, of images that `seen` took."""
    rng = np.random.default_rng(3)
    points = rng.uniform((-0.6, -0.45, 0.8), (0.6, 0.45, 1.8), (600, 3))
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(to_colmap_camera(filed, 1))
    for xyz in points:
        model.add_point3D(xyz + rng.normal(0, 1e-3, 3), pycolmap.Track())
    for i in range(images):
        angle = 0.5 * (i / (images - 1) - 0.5)
        T = SE3(so3_exp([0.1 * np.sin(i), angle, 0.05 * i]), np.array([angle, 0.05 * (i % 3), 0.0]))
        uv = seen.project(T @ points) + rng.normal(0, noise_px, (len(points), 2))
        inside = np.isfinite(uv).all(axis=1) & (uv > 0).all(axis=1) & (uv < [320, 240]).all(axis=1)
        add_image(
            model, image_id=i + 1, name=f"{i}", camera_id=1, T_cam_world=T, uv=uv[inside],
            point_ids=np.flatnonzero(inside) + 1,
        )  # fmt: skip
    return model


def shift_of(seen: Camera, filed: Camera, **changes: Any) -> LensShift:
    model = model_of(seen, filed, **changes)
    (found,) = lens_shifts(model, model.reg_image_ids(), {"color": 1})
    return found


@pytest.mark.parametrize("filed", [PINHOLE, replace(RADIAL, distortion=(0.28, -0.07, 0.0, 0.0))])
def test_a_missing_or_wrong_lens_fails_the_gate(filed: Camera) -> None:
    found = shift_of(RADIAL, filed)
    assert found.gain > 0.2 and found.share > 0.05
    gate = lens_gate([found])
    assert gate is not None and not gate.passed
    assert gate.value == found.share and "k1" in gate.advice and "--distortion" in gate.advice
    if filed is PINHOLE:
        assert found.k1 == pytest.approx(-0.28, abs=0.03)


@pytest.mark.parametrize("camera", [PINHOLE, RADIAL, EIGHT, FISHEYE])
def test_the_right_lens_passes(camera: Camera) -> None:
    gate = lens_gate([shift_of(camera, camera)])
    assert gate is not None and gate.passed


def test_a_slight_distortion_passes() -> None:
    found = shift_of(replace(PINHOLE, distortion=(-0.03, 0.0, 0.0, 0.0)), PINHOLE, noise_px=0.02)
    gate = lens_gate([found])
    assert found.gain > LensCheckSettings.current().smallest_gain
    assert gate is not None and gate.passed and 0.005 < gate.value < gate.limit


def test_the_model_is_not_changed() -> None:
    model = model_of(RADIAL, PINHOLE)
    before = [p.xyz.tolist() for p in model.points3D.values()]
    lens_shifts(model, model.reg_image_ids(), {"color": 1})
    assert [p.xyz.tolist() for p in model.points3D.values()] == before


def test_too_little_is_no_gate() -> None:
    model = model_of(RADIAL, PINHOLE, images=2)
    assert lens_shifts(model, model.reg_image_ids(), {"color": 1}) == []
    assert lens_gate([]) is None
