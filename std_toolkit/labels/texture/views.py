"""Views of an object whose texture is compared, and those that tell two poses apart.

Whether a texture agrees needs images; where two poses predict different textures does not. Telling
views are found by drawing the mesh, before any image is read.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.geometry import SE3, Camera
from std_toolkit.labels.refine.problem import RefineView, large_views
from std_toolkit.labels.texture.features import agreement, contrast, inner_mask, strength
from std_toolkit.labels.texture.scores import TextureViewSettings
from std_toolkit.rendering.texture import TexturedSurface, TexturePicture
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Frames that show an object large, and those that are searched for telling ones.
FRAMES, _SEARCHED = 6, 32

# Longer side of an object in the pictures that are drawn to find telling views, pixels.
_DRAWN_PX = 56.0

# A view that is compared anyway is preferred to one that tells this much better.
_COMPARED = 1.25


@dataclass(frozen=True, kw_only=True)
class TellingViewSettings(Settings):
    """Views that tell a pose from an alternative by the texture.

    The difference of two drawn pictures is 0 where they are equal or plain, and 1 where strong
    textures have nothing in common.
    """

    each: int = limit(2, source="a side may be hidden in one of them")
    """telling views that are compared for each alternative"""
    telling: float = limit(0.15, source=NOT_RECORDED)
    """smallest difference of a view that tells"""
    of_best: float = limit(0.6, source=NOT_RECORDED)
    """views with this part of the largest difference tell as well"""


@dataclass(frozen=True, eq=False)
class Views:
    """Views whose images are read when they are needed.

    Attributes:
        cameras: undistorted cameras.
        poses: T_world_cam.
        frames: ids of the frames.
        read: the view of an index with its image; None if it cannot be read.
    """

    cameras: Sequence[Camera]
    poses: Sequence[SE3]
    frames: Sequence[int]
    read: Callable[[int], RefineView | None]

    @classmethod
    def of(cls, views: Sequence[RefineView]) -> Views:
        """Views whose images are read already."""
        return cls(
            [v.camera for v in views],
            [v.T_world_cam for v in views],
            [v.frame for v in views],
            views.__getitem__,
        )

    def large(self, centre: Array, radius: float, *, count: int = FRAMES) -> list[int]:
        """Indices of views that show an object large, from directions far apart."""
        return large_views(
            self.cameras,
            self.poses,
            centre,
            radius,
            count=count,
            smallest_px=TextureViewSettings.current().smallest_px,
        )


class Telling:
    """How different the textures are that poses predict in each view.

    Args:
        views: the views.
        surface: the mesh with its colours.
        T_world_obj: the pose.
        radius: of the object, metres.
    """

    def __init__(
        self, views: Views, surface: TexturedSurface, T_world_obj: SE3, radius: float
    ) -> None:
        self._views, self._surface, self._pose = views, surface, T_world_obj
        self._centre = T_world_obj @ surface.centre
        self._radius = radius
        self.searched = views.large(self._centre, radius, count=_SEARCHED)
        self._drawn: dict[int, _Drawn | None] = {}

    def difference(self, k: int, turn: SE3) -> float:
        """0 to 1, of the pictures at the pose and at `pose @ turn` in a view."""
        if k not in self._drawn:
            self._drawn[k] = self._draw(k, self._pose, None)
        mine = self._drawn[k]
        if mine is None:
            return 0.0
        theirs = self._draw(k, self._pose @ turn, mine)
        if theirs is None:
            return 0.0
        both = mine.inner & theirs.inner
        if both.sum() < 60:
            return 0.0
        a, b = mine.picture.color, theirs.picture.color
        level = max(contrast(x, both, _DRAWN_PX) for x in (a, b))
        return float(np.clip(strength(level) * (1 - agreement(a, b, both, _DRAWN_PX)), 0, 1))

    def best(self, turn: SE3, compared: Collection[int] = ()) -> list[int]:
        """Indices of the views that tell the turn best, from directions apart.

        Args:
            compared: views that are compared anyway, and suffice if they tell nearly as well.
        """
        limits = TellingViewSettings.current()
        found = {k: self.difference(k, turn) for k in self.searched}
        ways = {k: self._way(k) for k in found}
        picks: list[int] = []
        while len(picks) < limits.each:
            left = {k: d for k, d in found.items() if d >= limits.telling and k not in picks}
            if not left:
                break
            # Two neighbours show the same; another side is independent of the first.
            gain = {
                k: (_COMPARED if k in compared else 1.0)
                * d
                * min([0.2 + float(np.linalg.norm(ways[k] - ways[p])) for p in picks], default=1.0)
                for k, d in left.items()
            }
            picks.append(max(gain, key=gain.__getitem__))
        return picks

    def frames(self, turn: SE3) -> tuple[int, ...]:
        """Ids of the frames around the most telling one in which the turn differs most."""
        limits = TellingViewSettings.current()
        order = sorted(self.searched, key=lambda k: self._views.frames[k])
        found = [self.difference(k, turn) for k in order]
        if not found or max(found) < limits.telling:
            return ()
        first = last = int(np.argmax(found))
        least = limits.of_best * found[first]
        while first > 0 and found[first - 1] >= least:
            first -= 1
        while last + 1 < len(found) and found[last + 1] >= least:
            last += 1
        return tuple(self._views.frames[k] for k in order[first : last + 1])

    def _way(self, k: int) -> Array:
        """Unit vector from the camera to the object."""
        away = self._centre - self._views.poses[k].t
        return np.asarray(away / max(float(np.linalg.norm(away)), 1e-9))

    def _draw(self, k: int, pose: SE3, like: _Drawn | None) -> _Drawn | None:
        """The picture at a pose, in the window of another picture if one is given."""
        camera, T = self._views.cameras[k], self._views.poses[k].inverse() @ pose
        depth = float((T @ self._surface.centre)[2])
        factor = min(1.0, _DRAWN_PX * depth / max(2 * self._radius * camera.fx, 1e-9))
        size = [max(round(s * factor), 4) for s in camera.size]
        small = camera.resized(*size) if like is None else like.camera
        window = self._surface.window(small, T) if like is None else like.window
        if window is None:
            return None
        picture = self._surface.draw(small, T, window=window)
        if picture is None or not picture.mask.any():
            return None
        inner = inner_mask(picture.mask, picture.normal) & picture.sound
        return _Drawn(small, window, picture, inner)


@dataclass(frozen=True, eq=False)
class _Drawn:
    """A drawn picture, its camera and window, and its pixels away from creases and borders."""

    camera: Camera
    window: tuple[int, int, int, int]
    picture: TexturePicture
    inner: NDArray[np.bool_]


def frame_ranges(frames: Sequence[int]) -> str:
    """Frames in words: "frame 7" or "frames 30 to 38"; "" without any."""
    if not frames:
        return ""
    first, last = min(frames), max(frames)
    return f"frame {first}" if first == last else f"frames {first} to {last}"
