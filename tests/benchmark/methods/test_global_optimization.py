"""Depth from exact normals: planes, spheres, boundaries, and what is refused."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from benchmark.methods.depth.cleargrasp.global_optimization import (
    OptimizationOptions,
    normals_to_opencv,
    optimize_depth,
)
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera, pixel_rays

CAMERA = Camera(256, 144, 185, 185, 128, 72)
SHAPE = (CAMERA.height, CAMERA.width)
EXACT = OptimizationOptions(grow_px=0)


def plane(normal: tuple[float, float, float], offset: float, camera: Camera = CAMERA) -> tuple:
    """Depth and normals of the plane n . p = offset, n made a unit vector towards the camera."""
    n = np.array(normal) / np.linalg.norm(normal)
    depth = offset / (pixel_rays(camera) @ n)
    return depth, np.broadcast_to(-np.sign(offset) * n, (*depth.shape, 3)).copy()


def sphere_before_wall() -> tuple[NDArray, NDArray, NDArray]:
    """Depth, normals and silhouette of a sphere of 10 cm radius 30 cm before a wall."""
    rays, center, radius = pixel_rays(CAMERA), np.array([0.03, -0.02, 0.6]), 0.1
    a, b = (rays**2).sum(axis=-1), rays @ center
    inside = b**2 - a * (center @ center - radius**2)
    on = inside > 0
    near = (b - np.sqrt(np.maximum(inside, 0))) / a
    depth = np.where(on, near, 0.9)
    towards = (rays * near[..., None] - center) / radius
    return depth, np.where(on[..., None], towards, [0, 0, -1.0]), on


def test_a_plane_is_recovered_from_its_normals() -> None:
    depth, normals = plane((0.2, -0.5, -0.9), -0.6)
    mask = np.zeros(SHAPE, dtype=bool)
    mask[36:108, 64:192] = True
    found = optimize_depth(depth, normals, None, mask, CAMERA)
    assert found.dtype == np.float32
    assert np.abs(found / depth - 1).max() < 1e-6


def test_wrong_measurements_inside_the_mask_have_no_influence() -> None:
    depth, normals = plane((0, 0.3, -1), -0.7)
    mask = np.zeros(SHAPE, dtype=bool)
    mask[40:100, 80:160] = True
    wrong = depth.copy()
    wrong[38:102, 78:162] += 0.2  # two pixels wider than the mask, which is widened by two
    assert np.abs(optimize_depth(wrong, normals, None, mask, CAMERA) / depth - 1).max() < 1e-6
    narrow = optimize_depth(wrong, normals, None, mask, CAMERA, EXACT)
    assert np.abs(narrow / depth - 1).max() > 0.05


@pytest.mark.parametrize("camera", [Camera(256, 144, 185, 260, 120, 75)])
def test_focal_lengths_that_differ(camera: Camera) -> None:
    depth, normals = plane((0.4, -0.3, -0.8), -0.6, camera)
    mask = np.zeros(SHAPE, dtype=bool)
    mask[36:108, 64:192] = True
    assert np.abs(optimize_depth(depth, normals, None, mask, camera) / depth - 1).max() < 1e-6


def test_a_sphere_is_recovered_from_normals_and_one_patch_of_depth() -> None:
    depth, normals, on = sphere_before_wall()
    hidden = on.copy()
    hidden[60:70, 132:142] = False
    assert on[60:70, 132:142].all()
    edge = cv2.morphologyEx(on.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    seen = np.where(hidden, 0, depth)
    found = optimize_depth(seen, normals, edge.astype(float), None, CAMERA)
    error = np.abs(found / depth - 1)
    # First differences are off by half the curvature times a pixel, most where it turns away.
    assert np.median(error[hidden & ~edge]) < 1e-4
    assert error[hidden & ~edge].max() < 1e-3
    assert error[~hidden].max() < 1e-5
    # Without the boundaries the wall pulls the sphere's rim back.
    closed = optimize_depth(seen, normals, None, None, CAMERA)
    assert np.median(np.abs(closed / depth - 1)[hidden & ~edge]) > 10 * np.median(
        error[hidden & ~edge]
    )


def test_normals_of_cleargrasp_become_those_of_opencv() -> None:
    up_and_towards = np.array([0.0, 0.6, 0.8])
    assert normals_to_opencv(up_and_towards).tolist() == [0, -0.6, -0.8]
    assert np.array_equal(normals_to_opencv(normals_to_opencv(up_and_towards)), up_and_towards)


def test_a_floor_recedes_upwards_in_both_conventions() -> None:
    # A floor below the camera, seen obliquely: its normal points up, and depth grows upwards.
    depth, _ = plane((0, 1, 0.3), 0.5)
    mask = np.zeros(SHAPE, dtype=bool)
    mask[70:130] = True
    seen = np.where(depth > 0, depth, 0)
    up = np.array([0, 1, 0.3]) / np.hypot(1, 0.3)  # y up, z towards the camera
    normals = normals_to_opencv(np.broadcast_to(up, (*SHAPE, 3)).copy())
    found = optimize_depth(np.where(mask, 0, seen), -normals, None, None, CAMERA)
    good = optimize_depth(np.where(mask, 0, seen), normals, None, None, CAMERA)
    assert np.abs(good / depth - 1)[mask].max() < 1e-5
    assert np.abs(found / depth - 1)[mask].max() > 1e-3  # facing away: not used, only smooth


def test_the_system_is_the_documented_energy() -> None:
    """Against a dense solver of the residuals, written out one by one."""
    camera = Camera(6, 5, 6.5, 7.0, 2.6, 2.1)
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.6, 0.9, (5, 6))
    depth[1:4, 2:5] = 0
    normals = rng.normal(size=(5, 6, 3)) * 0.2 + [0, 0, -1.0]
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    boundary = rng.uniform(size=(5, 6))
    options = OptimizationOptions(observed_weight=2, smoothness_weight=0.3, normal_weight=0.4)
    rays = pixel_rays(camera)
    rows, right = [], []
    for v in range(5):
        for u in range(6):
            if depth[v, u] > 0:
                row = np.zeros((5, 6))
                row[v, u] = 2
                rows.append(row)
                right.append(2 * depth[v, u])
            for y, x in ((v - 1, u), (v + 1, u), (v, u - 1), (v, u + 1)):
                if not (0 <= y < 5 and 0 <= x < 6):
                    continue
                row = np.zeros((5, 6))
                row[v, u], row[y, x] = -0.3, 0.3
                rows.append(row)
                weight = 0.4 * camera.fx * max((1 - boundary[v, u]) ** 3, 0.001)
                row = np.zeros((5, 6))
                row[v, u] = -weight * normals[v, u] @ rays[v, u]
                row[y, x] = weight * normals[v, u] @ rays[y, x]
                rows.append(row)
                right += [0, 0]
    expected = lsq_linear(np.array(rows).reshape(len(rows), -1), right).x.reshape(5, 6)
    found = optimize_depth(depth, normals, boundary, None, camera, options)
    assert np.allclose(found, expected, rtol=1e-5)


def test_pixels_without_a_normal_are_bridged_smoothly() -> None:
    depth, normals = plane((0, 0, -1), -0.8)
    mask = np.zeros(SHAPE, dtype=bool)
    mask[36:108, 64:192] = True
    normals[60:80, 100:150] = 0
    normals[90:95, 100:150] = np.nan
    normals[40:50, 100:150] = -1  # how ClearGrasp's files tell that there is none
    found = optimize_depth(depth, normals, None, mask, CAMERA)
    assert np.abs(found / depth - 1).max() < 1e-5


def test_without_a_measurement_there_is_no_answer() -> None:
    depth, normals = plane((0, 0, -1), -0.8)
    everything = np.ones(SHAPE, dtype=bool)
    assert not optimize_depth(depth, normals, None, everything, CAMERA).any()
    assert not optimize_depth(0.05 * depth, normals, None, None, CAMERA).any()  # all too near
    assert not optimize_depth(np.full(SHAPE, np.nan), normals, None, None, CAMERA).any()


def test_the_unit_of_depth_does_not_matter() -> None:
    depth, normals, on = sphere_before_wall()
    options = OptimizationOptions(nearest_m=0)
    seen = np.where(on, 0, depth)
    metres = optimize_depth(seen, normals, None, None, CAMERA, options)
    millimetres = optimize_depth(1000 * seen, normals, None, None, CAMERA, options)
    assert np.allclose(millimetres, 1000 * metres, rtol=1e-5)


@pytest.mark.parametrize("field", ["depth", "normals", "boundary", "mask"])
def test_sizes_that_do_not_fit_are_refused(field: str) -> None:
    depth, normals = plane((0, 0, -1), -0.8)
    parts = {"depth": depth, "normals": normals, "boundary": depth * 0, "mask": depth < 0}
    parts[field] = parts[field][1:]
    with pytest.raises(ToolkitError, match=f"{field}: does not fit the camera's 256x144"):
        optimize_depth(camera=CAMERA, **parts)


@pytest.mark.parametrize("value", [-0.1, 1.5, np.nan])
def test_boundaries_that_are_no_probabilities_are_refused(value: float) -> None:
    depth, normals = plane((0, 0, -1), -0.8)
    with pytest.raises(ToolkitError, match="boundary: must hold probabilities"):
        optimize_depth(depth, normals, np.full(SHAPE, value), None, CAMERA)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("smoothness_weight", 0.0),
        ("observed_weight", np.nan),
        ("normal_weight", -1.0),
        ("boundary_power", np.inf),
        ("grow_px", -1),
    ],
)
def test_weights_that_make_no_sense_are_refused(name: str, value: float) -> None:
    with pytest.raises(ToolkitError, match=f"{name}: must"):
        OptimizationOptions(**{name: value})
