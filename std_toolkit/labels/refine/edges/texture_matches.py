"""Matches between the texture of a mesh and an image.

The textured mesh is drawn at the current pose, and its features are matched near their predicted
places in the photo. Each matched feature is a point of the mesh with a measured pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera
from std_toolkit.labels.refine import problem
from std_toolkit.labels.refine.caster import WorldCaster
from std_toolkit.labels.refine.edges.measure import PoseState
from std_toolkit.rendering.texture import TexturedSurface
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

# Longer side of the object in the pictures that are matched, pixels.
_LONGEST_PX = 300.0

# Features this near to the silhouette or a seam of the texture are not of the texture.
_INSIDE_PX = 5


@dataclass(frozen=True, kw_only=True)
class TextureMatchSettings(Settings):
    """Which matches with a texture count, and when a texture is followed."""

    smallest_px: float = limit(40.0, unit="px", source=NOT_RECORDED)
    """an object with a smaller longer side is not matched"""
    ratio: float = limit(0.8, source=NOT_RECORDED)
    """the best match must be this much nearer than the second"""
    turn_deg: float = limit(25.0, unit="deg", source="the pose is nearly right")
    """largest difference of the orientations of a match"""
    zoom: float = limit(1.5, source="the pose is nearly right")
    """largest ratio of the sizes of a match"""
    fewest_matches: int = limit(16, source=NOT_RECORDED)
    """matches that a texture needs to count"""
    fewest_views: int = limit(2, source=NOT_RECORDED)
    """views with matches that a texture needs to count"""
    agreed: float = limit(0.4, source="chance gives about the square of `agreed_part`")
    """smallest fraction of the matches that agree with one pose"""
    agreed_part: float = limit(0.35, source=NOT_RECORDED)
    """a match agrees within this part of the reach"""
    rise: float = limit(
        1.0,
        source="on meshes 3 to 6 % too large along one axis the distance grows by up to a half",
    )
    """a texture that lets the distance of the edges grow by a larger part leads off the contour"""
    rise_scattered: float = limit(0.3, source=NOT_RECORDED)
    """the same where the matches scatter more than the edges"""
    scatter: float = limit(1.5, source=NOT_RECORDED)
    """matches scatter more than the edges above this ratio"""
    rise_px: float = limit(0.3, unit="px", source=NOT_RECORDED)
    """the same in pixels; both must be exceeded"""
    fewest_edges: int = limit(20, source=NOT_RECORDED)
    """views with fewer clear edges do not tell"""
    fewest_edge_views: int = limit(3, source="in few views the contour fits at many poses")
    """with fewer such views a texture is followed"""


@dataclass(frozen=True, eq=False)
class Matches:
    """Features of one object in one view.

    Attributes:
        points: (N, 3) on the mesh, mesh frame.
        pixels: (N, 2) where the view shows them, pixels of the full image.
        reach: largest distance from the predicted place that was searched, pixels.
    """

    points: Array
    pixels: Array
    reach: float


def match_texture(
    photos: PhotoFeatures,
    view: int,
    objects: Sequence[problem.RefineObject],
    index: int,
    state: PoseState,
    reach: float,
) -> Matches | None:
    """Match the texture of one object with one view; None if nothing matches.

    Args:
        photos: features of the views.
        view: index of the view.
        objects: all objects, which may hide this one.
        index: index of the object.
        state: current poses.
        reach: in parts of the object's size in the image.
    """
    obj = objects[index]
    surface = obj.texture
    assert surface is not None
    T_world_cam = state.camera_pose(photos.views[view])
    T_cam_obj = T_world_cam.inverse() @ state.poses[index]
    camera = photos.camera(view, surface, T_cam_obj)
    if camera is None:
        return None
    drawn = surface.draw(camera, T_cam_obj)
    if drawn is None or drawn.mask.sum() < 400:
        return None
    size = float(max(drawn.mask.shape))
    picture = drawn.color.copy()
    picture[~drawn.mask] = picture[drawn.mask].mean(axis=0)
    grey = cv2.cvtColor(picture.astype(np.uint8), cv2.COLOR_RGB2GRAY)
    kernel = np.ones((2 * _INSIDE_PX + 1, 2 * _INSIDE_PX + 1), np.uint8)
    padded = np.pad((drawn.mask & drawn.sound).astype(np.uint8), _INSIDE_PX)
    inside = cv2.erode(padded, kernel)[_INSIDE_PX:-_INSIDE_PX, _INSIDE_PX:-_INSIDE_PX]
    model = _features(grey, inside, (drawn.x, drawn.y))
    photo = photos.around(view, camera, (drawn.x, drawn.y, *drawn.mask.shape[::-1]), reach * size)
    if model is None or photo is None:
        return None
    pairs = _pairs(model, photo, reach * size)
    if not len(pairs):
        return None
    uv = model.place[pairs[:, 0]]
    points = surface.points(camera, T_cam_obj, uv)
    seen = np.isfinite(points).all(axis=1)
    others = [k for k in range(len(objects)) if k != index]
    if others:
        caster = WorldCaster(objects, state.poses)
        hidden = caster.cast(camera, T_world_cam, uv, among=others).depth
        seen &= ~(hidden < (T_cam_obj @ np.nan_to_num(points))[:, 2])
    full = photos.views[view].camera
    scale = np.array(full.size) / np.array(camera.size)
    pixels = (photo.place[pairs[:, 1]] + 0.5) * scale - 0.5
    if not seen.any():
        return None
    return Matches(points[seen], pixels[seen], float(reach * size * scale.max()))


@dataclass(frozen=True, eq=False)
class Features:
    """SIFT features of a picture.

    Attributes:
        place: (N, 2) pixels of the image.
        angle: (N,) degrees.
        size: (N,) pixels.
        descriptor: (N, 128) float32.
    """

    place: Array
    angle: Array
    size: Array
    descriptor: NDArray[np.float32]


class PhotoFeatures:
    """Features of the views around objects, computed once for all rounds.

    Args:
        views: the views.

    Attributes:
        views: the views.
    """

    def __init__(self, views: Sequence[problem.RefineView]) -> None:
        self.views = list(views)
        self._images: dict[tuple[int, tuple[int, int]], NDArray[np.uint8]] = {}

    def camera(self, view: int, surface: TexturedSurface, T_cam_obj: SE3) -> Camera | None:
        """The view's camera at the scale at which an object is matched; None if it is too small."""
        full = self.views[view].camera
        box = surface.window(full, T_cam_obj)
        if box is None:
            return None
        size = max(box[2] - box[0], box[3] - box[1])
        if size < TextureMatchSettings.current().smallest_px:
            return None
        factor = min(1.0, _LONGEST_PX / size)
        # Steps of a tenth, so that the next round finds the same scale.
        factor = float(np.exp(np.round(np.log(factor) * 10) / 10))
        if factor >= 1:
            return full
        return full.resized(*(max(round(s * factor), 1) for s in full.size))

    def around(
        self, view: int, camera: Camera, box: tuple[int, int, int, int], reach: float
    ) -> Features | None:
        """Features within a box x, y, width, height widened by the reach."""
        key = view, camera.size
        if key not in self._images:
            color = self.views[view].color
            if camera.size != self.views[view].camera.size:
                color = np.asarray(
                    cv2.resize(color, camera.size, interpolation=cv2.INTER_AREA), dtype=np.uint8
                )
            self._images[key] = np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        grey = self._images[key]
        margin = int(np.ceil(reach)) + 8
        x0, y0 = max(box[0] - margin, 0), max(box[1] - margin, 0)
        part = grey[y0 : box[1] + box[3] + margin, x0 : box[0] + box[2] + margin]
        return _features(part, None, (x0, y0))


