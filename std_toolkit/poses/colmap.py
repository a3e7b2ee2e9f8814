"""Conversion to and from COLMAP, and operations on COLMAP models.

The centre of the top-left pixel is (0.5, 0.5) in COLMAP and (0, 0) in the toolkit. The functions
of this module add half a pixel on the way in and subtract it on the way out; no other module does.
COLMAP's `cam_from_world` is the toolkit's `T_cam_world`.

The operations add frames, set scale and world frame, and compute the quality of each frame.
`Reconstructed` is a model of the registered frames of a scene.
"""

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import pycolmap
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.camera_models import MODELS, Lens, Pinhole
from std_toolkit.scene import CameraModel, Frame, Scene
from std_toolkit.scene.model import Document

HALF_PIXEL = 0.5


def to_colmap_camera(camera: Camera, camera_id: int, *, distorted: bool = False) -> Any:
    """Convert to pycolmap.Camera; `distorted` forces a model with distortion parameters."""
    params = [camera.fx, camera.fy, camera.cx + HALF_PIXEL, camera.cy + HALF_PIXEL]
    k = list(camera.distortion)
    is_plain = camera.model == "opencv" and not k and not distorted
    lens = Pinhole if is_plain else MODELS[camera.model]
    # The smallest model with two focal lengths that holds all coefficients, in OpenCV's order.
    model, count = next(
        (name, count) for name, (f, count) in lens.colmap.items() if f == 2 and count >= len(k)
    )
    params += [*k, *([0.0] * (count - len(k)))]
    return pycolmap.Camera(
        camera_id=camera_id,
        model=model,
        width=camera.width,
        height=camera.height,
        params=params,
        has_prior_focal_length=True,
    )


def from_colmap_camera(camera: Any) -> Camera:
    """Convert a pycolmap.Camera to the toolkit's camera.

    Raises:
        ToolkitError: no lens of `geometry.camera_models` has this camera model.
    """
    name, p = camera.model_name, [float(x) for x in camera.params]
    lenses: list[tuple[str, type[Lens]]] = [("opencv", Pinhole), *MODELS.items()]
    found = next(((model, lens) for model, lens in lenses if name in lens.colmap), None)
    if found is None:
        raise ToolkitError("cannot convert this COLMAP camera model", value=name)
    model, lens = found
    focal_lengths, count = lens.colmap[name]
    fx, fy, cx, cy, *k = p if focal_lengths == 2 else [p[0], *p]
    k += [0.0] * (next(n for n in lens.counts if n >= count) - count)
    if focal_lengths == 1 and model == "opencv" and not any(k):
        k = []
    size = (camera.width, camera.height)
    return Camera(*size, fx, fy, cx - HALF_PIXEL, cy - HALF_PIXEL, tuple(k), model)


def to_colmap_pixels(uv: NDArray[np.floating]) -> NDArray[np.float64]:
    """Convert pixels (..., 2) to COLMAP's origin."""
    return np.asarray(uv, dtype=np.float64) + HALF_PIXEL


def from_colmap_pixels(uv: NDArray[np.floating]) -> NDArray[np.float64]:
    """Convert pixels (..., 2) to the toolkit's origin."""
    return np.asarray(uv, dtype=np.float64) - HALF_PIXEL


def to_rigid3d(T_cam_world: SE3) -> Any:
    """Convert a pose to a pycolmap.Rigid3d (`cam_from_world`)."""
    return pycolmap.Rigid3d(T_cam_world.matrix()[:3])


def from_rigid3d(cam_from_world: Any) -> SE3:
    """Convert a pycolmap.Rigid3d to a pose `T_cam_world`."""
    return SE3.from_matrix(np.asarray(cam_from_world.matrix(), dtype=np.float64))


@contextmanager
def quiet_colmap() -> Iterator[None]:
    """Discard COLMAP's log output. Failures still raise exceptions.

    COLMAP's entry points reset their log level, so file descriptor 2 is redirected.
    """
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


@dataclass(frozen=True, eq=False)
class Observations:
    """Points of the model observed in one registered image.

    Attributes:
        T_cam_world: pose of the image.
        uv: (N, 2) measured pixels, pixel centres at integers.
        xyz: (N, 3) points, world frame.
        camera: intrinsics of the model.
        track_length: (N,) number of images that observe each point.
    """

    T_cam_world: SE3
    uv: NDArray[np.float64]
    xyz: NDArray[np.float64]
    camera: Camera
    track_length: NDArray[np.int64]

    @property
    def points_cam(self) -> NDArray[np.float64]:
        """(N, 3) points in the camera frame."""
        return self.T_cam_world @ self.xyz

    @property
    def residuals(self) -> NDArray[np.float64]:
        """(N, 2) projected minus measured pixels."""
        return self.camera.project(self.points_cam) - self.uv


def add_image(
    model: Any,
    *,
    image_id: int,
    name: str,
    camera_id: int,
    T_cam_world: SE3,
    uv: NDArray[np.floating],
    point_ids: NDArray[np.int64],
) -> None:
    """Add a registered image that observes existing points.

    Args:
        model: pycolmap.Reconstruction.
        image_id: id that is not yet in the model.
        uv: (N, 2) pixels.
        point_ids: (N,) id of the point observed at each pixel; points that are no longer in the
            model are skipped.
    """
    keep = np.array([model.exists_point3D(int(p)) for p in point_ids], dtype=bool)
    image = pycolmap.Image(
        name=name, keypoints=to_colmap_pixels(uv[keep]), camera_id=camera_id, image_id=image_id
    )
    model.add_image_with_trivial_frame(image, to_rigid3d(T_cam_world))
    for i, point_id in enumerate(point_ids[keep]):
        model.add_observation(int(point_id), pycolmap.TrackElement(image_id, i))


