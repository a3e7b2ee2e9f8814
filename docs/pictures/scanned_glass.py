"""Draw docs/pictures/scanned_glass.jpg: python docs/pictures/scanned_glass.py TURNTABLE.

TURNTABLE is a folder of `std-sim turntable --material glass`. Left a photo, right the surface of
revolution that was found in all of them, with its outline in the photo.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from sensors.simulation.turntable import read_turntable_truth
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.io.images import read_color, write_color
from std_toolkit.poses.board_scale import Board
from std_toolkit.scanning.photos.views import View
from std_toolkit.scanning.vessel.glass_outlines import find_vessel

SHOWN, MARGIN = 3, 50


def main(folder: Path) -> None:
    """Photo, and the mesh before the same photo."""
    truth = read_turntable_truth(folder)
    camera = truth.camera.camera()
    views = [
        View(name, read_color(folder / "photos" / name), camera, truth.pose(i))
        for i, name in enumerate(truth.photos)
    ]
    tags = Board.read(folder / "board.json").tags
    corners = np.array([corners for _, corners in tags], float).reshape(-1, 3)
    found, masked = find_vessel(views, corners, threads=1)
    vertices, faces = found.mesh()
    view = masked[SHOWN]
    row, column = np.mgrid[: camera.height, : camera.width]
    rays = camera.unproject(np.stack([column, row], axis=-1).astype(float)) @ view.T_world_cam.R.T
    start = np.broadcast_to(view.centre, rays.shape)
    distance = RayCaster(vertices, faces).cast(np.concatenate([start, rays], axis=-1)).distance
    points = start + rays * np.where(np.isfinite(distance), distance, 0)[..., None]
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    light = np.abs((normal * rays / np.linalg.norm(rays, axis=-1, keepdims=True)).sum(axis=-1))
    grey = (60 + 180 * light)[..., None] * np.array([0.85, 0.93, 1.0])
    drawn = np.where(np.isfinite(distance)[..., None], grey, view.image).astype(np.uint8)
    lines, _ = cv2.findContours(
        view.shown.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    cv2.drawContours(drawn, lines, -1, (255, 120, 0), 1, cv2.LINE_AA)
    rows, columns = np.nonzero(view.shown)
    y0, x0 = max(rows.min() - MARGIN, 0), max(columns.min() - 2 * MARGIN, 0)
    window = np.s_[y0 : rows.max() + MARGIN, x0 : columns.max() + 2 * MARGIN]
    both = np.hstack([view.image[window], drawn[window]])
    both = cv2.resize(both, None, fx=1.5, fy=1.5, interpolation=cv2.INTER_CUBIC)
    write_color(Path(__file__).with_suffix(".jpg"), np.asarray(both, np.uint8))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
