"""Vessels of glass from unsprayed photos: deviation of the fitted surface of revolution.

    python perf/revolve.py [--folder DIR] [--views N] [--size W H] [--photos | --scan]
        [--only NAME ...]

Prints for each vessel the median and 95th percentile of the distance from the fitted mesh to the
true one, on what cameras can see, with exact outlines and with outlines that wander by 1 px. With
`--photos`, `std-sim turntable` photographs the vessels (glass, refraction, no spray) and the wall
comes from the rim in the photos; without it, the wall is a guess. With `--scan`, poses and masks
are not given: `std-scan --revolve` finds them in the photos.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import trimesh
from scipy.interpolate import PchipInterpolator

from sensors.simulation.options import TurntableOptions
from sensors.simulation.turntable import make_turntable, read_turntable_truth, write_truth
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.io.images import read_color
from std_toolkit.scanning.vessel.inside import StatedInside, with_inside
from std_toolkit.scanning.vessel.revolve import fit_revolution
from std_toolkit.scanning.vessel.revolved_surface import OutlineView

# Outer and inner profiles, (radius, height) in millimetres, bottom first; a thousandth of a
# millimetre on the axis closes the surface.
VESSELS: dict[str, tuple[list[tuple[float, float]], list[tuple[float, float]]]] = {
    "tumbler": (
        [(0, 0), (27, 0), (28.5, 1.5), (31, 40), (34, 95)],
        [(32.5, 95), (29.5, 40), (27, 12), (24, 9), (0, 8)],
    ),
    "wine_glass": (
        [
            (0, 0),
            (33, 0),
            (33.5, 1.2),
            (20, 4),
            (7, 9),
            (4, 20),
            (4, 70),
            (8, 80),
            (28, 98),
            (38, 120),
            (39, 140),
            (36, 165),
            (32, 190),
        ],
        [(30.8, 190), (34.8, 165), (37.7, 140), (36.7, 120), (26.5, 99.5), (9, 85), (0, 82)],
    ),
    "bottle": (
        [
            (0, 3),
            (24, 2),
            (30, 0),
            (36, 2),
            (37, 8),
            (37, 120),
            (33, 145),
            (18, 175),
            (14, 190),
            (13.5, 230),
            (15.5, 232),
            (15.5, 245),
            (14.5, 247),
        ],
        [
            (10, 247),
            (9.5, 230),
            (10, 190),
            (14, 174),
            (29, 144),
            (34, 120),
            (34, 10),
            (30, 5),
            (0, 7),
        ],
    ),
    "bowl": (
        [(0, 1), (22, 0), (30, 0), (31, 4), (50, 18), (66, 38), (74, 62)],
        [(71.5, 62), (63, 39), (47, 20.5), (28, 8), (0, 6)],
    ),
    "vase": (
        [
            (0, 0),
            (28, 0),
            (31, 3),
            (40, 30),
            (44, 60),
            (40, 95),
            (28, 130),
            (24, 150),
            (28, 170),
            (36, 182),
        ],
        [
            (33.5, 182),
            (25.5, 170),
            (21.5, 150),
            (25.5, 129),
            (37.5, 94),
            (41.5, 60),
            (37.5, 30),
            (27, 9),
            (0, 7),
        ],
    ),
    "jar": (
        [(0, 2), (30, 0), (38, 0), (42, 4), (42, 90), (38, 102), (34, 108), (34, 125), (35, 127)],
        [(32, 127), (31, 108), (35, 100), (39, 89), (39, 8), (34, 5), (0, 5)],
    ),
}
SECTIONS = 180


def smooth(profile: list[tuple[float, float]]) -> np.ndarray:
    """A fine line through the points that does not overshoot, metres."""
    points = np.asarray(profile, float) / 1000
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return np.asarray(PchipInterpolator(length, points)(np.linspace(0, length[-1], 160)))


def vessel_mesh(name: str) -> trimesh.Trimesh:
    """A watertight vessel, z up, metres."""
    outer, inner = (smooth(p) for p in VESSELS[name])
    line = np.vstack([outer, inner])
    line[[0, -1], 0] = 0
    mesh = trimesh.creation.revolve(line, sections=SECTIONS)
    mesh.merge_vertices()
    return mesh


def seen_from(camera: Camera, pose: SE3, caster: RayCaster, step: int) -> tuple[np.ndarray, ...]:
    """Rays (h, w, 6) of every `step`-th pixel and their hits (h, w), metres."""
    row, column = np.mgrid[: camera.height : step, : camera.width : step]
    d = camera.unproject(np.stack([column, row], axis=-1)) @ pose.R.T
    rays = np.concatenate([np.broadcast_to(pose.t, d.shape), d], axis=-1)
    return rays, caster.cast(rays).distance


def wandering(mask: np.ndarray, rng: np.random.Generator, px: float) -> np.ndarray:
    """The mask with its outline moved by a smooth random field of this standard deviation."""
    if not px:
        return mask
    inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    outside = cv2.distanceTransform(1 - mask.astype(np.uint8), cv2.DIST_L2, 5)
    field = cv2.GaussianBlur(rng.normal(size=mask.shape).astype(np.float32), (0, 0), 4)
    return np.asarray(inside - outside + px * field / field.std() > 0)


def apart_mm(
    vertices: np.ndarray, faces: np.ndarray, poses: list[SE3], camera: Camera, true: RayCaster
) -> tuple[np.ndarray, str]:
    """Distances of what cameras see of a mesh from the true one, and whether it is closed."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    caster = RayCaster(vertices, faces)
    points = []
    for pose in poses:
        rays, distance = seen_from(camera, pose, caster, 7)
        hit = np.isfinite(distance)
        points.append(rays[hit][:, :3] + rays[hit][:, 3:] * distance[hit][:, None])
    closed = "closed" if mesh.is_watertight else "NOT CLOSED"
    return 1000 * true.distance(np.concatenate(points)), closed


