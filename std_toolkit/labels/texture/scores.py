"""How well the texture agrees with one image at a pose, and at its alternatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera
from std_toolkit.labels.refine.caster import WorldCaster
from std_toolkit.labels.refine.problem import RefineObject, RefineView
from std_toolkit.labels.texture.features import (
    agreement,
    aligned,
    clarity,
    contrast,
    inner_mask,
    strength,
)
from std_toolkit.rendering.texture import TexturedSurface, TexturePicture
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# The object's longer side in the pictures that are compared, pixels; a smaller one is not enlarged.
_LONGEST_PX = 144.0


@dataclass(frozen=True, kw_only=True)
class TextureViewSettings(Settings):
    """Views in which a texture is compared."""

    smallest_px: float = limit(40.0, unit="px", source=NOT_RECORDED)
    """an object with a smaller longer side is not compared"""
    largest_motion: float = limit(0.08, source=NOT_RECORDED)
    """largest correction by the alignment, in parts of the object's longer side"""
    visible: float = limit(0.4, source=NOT_RECORDED)
    """with a smaller part of its pixels in view, an object is not compared"""
    in_front_m: float = limit(0.03, unit="m", source=NOT_RECORDED)
    """sensor depth that is nearer by more shows something else"""


@dataclass(frozen=True, eq=False)
class TextureWindow:
    """The part of one image that shows an object, at the scale of the comparison.

    Attributes:
        camera: intrinsics of the image at that scale.
        box: x0, y0, x1, y1 (x1, y1 exclusive) of the window.
        T_cam_world: pose of the world in the camera.
        color: (h, w, 3) float32 RGB.
        hidden: (h, w) float32 z-depth of other objects, inf without one.
        size: longer side of the object, pixels.
    """

    camera: Camera
    box: tuple[int, int, int, int]
    T_cam_world: SE3
    color: NDArray[np.float32]
    hidden: NDArray[np.float32]
    size: float

    def shrunk(self, size: float) -> TextureWindow:
        """The window at a smaller scale, with about this size of the object."""
        factor = size / self.size
        if factor >= 1:
            return self
        w, h = (max(round(s * factor), 1) for s in self.camera.size)
        camera = self.camera.resized(w, h)
        x0, y0, x1, y1 = (round(b * factor) for b in self.box)
        x1, y1 = max(x1, x0 + 4), max(y1, y0 + 4)
        # The window starts at a whole pixel of the smaller image.
        move = np.array([[1 / factor, 0, 0], [0, 1 / factor, 0]])
        move[:, 2] = (np.array([x0, y0]) + 0.5) / factor - 0.5 - np.array(self.box[:2])
        blurred = cv2.GaussianBlur(self.color, (0, 0), 0.5 / factor)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        shape = (x1 - x0, y1 - y0)
        color = cv2.warpAffine(blurred, move, shape, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        finite = np.minimum(self.hidden, np.float32(1e6))
        hidden = cv2.warpAffine(
            finite,
            move,
            shape,
            flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )
        return TextureWindow(
            camera,
            (x0, y0, x1, y1),
            self.T_cam_world,
            np.asarray(color, dtype=np.float32),
            np.asarray(hidden, dtype=np.float32),
            size,
        )


@dataclass(frozen=True)
class TextureScore:
    """Agreement of a texture with one image.

    Attributes:
        value: correlation, -1 to 1.
        clarity: 0 to 1, whether the surface in view has a texture at all.
        strength: 0 to 1, how strong the texture in view is.
        visible: fraction of the pixels of the object that are in view.
        covered: fraction of its pixels that were compared: in view and away from creases.
    """

    value: float
    clarity: float
    strength: float
    visible: float
    covered: float


def cut_window(
    view: RefineView,
    surface: TexturedSurface,
    T_world_obj: SE3,
    others: Sequence[RefineObject],
) -> TextureWindow | None:
    """The part of a view around an object; None if it is out of view or too small.

    Args:
        others: objects that may hide it.
    """
    limits = TextureViewSettings.current()
    T_cam_world = view.T_world_cam.inverse()
    box = surface.window(view.camera, T_cam_world @ T_world_obj)
    if box is None:
        return None
    size = float(max(box[2] - box[0], box[3] - box[1]))
    if size < limits.smallest_px:
        return None
    camera, image = view.at_scale(min(1.0, _LONGEST_PX / size))
    x0, y0, x1, y1 = surface.window(camera, T_cam_world @ T_world_obj) or (0, 0, 0, 0)
    size = float(max(x1 - x0, y1 - y0))
    margin = round(0.1 * size)
    x0, y0 = max(x0 - margin, 0), max(y0 - margin, 0)
    x1, y1 = min(x1 + margin, camera.width), min(y1 + margin, camera.height)
    if x1 - x0 < 4 or y1 - y0 < 4:
        return None
    hidden = np.full((y1 - y0, x1 - x0), np.inf, np.float32)
    if others:
        caster = WorldCaster(others, [o.T_world_obj for o in others])
        v, u = np.mgrid[y0:y1, x0:x1].astype(np.float32)
        hidden = caster.cast(camera, view.T_world_cam, np.stack([u, v], axis=-1)).depth
    if view.depth is not None:
        sensor = cv2.resize(view.depth, camera.size, interpolation=cv2.INTER_NEAREST)[y0:y1, x0:x1]
        hidden = np.minimum(hidden, np.where(sensor > 0, sensor + limits.in_front_m, np.inf))
    return TextureWindow(
        camera,
        (x0, y0, x1, y1),
        T_cam_world,
        image[y0:y1, x0:x1].astype(np.float32),
        hidden.astype(np.float32),
        size,
    )


def score_view(
    window: TextureWindow, surface: TexturedSurface, T_world_obj: SE3
) -> TextureScore | None:
    """Score of one pose in one window, offsets of a few pixels corrected; None if too little of
    the object is in view.
    """
    found = _shown(window, surface, T_world_obj)
    if found is None:
        return None
    drawn, inner, visible = found
    level = contrast(drawn.color, inner, window.size)
    value = _aligned_agreement(drawn.color, window, inner)
    covered = float(inner.sum() / drawn.mask.sum())
    return TextureScore(value, clarity(level), strength(level), visible, covered)


def chance_scores(
    window: TextureWindow, surface: TexturedSurface, T_world_obj: SE3, *, count: int
) -> list[float]:
    """Scores of random textures with the spectrum of the drawn one; none if it is not in view.

    Their phases are random: size and strength of the patches stay, and what they show is lost.

    Args:
        count: number of textures.
    """
    found = _shown(window, surface, T_world_obj)
    if found is None:
        return []
    drawn, inner, _ = found
    random = np.random.default_rng(0)
    return [
        _aligned_agreement(_scrambled(drawn.color, inner, random), window, inner)
        for _ in range(count)
    ]


def _shown(
    window: TextureWindow, surface: TexturedSurface, T_world_obj: SE3
) -> tuple[TexturePicture, NDArray[np.bool_], float] | None:
    """The drawn mesh, its pixels to compare, and the fraction in view; None if that is little."""
    limits = TextureViewSettings.current()
    drawn = surface.draw(window.camera, window.T_cam_world @ T_world_obj, window=window.box)
    if drawn is None or not drawn.mask.any():
        return None
    shown = drawn.mask & (drawn.depth < window.hidden)
    visible = float(shown.sum() / drawn.mask.sum())
    inner = inner_mask(shown, drawn.normal) & drawn.sound
    if visible < limits.visible or inner.sum() < 100:
        return None
    return drawn, inner, visible


def _aligned_agreement(
    color: NDArray[np.float32], window: TextureWindow, inner: NDArray[np.bool_]
) -> float:
    """Agreement of a drawn picture with the image, moved to where it fits best."""
    limit_px = max(3.0, TextureViewSettings.current().largest_motion * window.size)
    taken = aligned(color, window.color, inner, limit_px=limit_px)
    return agreement(color, taken, inner, window.size)


def _scrambled(
    color: NDArray[np.float32], mask: NDArray[np.bool_], random: np.random.Generator
) -> NDArray[np.float32]:
    """A picture with the amplitudes of `color` within the mask, and random phases."""
    mean = color[mask].mean(axis=0)
    centred = np.where(mask[..., None], color - mean, 0)
    # The phases of a real picture keep the result real.
    phase = np.exp(1j * np.angle(np.fft.fft2(random.normal(size=mask.shape))))
    mixed = np.fft.ifft2(np.fft.fft2(centred, axes=(0, 1)) * phase[..., None], axes=(0, 1)).real
    gain = centred[mask].std() / max(float(mixed[mask].std()), 1e-6)
    return np.asarray(mixed * gain + mean, dtype=np.float32)
