"""One world pose from an object's annotations in one or several frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.pose_error import mssd
from std_toolkit.geometry.se3 import SE3, skew
from std_toolkit.geometry.symmetry import Symmetry
from std_toolkit.geometry.variants import nearest_variant

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AnnotatedView:
    """One annotation with the camera it was made in.

    Attributes:
        camera: intrinsics of the frame.
        T_world_cam: pose of the frame, metres.
        T_cam_obj: the annotation.
    """

    camera: Camera
    T_world_cam: SE3
    T_cam_obj: SE3

    @property
    def T_world_obj(self) -> SE3:
        return self.T_world_cam @ self.T_cam_obj


def fuse_views(
    views: Sequence[AnnotatedView], points: NDArray[np.floating], symmetry: Symmetry
) -> SE3:
    """T_world_obj that agrees best with all annotations, in pixels.

    An annotation made in one image is good sideways and weak along the viewing ray. Comparing
    pixels weighs it accordingly: views from different sides fix each other's depth, which a mean
    of the poses would not do.

    Args:
        views: at least one. The first one's symmetric variant is kept.
        points: (P, 3) points on the object (hull vertices, bounding-box corners), mesh frame.
        symmetry: a later view may show any symmetric variant of the first.

    Raises:
        ToolkitError: no views, or views that contradict each other by more than half of the
            object's size.
    """
    if not views:
        raise ToolkitError("no annotated view to start from")
    first = views[0].T_world_obj
    if len(views) == 1:
        return first
    X = np.asarray(points, dtype=np.float64)
    size = float(np.ptp(X, axis=0).max())
    aligned = [(views[0], views[0].T_cam_obj)]
    for view in views[1:]:
        T = nearest_variant(view.T_world_obj, first, X, symmetry)
        apart = mssd(T, first, X)
        if apart > size:
            raise ToolkitError(
                "two annotations of one object contradict each other",
                value=f"{apart * 1000:.0f} mm apart in the world",
                hint="is one of them of another object, or a camera pose wrong?",
            )
        aligned.append((view, view.T_world_cam.inverse() @ T))
    pose = first
    targets = [(v, v.camera.without_distortion().project(T @ X)) for v, T in aligned]
    for _ in range(30):
        A, b = np.zeros((6, 6)), np.zeros(6)
        for view, pixels in targets:
            error, J = _projection(view, pose, X, pixels)
            # Huber: one careless view among several must not drag the rest.
            weight = np.minimum(1, 5 / np.maximum(np.linalg.norm(error, axis=1), 1e-9))
            A += np.einsum("n,nij,nik->jk", weight, J, J)
            b += np.einsum("n,nij,ni->j", weight, J, error)
        step = np.linalg.solve(A + 1e-9 * np.diag(np.diag(A)), -b)
        pose = pose @ SE3.exp(step)
        if np.linalg.norm(step) < 1e-10:
            break
    return pose


def _projection(view: AnnotatedView, pose: SE3, X: Array, pixels: Array) -> tuple[Array, Array]:
    """Pixel errors (N, 2) and their derivative (N, 2, 6) by a right perturbation of the pose."""
    T = view.T_world_cam.inverse() @ pose
    p = T @ X
    z = np.maximum(p[:, 2], 1e-3)
    camera = view.camera
    u = camera.fx * p[:, 0] / z + camera.cx
    v = camera.fy * p[:, 1] / z + camera.cy
    zero = np.zeros_like(z)
    d_pixel = np.stack(
        [
            np.stack([camera.fx / z, zero, -camera.fx * p[:, 0] / z**2], axis=-1),
            np.stack([zero, camera.fy / z, -camera.fy * p[:, 1] / z**2], axis=-1),
        ],
        axis=1,
    )
    d_point = np.concatenate(
        [np.broadcast_to(T.R, (len(X), 3, 3)), -T.R @ np.stack([skew(x) for x in X])], axis=-1
    )
    return np.stack([u, v], axis=-1) - pixels, d_pixel @ d_point
