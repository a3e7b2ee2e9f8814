"""Vessels of glass from unsprayed photos: deviation of the fitted surface of revolution.

    python perf/revolve.py [--folder DIR] [--views N] [--photos] [--only NAME]

Prints for each vessel the median and 95th percentile of the distance from the fitted mesh to the
true one on what cameras can see, with exact outlines and with noise of 1 px, and with outlines
found in the photos by their edges (--photos, which renders them first: about 10 s a photo).
"""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.interpolate import PchipInterpolator

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