def scanned(
    name: str, photos: Path, out: Path, poses: list[SE3], camera: Camera, true: RayCaster
) -> None:
    """Print the figures of a scan without given poses and masks; its cameras are aligned."""
    from std_toolkit.geometry import umeyama
    from std_toolkit.scanning.options import ScanOptions
    from std_toolkit.scanning.scan_step import scan

    start = time.process_time()
    done = scan(
        ScanOptions(
            photos=photos / "photos", board=photos / "board.json", out=out, revolve=True,
            texture=512,
        )
    )  # fmt: skip
    seconds = time.process_time() - start
    true_centres = np.stack([poses[int(Path(v.name).stem)].t for v in done.views])
    T = umeyama(np.stack([v.centre for v in done.views]), true_centres, with_scale=False)
    fitted = done.vertices @ T.matrix()[:3, :3].T + T.matrix()[:3, 3]
    apart, closed = apart_mm(fitted, done.faces, poses, camera, true)
    print(
        f"{name:12s} scan     median {np.median(apart):.3f}  p95 {np.percentile(apart, 95):.2f} mm"
        f"  outline {done.facts['outline residual']}  wall {done.facts['wall']}  {closed}"
        f"  height {1000 * np.ptp(fitted[:, 2]):.1f} mm  {seconds:.0f} s",
        flush=True,
    )


def measure(
    name: str, folder: Path, views: int, size: tuple[int, int], *, photos: bool, whole: bool
) -> None:
    """Print the figures of one vessel."""
    file = folder / f"{name}.ply"
    if not file.exists():
        vessel_mesh(name).export(file)
    options = TurntableOptions(
        mesh=file, out=folder / f"{name}_{views}", material="glass", views=views,
        width=size[0], height=size[1],
    )  # fmt: skip
    (make_turntable if photos or whole else write_truth)(options)
    truth = read_turntable_truth(options.out)
    mesh = load_mesh(options.out / "truth/mesh.ply")
    vertices = SE3.from_matrix(truth.T_world_obj) @ np.asarray(mesh.vertices)
    true = RayCaster(vertices, mesh.faces)
    camera = truth.camera.camera()
    poses = [truth.pose(i) for i in range(views)]
    if whole:
        scanned(name, options.out, folder / f"{name}_scan", poses, camera, true)
        return
    masks = [np.isfinite(seen_from(camera, p, true, 1)[1]) for p in poses]
    images = [read_color(options.out / "photos" / n) if photos else None for n in truth.photos]
    for px in (0.0, 1.0):
        rng = np.random.default_rng(1)
        given = [
            OutlineView(camera, pose, wandering(mask, rng, px), image)
            for pose, mask, image in zip(poses, masks, images, strict=True)
        ]
        start = time.process_time()
        found = with_inside(fit_revolution(given), given, StatedInside())
        seconds = time.process_time() - start
        fitted, faces = found.mesh()
        apart, closed = apart_mm(fitted, faces, poses, camera, true)
        print(
            f"{name:12s} {px:4.1f} px  median {np.median(apart):.3f}  p95 "
            f"{np.percentile(apart, 95):.2f} mm  outline {found.outline_px:.2f} px"
            f"  wall {found.facts['wall']}  {closed}  {seconds:.0f} s",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 720))
    parser.add_argument("--photos", action="store_true")
    parser.add_argument("--scan", action="store_true")
    parser.add_argument("--only", nargs="*", default=list(VESSELS))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for name in options.only:
            measure(
                name, folder, options.views, tuple(options.size), photos=options.photos,
                whole=options.scan,
            )  # fmt: skip


if __name__ == "__main__":
    main()
