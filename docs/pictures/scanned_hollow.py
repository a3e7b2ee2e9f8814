"""Draw docs/pictures/scanned_hollow.jpg: python docs/pictures/scanned_hollow.py WORK.

WORK is the folder of `python perf/scan_labels.py --work WORK`: a photo of mug and bowl, each beside
its mesh from the same camera.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from sensors.simulation.turntable import read_turntable_truth
from std_toolkit.geometry import SE3
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.geometry.ray_caster import RayCaster

NAMES, PHOTO = ("mug_3", "bowl_2"), 29
LIGHT = np.array([0.35, -0.3, 0.88]) / np.linalg.norm([0.35, -0.3, 0.88])
# Rays per pixel along each side, and half the size of a panel.
FINE, HALF = 2, (145, 110)


def panels(work: Path, name: str) -> np.ndarray:
    """Photo and shaded mesh side by side."""
    folder = work / "turntables" / name
    truth = read_turntable_truth(folder)
    camera, pose = truth.camera.camera(), truth.pose(PHOTO)
    mesh = load_mesh(work / "models" / name / f"{name}.obj")
    caster = RayCaster(SE3.from_matrix(truth.T_world_obj) @ mesh.vertices, mesh.faces)
    x, y = ((np.arange(n * FINE) + 0.5) / FINE - 0.5 for n in camera.size)
    uv = np.stack(np.meshgrid(x, y), axis=-1)
    rays = camera.unproject(uv) @ pose.R.T
    hits = caster.cast(np.concatenate([np.broadcast_to(pose.t, rays.shape), rays], axis=-1))
    hit = np.isfinite(hits.distance)
    light = np.clip(0.25 + 0.75 * (hits.normal @ LIGHT), 0, 1)
    shaded = cv2.resize(
        np.where(hit, 50 + 195 * light, 255), camera.size, interpolation=cv2.INTER_AREA
    )
    column, row = (int(v) for v in uv[hit].mean(axis=0))
    part = slice(row - HALF[1], row + HALF[1]), slice(column - HALF[0], column + HALF[0])
    photo = cv2.imread(str(folder / "photos" / truth.photos[PHOTO]))
    assert photo is not None
    return np.hstack([photo[part], cv2.merge([shaded[part].astype(np.uint8)] * 3)])


def main() -> None:
    out = Path(__file__).with_suffix(".jpg")
    picture = np.vstack([panels(Path(sys.argv[1]), name) for name in NAMES])
    cv2.imwrite(str(out), picture, [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    main()