def _features(
    grey: NDArray[Any], mask: NDArray[Any] | None, origin: tuple[int, int]
) -> Features | None:
    sift = cv2.SIFT_create(contrastThreshold=0.02)  # type: ignore[attr-defined]
    points, descriptors = sift.detectAndCompute(grey, mask)
    if descriptors is None or not len(points):
        return None
    # Square roots of normalised histograms compare better than the histograms.
    d = descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6)
    return Features(
        np.array([p.pt for p in points]) + np.array(origin),
        np.array([p.angle for p in points]),
        np.array([p.size for p in points]),
        np.sqrt(d).astype(np.float32),
    )


def _pairs(model: Features, photo: Features, reach: float) -> NDArray[np.intp]:
    """(N, 2) indices of mutual best matches near their predicted places."""
    limits = TextureMatchSettings.current()
    apart = np.linalg.norm(model.place[:, None] - photo.place[None], axis=2)
    turn = np.abs((model.angle[:, None] - photo.angle[None] + 180) % 360 - 180)
    zoom = np.abs(np.log(model.size[:, None] / photo.size[None]))
    unlike = 2 - 2 * (model.descriptor @ photo.descriptor.T)
    near = (apart <= reach) & (turn <= limits.turn_deg) & (zoom <= np.log(limits.zoom))
    cost = np.where(near, unlike, np.inf)
    best = cost.argmin(axis=1)
    rows = np.arange(len(cost))
    lowest = cost[rows, best]
    # The same corner found twice is no second candidate.
    same = np.linalg.norm(photo.place[best][:, None] - photo.place[None], axis=2) < 3.0
    rest = np.where((apart <= reach) & ~same, unlike, np.inf).min(axis=1)
    mutual = cost.argmin(axis=0)[best] == rows
    good = np.isfinite(lowest) & mutual & (lowest < limits.ratio**2 * rest) & (lowest < 0.6)
    return np.stack([rows[good], best[good]], axis=1)
