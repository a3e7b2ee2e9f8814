"""Vessels with a known outside and inside, z up, metres."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.vessel.revolved_surface import OutlineView, RevolvedSurface
from tests.std_toolkit.scanning.ball import look_at

Line = list[tuple[float, float]]

# Radius and height in millimetres: a tumbler of 92 mm with a base of 22 mm.
WHISKY: Line = [(0, 1), (30, 0), (33, 2), (36, 10), (39, 50), (41, 92)]
WHISKY_INSIDE: Line = [(38.2, 92), (36, 50), (33, 26), (28, 22), (0, 22)]

# A glass on a stem of 8 mm, of 190 mm; its inside is 108 mm deep.
WINE: Line = [
    (0, 0), (33, 0), (33.5, 1.2), (20, 4), (7, 9), (4, 20), (4, 70), (8, 80), (28, 98), (38, 120),
    (39, 140), (36, 165), (32, 190),
]  # fmt: skip
WINE_INSIDE: Line = [
    (30.8, 190), (34.8, 165), (37.7, 140), (36.7, 120), (26.5, 99.5), (9, 85), (0, 82)
]  # fmt: skip


def smooth(points: Line) -> NDArray[np.float64]:
    """A fine line through the points that does not overshoot, metres."""
    p = np.array(points, float) / 1000
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))]
    return np.asarray(PchipInterpolator(length, p)(np.linspace(0, length[-1], 160)))


def turned(outer: Line, inner: Line) -> trimesh.Trimesh:
    """The watertight vessel of both profiles."""
    line = np.vstack([smooth(outer), smooth(inner)])
    line[[0, -1], 0] = 0
    mesh = trimesh.creation.revolve(line, sections=180)
    mesh.merge_vertices()
    return mesh


def surface_of(outer: Line) -> RevolvedSurface:
    """The outside alone, as a fit without error would find it."""
    line = smooth(outer)
    line = line[np.argmin(np.abs(line[:, 1])) :]
    heights = np.linspace(0, line[-1, 1], 120)
    radii = np.interp(heights, np.maximum.accumulate(line[:, 1]), line[:, 0])
    return RevolvedSurface(
        T_world_axis=SE3.identity(), heights=heights, radii=radii, deviation_m=0 * radii,
        seen=radii > 0, outline_px=0.3, outside=0.0,
    )  # fmt: skip


def outlines(
    mesh: trimesh.Trimesh, camera: Camera, target: NDArray[np.float64], distance: float, count: int
) -> list[OutlineView]:
    """Views with exact masks around a target (3,), by turns from 20 and 50 degrees above it."""
    caster = RayCaster(mesh.vertices, mesh.faces)
    row, column = np.mgrid[: camera.height, : camera.width]
    rays = camera.unproject(np.stack([column, row], axis=-1))
    views = []
    for k in range(count):
        azimuth, elevation = 2 * np.pi * k / count, np.deg2rad((20, 50)[k % 2])
        away = np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ]
        )
        pose = look_at(target + distance * away, target)
        d = rays @ pose.R.T
        hits = caster.cast(np.concatenate([np.broadcast_to(pose.t, d.shape), d], axis=-1))
        views.append(OutlineView(camera, pose, np.isfinite(hits.distance)))
    return views