def observations(model: Any, image_id: int) -> Observations:
    """Return all observations of a registered image."""
    image = model.image(image_id)
    points2d = image.points2D
    points3d = model.points3D
    indices = image.get_observation_point2D_idxs()
    seen = [points3d[points2d[i].point3D_id] for i in indices]
    return Observations(
        T_cam_world=from_rigid3d(image.cam_from_world()),
        uv=from_colmap_pixels(np.array([points2d[i].xy for i in indices]).reshape(-1, 2)),
        xyz=np.array([p.xyz for p in seen]).reshape(-1, 3),
        camera=from_colmap_camera(model.camera(image.camera_id)),
        track_length=np.array([p.track.length() for p in seen], dtype=np.int64),
    )


def pose_covariance(seen: Observations) -> NDArray[np.float64] | None:
    """(6, 6) covariance of `T_world_cam` for a right perturbation `T_world_cam @ SE3.exp(xi)`.

    xi = (rho, phi) in units of the model and radians. The covariance follows from the normal
    equations of the pose alone: the points count as exact, and the pixel variance is that of the
    residuals. None if the image has too few observations to determine its pose.
    """
    p = seen.points_cam
    if len(p) < 4:
        return None
    r = seen.residuals.ravel()
    x, y, z = p.T
    zero = np.zeros_like(z)
    fx, fy = seen.camera.fx, seen.camera.fy
    by_point = np.stack(
        [
            np.stack([fx / z, zero, -fx * x / z**2], axis=-1),
            np.stack([zero, fy / z, -fy * y / z**2], axis=-1),
        ],
        axis=1,
    )
    # p_cam = exp(-xi) p, whose first-order change is -rho - phi x p = -rho + [p]x phi.
    cross = np.stack(
        [
            np.stack([zero, -z, y], axis=-1),
            np.stack([z, zero, -x], axis=-1),
            np.stack([-y, x, zero], axis=-1),
        ],
        axis=1,
    )
    moved = np.concatenate([np.broadcast_to(-np.eye(3), cross.shape), cross], axis=2)
    J = (by_point @ moved).reshape(-1, 6)
    variance = float(r @ r) / max(1, len(r) - 6)
    try:
        covariance = np.linalg.inv(J.T @ J) * variance
    except np.linalg.LinAlgError:
        return None
    return covariance if np.isfinite(covariance).all() else None


def place_in_world(model: Any, *, scale: float, first_image: int) -> None:
    """Scale the model in place and make the camera of `first_image` its world frame.

    Args:
        model: pycolmap.Reconstruction.
        scale: metres per unit of the model.
        first_image: image id.
    """
    T_cam_world = from_rigid3d(model.image(first_image).cam_from_world())
    rotation = pycolmap.Rotation3d(T_cam_world.R)
    model.transform(pycolmap.Sim3d(scale, rotation, scale * T_cam_world.t))


def scale_world(model: Any, factor: float) -> None:
    """Scale the model about the origin of its world, in place."""
    if factor != 1:
        model.transform(pycolmap.Sim3d(factor, pycolmap.Rotation3d(), np.zeros(3)))


class Reconstruction(Document, frozen=True, kw_only=True):
    """Metadata of a cached model.

    Attributes:
        keyframes: frame ids of the keyframes.
        camera_ids: COLMAP camera id by camera key.
        other_sizes: number of images in each smaller model that was dropped.
        explained: fraction of the matches of neighbouring images that the model explains, if all
            pairs were matched.
    """

    keyframes: list[int]
    camera_ids: dict[str, int]
    other_sizes: list[int] = msgspec.field(default_factory=list)
    explained: float | None = None


@dataclass(frozen=True)
class Reconstructed:
    """A model of all registered frames.

    Attributes:
        model: pycolmap.Reconstruction; image id = frame id + 1.
        about: metadata of the model.
    """

    model: Any
    about: Reconstruction

    def image_ids(self, frames: Sequence[Frame]) -> dict[int, int]:
        """Return COLMAP image ids by frame id for the registered frames, in ascending order."""
        ids = {f.id: image_id_of(f) for f in frames}
        return {
            f: i
            for f, i in ids.items()
            if self.model.exists_image(i) and self.model.image(i).has_pose
        }

    def cameras(self) -> dict[str, Camera]:
        """Return the adjusted intrinsics by camera key."""
        return {
            key: from_colmap_camera(self.model.camera(number))
            for key, number in self.about.camera_ids.items()
            if self.model.exists_camera(number)
        }


def image_id_of(frame: Frame) -> int:
    """Return the COLMAP image id of a frame; COLMAP counts from 1."""
    return frame.id + 1


def adjusted_cameras(scene: Scene, done: Reconstructed) -> dict[str, CameraModel]:
    """Return the adjusted intrinsics that differ from those of scene.json, by camera key."""
    changed = {}
    for key, camera in done.cameras().items():
        if camera != scene.info.cameras[key].camera():
            changed[key] = CameraModel.of(camera)
    return changed
