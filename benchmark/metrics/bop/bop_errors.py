"""BOP's pose errors: VSD, and MSPD of single poses.

Source: T. Hodan et al., "BOP Challenge 2020", equations 1, 2 and 4, with the 2019 definition of
visibility: where the sensor has no measurement, the object counts as visible.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.bop.bop_distances import ModelDistances, pinhole
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, Symmetry
from std_toolkit.rendering.mesh import RenderMesh
from std_toolkit.rendering.renderer import (
    Renderer,
    Window,
    image_window,
    normalised_rays,
    object_window,
)

DELTA_M = 0.015

TAUS = tuple(round(0.05 * k, 2) for k in range(1, 11))

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SeenSurface:
    """A rendered mesh without occluders, and its visible part.

    Attributes:
        window: part of the image that the arrays cover; None if the mesh is outside the image.
        distance: (h, w) metres from the camera centre, 0 outside the mesh.
        visible: (h, w) mask of pixels without a nearer measurement of the sensor, or without any.
    """

    window: Window | None
    distance: NDArray[np.float32]
    visible: NDArray[np.bool_]


def see(
    renderer: Renderer,
    camera: Camera,
    mesh: RenderMesh,
    T_cam_obj: SE3,
    depth: NDArray[np.floating],
    *,
    delta_m: float = DELTA_M,
) -> SeenSurface:
    """Render a posed mesh, and compare it with the sensor's depth.

    Args:
        renderer: draws the mesh.
        camera: of the depth image.
        mesh: of the object.
        T_cam_obj: its pose.
        depth: (H, W) the sensor's z-depth in metres, 0 where nothing was measured.
        delta_m: the mesh may be this much farther than what was measured.

    Returns:
        The surface seen.

    Raises:
        ToolkitError: depth of another size than the camera's images.

    >>> from std_toolkit.rendering.raycast import RaycastRenderer
    >>> camera = Camera(64, 48, 60, 60, 31.5, 23.5)
    >>> corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    >>> mesh = RenderMesh.from_arrays(corners, np.array([[0, 1, 2]]))
    >>> pose = SE3(np.eye(3), np.array([0.0, 0.0, 9.0]))
    >>> see(RaycastRenderer(), camera, mesh, pose, np.full((48, 64), 9.0)).visible.any()
    np.True_
    """
    if depth.shape != (camera.height, camera.width):
        raise ToolkitError(
            "depth is not of the camera's size",
            value=depth.shape,
            hint=f"expected {(camera.height, camera.width)}",
        )
    window = object_window(camera, mesh, T_cam_obj)
    if window is None:
        nothing = np.zeros((0, 0), np.float32)
        return SeenSurface(None, nothing, nothing.astype(bool))
    x, y = normalised_rays(camera, window)
    along = np.sqrt(x * x + y * y + 1).astype(np.float32)
    distance = renderer.draw(camera, mesh, T_cam_obj, window=window).depth * along
    measured = depth[window.slices_in(image_window(camera))] * along
    visible = (distance > 0) & ((measured == 0) | (distance - measured <= delta_m))
    return SeenSurface(window, distance, visible)


def vsd(
    estimate: SeenSurface,
    truth: SeenSurface,
    diameter_m: float,
    *,
    taus: Sequence[float] = TAUS,
) -> NDArray[np.float64]:
    """Visible surface discrepancy: the share of visible pixels where the surfaces disagree.

    Args:
        estimate, truth: the mesh at both poses, of one image.
        diameter_m: of the object.
        taus: largest differences of distance that agree, in diameters.

    Returns:
        (len(taus),) errors in [0, 1].

    Raises:
        ToolkitError: a diameter that is not positive.

    >>> one = np.ones((1, 2), np.float32)
    >>> true = SeenSurface(Window(0, 0, 2, 1), one, one > 0)
    >>> off = SeenSurface(Window(1, 0, 2, 1), one + 0.02, one > 0)  # one pixel of three in common
    >>> vsd(off, true, 0.1, taus=(0.1, 0.5)).round(3).tolist()
    [1.0, 0.667]
    """
    if not diameter_m > 0:
        raise ToolkitError("must be positive", field="diameter_m", value=diameter_m)
    if estimate.window is None or truth.window is None:
        return np.ones(len(taus))
    outer = _around(estimate.window, truth.window)
    d_est, v_est = _spread(estimate, outer)
    d_true, v_true = _spread(truth, outer)
    # What is visible at the true pose is not hidden from the estimate at the same pixel.
    v_est = v_est | (v_true & (d_est > 0))
    both, either = v_est & v_true, v_est | v_true
    union = int(either.sum())
    if not union:
        return np.ones(len(taus))
    apart = np.abs(d_est[both] - d_true[both]) / diameter_m
    wrong = (apart >= np.asarray(taus)[:, None]).sum(axis=1) + union - len(apart)
    return np.asarray(wrong / union, dtype=np.float64)


def _around(a: Window, b: Window) -> Window:
    x, y = min(a.x, b.x), min(a.y, b.y)
    return Window(x, y, max(a.x1, b.x1) - x, max(a.y1, b.y1) - y)


def _spread(seen: SeenSurface, outer: Window) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Distance and visibility in a larger window."""
    assert seen.window is not None
    distance = np.zeros((outer.height, outer.width), np.float32)
    visible = np.zeros(distance.shape, dtype=bool)
    at = seen.window.slices_in(outer)
    distance[at], visible[at] = seen.distance, seen.visible
    return distance, visible


def mspd(
    estimate: SE3,
    truth: SE3,
    vertices: NDArray[np.floating],
    camera: Camera,
    symmetry: Symmetry | None = None,
    *,
    steps: int | None = None,
) -> float:
    """Maximum symmetry-aware projection distance, pixels.

    Args:
        estimate, truth: T_cam_obj of both.
        vertices: (V, 3) of the mesh, object frame, metres.
        camera: projects them, without lens distortion, as BOP does.
        symmetry: of the object; none means the identity alone.
        steps: samples of a full turn about a continuous axis; None for the exact minimum.

    Returns:
        The distance; infinity if a vertex is not in front of the camera.

    Raises:
        ToolkitError: vertices of another shape.

    >>> camera = Camera(640, 480, 500, 500, 319.5, 239.5)
    >>> off = SE3(np.eye(3), np.array([0.01, 0, 1.0]))
    >>> mspd(off, SE3(np.eye(3), np.array([0, 0, 1.0])), np.zeros((1, 3)), camera)
    5.0
    """
    points = np.asarray(vertices, dtype=np.float64)
    model = ModelDistances(points, points, symmetry or Symmetry(), steps)
    return float(model.mspd([estimate], [truth], pinhole(camera))[0, 0])
