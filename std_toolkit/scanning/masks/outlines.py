"""Candidates in photos: the best photo of each, its outline there, and the pixel to pick it by."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Mask
from std_toolkit.geometry.camera import pixel_rays
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.io.images import write_color
from std_toolkit.scanning.masks.candidates import Candidate
from std_toolkit.scanning.masks.standing import Pick
from std_toolkit.scanning.photos.views import View

# Step in pixels between those of a photo that are compared with the candidates.
_EVERY = 4
# Width and height of the pictures of candidates, and pictures in a row.
_WIDTH, _HEIGHT, _ABREAST = 480, 320, 3
# Surroundings of a candidate in its picture, in its own sizes on each side.
_AROUND = 0.9
_COLOR = (255, 60, 0)


@dataclass(frozen=True, eq=False)
class Shown:
    """A candidate in its best photo.

    Attributes:
        photo: index of the photo.
        pixel: (x, y) on the candidate, far from its outline.
        mask: (H, W) pixels that show it.
    """

    photo: int
    pixel: tuple[float, float]
    mask: Mask

    @property
    def pick(self) -> Pick:
        """Index of the photo and pixel."""
        return self.photo, *self.pixel


def best_photos(candidates: Sequence[Candidate], views: Sequence[View]) -> list[Shown]:
    """Each candidate in the photo that shows most of it, whole and with little before it."""
    together = RayCaster(threads=1)
    for c in candidates:
        together.add(c.vertices, c.faces)
    alone = [RayCaster(c.vertices, c.faces, threads=1) for c in candidates]
    score = np.zeros((len(candidates), len(views)))
    for i, view in enumerate(views):
        rays = _rays(view, _EVERY)
        first = _numbers(together, rays)
        for n, caster in enumerate(alone):
            seen = first == n
            if not seen.any():
                continue
            whole = np.isfinite(caster.cast(rays).distance)
            border = whole[0].any() or whole[-1].any() or whole[:, 0].any() or whole[:, -1].any()
            score[n, i] = seen.sum() * (seen.sum() / whole.sum()) ** 2 * (0.1 if border else 1.0)
    found = []
    for n in range(len(candidates)):
        best = int(score[n].argmax())
        mask = _numbers(together, _rays(views[best], 1)) == n
        padded = cv2.copyMakeBorder(mask.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
        depth = cv2.distanceTransform(padded, cv2.DIST_L2, 5)[1:-1, 1:-1]
        y, x = np.unravel_index(int(depth.argmax()), mask.shape)
        found.append(Shown(best, (float(x), float(y)), mask))
    return found


def _rays(view: View, every: int) -> NDArray[np.float32]:
    """(h, w, 6) origin and direction of every n-th pixel."""
    local = pixel_rays(view.camera)[::every, ::every]
    rays = np.empty((*local.shape[:2], 6), np.float32)
    rays[..., :3] = view.centre
    rays[..., 3:] = local @ view.T_world_cam.R.T
    return rays


def _numbers(caster: RayCaster, rays: NDArray[np.float32]) -> NDArray[np.int64]:
    """Number of the first mesh that each ray meets; -1 for none."""
    hits = caster.cast(rays)
    return np.where(np.isfinite(hits.distance), hits.mesh.astype(np.int64), -1)


def draw_candidates(
    path: Path, shown: Sequence[Shown], views: Sequence[View], words: Sequence[str]
) -> None:
    """Write a picture of all candidates, each outlined in its best photo, with words below it."""
    tiles = [
        candidate_picture(s, views[s.photo], text) for s, text in zip(shown, words, strict=True)
    ]
    abreast = min(_ABREAST, len(tiles))
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % abreast)
    rows = [np.hstack(tiles[k : k + abreast]) for k in range(0, len(tiles), abreast)]
    write_color(path, np.vstack(rows))


def candidate_picture(shown: Shown, view: View, text: str) -> NDArray[np.uint8]:
    """Part of a photo around a candidate with its outline, and a line of text, if any, below it."""
    h, w = shown.mask.shape
    rows, columns = np.flatnonzero(shown.mask.any(axis=1)), np.flatnonzero(shown.mask.any(axis=0))
    middle = np.array([columns[0] + columns[-1], rows[0] + rows[-1]]) / 2
    size = np.array([np.ptp(columns), np.ptp(rows)]) * (1 + 2 * _AROUND)
    # As wide and high as the picture, at least its pixels, at most the photo.
    scale = max(float((size / (_WIDTH, _HEIGHT)).max()), 0.5)
    scale = min(scale, w / _WIDTH, h / _HEIGHT)
    span = np.array([_WIDTH, _HEIGHT]) * scale
    low = np.clip(middle - span / 2, 0, np.array([w, h]) - span)
    to_tile = np.array([[1 / scale, 0, -low[0] / scale], [0, 1 / scale, -low[1] / scale]])
    # Large steps skip pixels: smooth first.
    image = cv2.GaussianBlur(view.image, (0, 0), 0.4 * scale) if scale > 1 else view.image
    tile = cv2.warpAffine(image, to_tile, (_WIDTH, _HEIGHT), flags=cv2.INTER_LINEAR)
    contours, _ = cv2.findContours(
        shown.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    for contour in contours:
        line = np.rint((contour - low) / scale).astype(np.int32)
        cv2.polylines(tile, [line], True, (255, 255, 255), 4, cv2.LINE_AA)
        cv2.polylines(tile, [line], True, _COLOR, 2, cv2.LINE_AA)
    x, y = (np.array(shown.pixel) - low) / scale
    cv2.drawMarker(tile, (round(x), round(y)), _COLOR, cv2.MARKER_CROSS, 14, 2)
    if not text:
        return np.asarray(tile, np.uint8)
    strip = np.full((34, _WIDTH, 3), 255, np.uint8)
    size_of = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.6, 1)[0][0]
    cv2.putText(strip, text, (8, 23), cv2.FONT_HERSHEY_SIMPLEX,
                0.6 * min(1.0, (_WIDTH - 16) / size_of), (0, 0, 0), 1, cv2.LINE_AA)  # fmt: skip
    return np.vstack([tile, strip, np.full((8, _WIDTH, 3), 255, np.uint8)]).astype(np.uint8)
