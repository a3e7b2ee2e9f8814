"""Plane fits in noisy points with clutter: RANSAC, then robust least squares.

The module works on arrays; `plane.py` interprets the planes of a scene.
"""

from dataclasses import dataclass

import numpy as np

from std_toolkit.arrays import Array, Mask

_HYPOTHESES = 1200
_VOTERS = 4000
# An inlier is within this many standard deviations.
_CUT = 2.5
_MOST_CELLS = 2000


@dataclass(frozen=True, eq=False)
class PlaneFit:
    """A plane `normal . p + offset = 0` in points.

    Attributes:
        normal: (3,) unit vector; its sign is arbitrary.
        offset: metres.
        inliers: (N,) whether each point is in the plane.
        weight: sum of the inliers' weights over that of all points.
        rms_m: RMS of the inliers' distances.
    """

    normal: Array
    offset: float
    inliers: Mask
    weight: float
    rms_m: float


def find_planes(
    points: Array,
    sigma: Array,
    weights: Array,
    *,
    count: int,
    smallest_weight: float = 0.04,
    seed: int = 0,
) -> list[PlaneFit]:
    """The heaviest planes in points, heaviest first; each point belongs to one at most.

    Args:
        points: (N, 3) metres.
        sigma: (N,) standard deviation of each point across a plane, metres.
        weights: (N,) weight of each point in the consensus.
        count: largest number of planes.
        smallest_weight: fraction of the total weight below which a plane is rejected.
    """
    rng = np.random.default_rng(seed)
    left = np.arange(len(points))
    total = float(weights.sum())
    found: list[PlaneFit] = []
    while len(found) < count and len(left) >= 12 and total > 0:
        start = _vote(points[left], sigma[left], weights[left], rng)
        if start is None:
            break
        normal, offset = refine_plane(points[left], sigma[left], weights[left], *start)
        distance = points[left] @ normal + offset
        inside = np.abs(distance) <= _CUT * sigma[left]
        share = float(weights[left[inside]].sum()) / total
        if share < smallest_weight or inside.sum() < 12:
            break
        inliers = np.zeros(len(points), dtype=bool)
        inliers[left[inside]] = True
        rms = float(np.sqrt(np.mean(distance[inside] ** 2)))
        found.append(PlaneFit(normal, offset, inliers, share, rms))
        # Noise around this plane could otherwise form a second one.
        left = left[np.abs(distance) > 2 * _CUT * sigma[left]]
    return sorted(found, key=lambda f: -f.weight)


def connected_patch(
    points: Array, weights: Array, fit: PlaneFit, sigma: Array, *, cell_m: float
) -> PlaneFit:
    """The heaviest connected part of a plane, fitted by itself.

    A plane extends through all surfaces at the height of a table; the table is one connected part.

    Args:
        cell_m: gaps up to about this size do not split it.
    """
    import cv2

    side = np.cross(fit.normal, np.eye(3)[int(np.abs(fit.normal).argmin())])
    side /= np.linalg.norm(side)
    inside = np.flatnonzero(fit.inliers)
    flat = points[inside] @ np.stack([side, np.cross(fit.normal, side)], axis=1)
    # Limit the grid size despite a few far points.
    cell = np.floor((flat - np.median(flat, axis=0)) / cell_m).astype(int)
    cell = np.clip(cell, -_MOST_CELLS // 2, _MOST_CELLS // 2)
    cell -= cell.min(axis=0)
    weight = np.zeros(cell.max(axis=0) + 1)
    np.add.at(weight, (cell[:, 0], cell[:, 1]), weights[inside])
    occupied = np.asarray(weight > 0, dtype=np.uint8)
    _, label = cv2.connectedComponents(occupied, connectivity=8)
    of_label = np.bincount(label[occupied > 0], weight[occupied > 0])
    patch = inside[label[cell[:, 0], cell[:, 1]] == int(of_label.argmax())]
    normal, offset = refine_plane(
        points[patch], sigma[patch], weights[patch], fit.normal, fit.offset
    )
    distance = points[patch] @ normal + offset
    inliers = np.zeros(len(points), dtype=bool)
    inliers[patch[np.abs(distance) <= _CUT * sigma[patch]]] = True
    rms = float(np.sqrt(np.mean((points[inliers] @ normal + offset) ** 2)))
    share = float(weights[inliers].sum() / weights.sum())
    return PlaneFit(normal, offset, inliers, share, rms)


def refine_plane(
    points: Array, sigma: Array, weights: Array, normal: Array, offset: float, *, rounds: int = 12
) -> tuple[Array, float]:
    """Weighted least squares from a start, robust by Tukey's biweight (5 sigma)."""
    for _ in range(rounds):
        r = (points @ normal + offset) / (2 * _CUT * sigma)
        w = np.where(np.abs(r) < 1, (1 - r**2) ** 2, 0.0) * weights / sigma**2
        if w.sum() <= 0 or np.count_nonzero(w) < 3:
            break
        middle = np.average(points, axis=0, weights=w)
        centred = points - middle
        scatter = (centred * w[:, None]).T @ centred
        fresh = np.linalg.eigh(scatter)[1][:, 0]
        fresh = fresh if fresh @ normal >= 0 else -fresh
        done = np.linalg.norm(fresh - normal) < 1e-9
        normal, offset = fresh, -float(fresh @ middle)
        if done:
            break
    return normal, offset


def _vote(
    points: Array, sigma: Array, weights: Array, rng: np.random.Generator
) -> tuple[Array, float] | None:
    """The best of many planes through three points, by the weight of its inliers."""
    p = weights / weights.sum()
    corners = points[rng.choice(len(points), size=(_HYPOTHESES, 3), p=p)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    # Three points close together or on a line determine no plane.
    reach = np.linalg.norm(corners[:, 1:] - corners[:, :1], axis=2).max(axis=1)
    usable = (length > 0.1 * reach**2) & (length > 0)
    if not usable.any():
        return None
    normals = normals[usable] / length[usable, None]
    offsets = -np.einsum("ij,ij->i", normals, corners[usable, 0])
    voters = rng.choice(len(points), size=min(_VOTERS, len(points)), replace=False)
    votes = np.zeros(len(normals))
    for part in np.array_split(np.arange(len(normals)), max(1, len(normals) // 64)):
        distance = points[voters] @ normals[part].T + offsets[part]
        inside = np.abs(distance) <= _CUT * sigma[voters, None]
        votes[part] = weights[voters] @ inside
    best = int(votes.argmax())
    return normals[best], float(offsets[best])
