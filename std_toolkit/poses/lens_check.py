"""Whether the images are bent by a lens that the intrinsics lack, or have otherwise.

A lens that is missing bends the scene and the path with it, so that the reprojection errors stay
small. What remains is their radial trend: the bundle adjustment of some images with two radial
coefficients free finds the lens again and lowers the errors.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.geometry import Camera
from std_toolkit.poses.colmap import add_image, observations, quiet_colmap, to_colmap_camera
from std_toolkit.scene.model import Gate
from std_toolkit.settings import Settings, limit


@dataclass(frozen=True, kw_only=True)
class LensCheckSettings(Settings):
    """When the images contradict the lens."""

    largest_shift: float = limit(
        0.02,
        source="cameras that are sold as free of distortion stay below 0.01; lenses that are "
        "modelled have more",
    )
    """gate: largest shift of a pixel by the lens that is found, as a fraction of half the image's
    diagonal"""
    smallest_gain: float = limit(
        0.1, source="errors of features and of moving points do not fall with the radius"
    )
    """the errors fall at least by this fraction with the lens that is found"""
    fewest: int = limit(200, source="two coefficients and a pose of each image are estimated")
    """observations that the estimate needs"""


# Images that are adjusted, and points in each.
_IMAGES, _POINTS = 20, 800
_STEPS = 40


@dataclass(frozen=True)
class LensShift:
    """The lens that the images show beside that of the intrinsics.

    Attributes:
        camera: key of the camera.
        share: largest shift of a pixel, as a fraction of half the diagonal.
        k1, k2: its radial coefficients.
        gain: fraction by which the reprojection error falls.
    """

    camera: str
    share: float
    k1: float
    k2: float
    gain: float


def lens_shifts(model: Any, image_ids: Iterable[int], cameras: dict[str, int]) -> list[LensShift]:
    """Estimate the remaining distortion of each camera.

    Args:
        model: pycolmap.Reconstruction; it is not changed.
        image_ids: its registered images.
        cameras: COLMAP camera id by camera key.
    """
    ids = list(image_ids)
    found = []
    for key, number in cameras.items():
        own = [i for i in ids if model.image(i).camera_id == number]
        shift = _estimated(model, own, key)
        if shift is not None:
            found.append(shift)
    return found


def lens_gate(shifts: Iterable[LensShift]) -> Gate | None:
    """The gate `lens_shift_share`; None if no lens could be estimated."""
    limits = LensCheckSettings.current()
    rows = list(shifts)
    if not rows:
        return None
    bent = [s for s in rows if s.gain >= limits.smallest_gain]
    worst = max(bent, key=lambda s: s.share, default=None)
    value = 0.0 if worst is None else worst.share
    passed = value <= limits.largest_shift
    advice = ""
    if not passed and worst is not None:
        advice = (
            f"the images of camera {worst.camera} are bent as by a lens with k1 {worst.k1:.3g}, k2 "
            f"{worst.k2:.3g} beside that of the intrinsics: is its distortion missing or another "
            "one's? import again with --distortion or a calibration, or try --refine distortion"
        )
    return Gate(
        name="lens_shift_share",
        value=value,
        limit=limits.largest_shift,
        passed=passed,
        advice=advice,
    )


def _estimated(model: Any, ids: list[int], key: str) -> LensShift | None:
    if len(ids) < 3:
        return None
    step = max(1, len(ids) // _IMAGES)
    chosen = ids[::step][:_IMAGES]
    camera = observations(model, chosen[0]).camera.without_distortion()
    sub = _pinhole_model(model, chosen, camera)
    before = _error(sub, chosen)
    if before is None:
        return None
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_principal_point = False
    options.print_summary = False
    options.ceres.solver_options.max_num_iterations = _STEPS
    _adjust(sub, options, extra=False)
    before = _error(sub, chosen)
    _adjust(sub, options, extra=True)
    after = _error(sub, chosen)
    if before is None or after is None or before <= 0:
        return None
    k1, k2 = (float(k) for k in sub.camera(1).params[4:6])
    half = float(np.hypot(camera.width, camera.height)) / 2
    radius = np.linspace(0, half / camera.fx, 50)
    shift = np.abs(radius**3 * (k1 + k2 * radius**2)) * camera.fx / half
    return LensShift(key, float(shift.max()), k1, k2, 1 - after / before)


def _adjust(sub: Any, options: Any, *, extra: bool) -> None:
    options.refine_extra_params = extra
    with quiet_colmap():
        pycolmap.bundle_adjustment(sub, options)


def _pinhole_model(model: Any, ids: list[int], camera: Camera) -> Any:
    """A model of some images, whose pixels are those of the pinhole `camera`."""
    seen: dict[int, tuple[NDArray[np.int64], Array]] = {}
    count: dict[int, int] = {}
    for number in ids:
        image = model.image(number)
        found = observations(model, number)
        rays = found.camera.unproject(found.uv)
        uv = camera.project(rays)
        index = image.get_observation_point2D_idxs()
        points = np.array([int(image.points2D[i].point3D_id) for i in index], dtype=np.int64)
        good = np.isfinite(uv).all(axis=1)
        keep = np.flatnonzero(good)[:: max(1, int(good.sum()) // _POINTS)]
        seen[number] = points[good], uv[good]
        for p in points[keep]:
            count[int(p)] = count.get(int(p), 0) + 1
    sub = pycolmap.Reconstruction()
    sub.add_camera_with_trivial_rig(to_colmap_camera(camera, 1, distorted=True))
    known = {p: sub.add_point3D(model.point3D(p).xyz, pycolmap.Track()) for p in count}
    for number in ids:
        points, uv = seen[number]
        inside = np.array([int(p) in known for p in points], dtype=bool)
        add_image(
            sub,
            image_id=number,
            name=f"{number}",
            camera_id=1,
            T_cam_world=observations(model, number).T_cam_world,
            uv=uv[inside],
            point_ids=np.array([known[int(p)] for p in points[inside]], dtype=np.int64),
        )
    for p in list(known.values()):
        if sub.point3D(p).track.length() < 2:
            sub.delete_point3D(p)
    return sub


def _error(sub: Any, ids: list[int]) -> float | None:
    """Mean reprojection error of all observations, pixels; None if there are too few."""
    errors = [np.linalg.norm(observations(sub, i).residuals, axis=1) for i in ids]
    every = np.concatenate(errors)
    every = every[np.isfinite(every)]
    return float(every.mean()) if len(every) >= LensCheckSettings.current().fewest else None
