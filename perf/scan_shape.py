"""Figures of the shape of a scan against the truth: flat faces and the oriented box."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from std_toolkit.geometry.plane_fit import find_planes

_SAMPLES = 40_000
# Half of the width of a slab of the truth that counts as flat, metres, and how far its normals
# turn, degrees. Strips of cans are narrower than the least share of the surface.
_FLAT_M, _TURN_DEG, _LEAST = 1.5e-4, 12.0, 0.06


def flat_faces(truth: Any) -> tuple[np.ndarray, list[np.ndarray]]:
    """Points (N, 3) on a mesh, and the indices of those of each flat face."""
    points, face = trimesh.sample.sample_surface(truth, _SAMPLES, seed=0)
    normals, points = truth.face_normals[face], np.asarray(points)
    size = len(points)
    planes = find_planes(
        points, np.full(size, _FLAT_M), np.ones(size), count=8, smallest_weight=_LEAST
    )
    turned = np.cos(np.deg2rad(_TURN_DEG))
    found = [p.inliers & (np.abs(normals @ p.normal) > turned) for p in planes]
    return points, [np.flatnonzero(f) for f in found if f.mean() > _LEAST]


def flatness(scan: np.ndarray, truth: Any) -> float:
    """RMS distance in millimetres of the points (N, 3) of a scan from a plane of their own, worst
    of the flat faces of the truth; NaN for none."""
    points, faces = flat_faces(truth)
    away, nearest = cKDTree(points).query(scan)
    worst = float("nan")
    for one in faces:
        own = scan[np.isin(nearest, one) & (away < 0.01)]
        if len(own) < 100:
            continue
        off = own - own.mean(axis=0)
        normal = np.linalg.svd(off, full_matrices=False)[2][-1]
        worst = np.fmax(worst, 1000 * np.sqrt(np.mean((off @ normal) ** 2)))
    return float(worst)


def larger_box(scan: Any, truth: Any) -> float:
    """By how much the smallest box around a scan, in any orientation, is larger than that of the
    truth, millimetres: the longest difference of its sides."""
    sides = [np.sort(trimesh.bounds.oriented_bounds(mesh)[1]) for mesh in (scan, truth)]
    difference = 1000 * (sides[0] - sides[1])
    return float(difference[np.abs(difference).argmax()])
