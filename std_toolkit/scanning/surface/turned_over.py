"""Motion between two positions of an object, such as upright and turned over.

SIFT features on the object have places in metres by the depth maps, so pairs of them give the
motion by RANSAC, which the measured surfaces refine. Where too few agree, the hulls of both
positions tell which of many turns is right.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from std_toolkit.arrays import Array, Mask
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, ransac_similarity, rotation_angle
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.geometry.se3 import skew
from std_toolkit.poses.features import match_descriptors
from std_toolkit.scanning.masks.masks import eroded
from std_toolkit.scanning.photos.views import View
from std_toolkit.scanning.surface.depth_maps import DepthMap
from std_toolkit.scanning.surface.hull_coherence import HullCoherence
from std_toolkit.scanning.surface.measured_surface import Side, Surface
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Features of a photo that are matched.
_FEATURES = 600
# Turns that are looked at without texture, and the best of them that are fitted to the outlines.
_TURNS, _FITTED = 1500, 12


@dataclass(frozen=True, kw_only=True)
class TurnSettings(Settings):
    """Which motion joins two positions of an object."""

    agreement: float = limit(0.012, source=NOT_RECORDED)
    """largest distance of features that agree, and of surfaces that touch, as a share of the
    longest side"""
    fewest_places: int = limit(12, source=NOT_RECORDED)
    """places on the object that a motion by features needs"""
    place: float = limit(0.02, source=NOT_RECORDED)
    """distance of such places, as a share of the longest side"""
    as_well: float = limit(2.0, source=NOT_RECORDED)
    """another turn explains the outlines, too, up to this multiple of the lowest mean gap"""
    of_a_voxel: float = limit(0.05, unit="voxels", source=NOT_RECORDED)
    """plus this"""
    other_turn_deg: float = limit(15.0, unit="deg", source=NOT_RECORDED)
    """turns that differ by more are different"""
    as_many: float = limit(0.8, source=NOT_RECORDED)
    """share of the places of the best motion by features that agree with another one"""
    doubted: float = limit(
        0.05,
        source="masks that lack a part of the object take some off a right motion, too",
    )
    """share of the outlines that the hull of both misses from which a motion is doubted"""
    most_missed: float = limit(0.25, source=NOT_RECORDED)
    """the same from which it is another object"""
    clearly: float = limit(0.5, source=NOT_RECORDED)
    """share of its gaps at which a motion by shape is preferred to one by features"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Turn:
    """How the object was turned.

    Attributes:
        T_first_second: maps the world of the second photos into that of the first.
        by: "features" or "shape".
        residual_m: median distance of the surfaces where both positions measured them.
        agreeing: share of these points, or of the pairs of features, that agree.
        count: number of them.
        missed: share of the outlines of both that the hull of both does not explain.
        ambiguous: another turn fits as well.
        difference_deg: turn between the motion by features alone and with the surfaces.
    """

    T_first_second: SE3
    by: str
    residual_m: float
    agreeing: float
    count: int
    missed: float
    ambiguous: bool
    difference_deg: float | None

    @property
    def doubted(self) -> bool:
        """Whether more of the outlines disagree than with good masks."""
        return self.missed > TurnSettings.current().doubted

    def facts(self) -> dict[str, Any]:
        """Name and value for the report."""
        angle = np.degrees(rotation_angle(self.T_first_second.R))
        found = {
            "turned over by": f"{angle:.1f} degrees, found by {self.by}",
            "turned over residual": f"{1000 * self.residual_m:.2f} mm"
            if np.isfinite(self.residual_m)
            else "not measured: no surface has depth from both positions",
            "turned over agreement": f"{100 * self.agreeing:.0f} % of {self.count} "
            + ("pairs of features" if self.by == "features" else "points"),
            "turned over outlines": f"{100 * (1 - self.missed):.1f} % explained by both hulls",
        }
        if self.difference_deg is not None:
            found["turned over uncertainty"] = (
                f"{self.difference_deg:.2f} degrees between features alone and with the surface"
            )
        return found


def find_turn(first: Side, surface: Surface, second: Side, other: Surface) -> Turn:
    """The motion of the object between two positions.

    Args:
        first: photos of the first position.
        surface: its surface.
        second: photos of the second position, in their own world.
        other: its surface.

    Raises:
        ToolkitError: no motion explains the second photos.
    """
    limits = TurnSettings.current()
    longest = float(np.ptp(surface.vertices, axis=0).max())
    near = limits.agreement * longest
    p, q = _pairs(_features(first), _features(second))
    by, agreeing, count, ambiguous, difference = "features", 0.0, len(p), False, None
    T = None
    inliers = np.zeros(len(p), bool)
    if len(p) >= limits.fewest_places:
        try:
            found, inliers = ransac_similarity(
                q, p, threshold_m=near, with_scale=False, max_iterations=20_000
            )
            if _places(p[inliers], limits.place * longest) >= limits.fewest_places:
                T = SE3(found.R, found.t)
                ambiguous = _texture_repeats(T, p, q, inliers, near, limits.place * longest)
        except ToolkitError:
            pass  # No three pairs agree: the shape decides.
    caster = RayCaster(surface.vertices, surface.faces)
    coherence = HullCoherence(first, second)
    points = _sampled(other, measured=True)
    if T is not None:
        alone = T
        T = _refined(T, points, surface, caster, near, p[inliers], q[inliers])
        agreeing = float(inliers.mean())
        difference = float(np.degrees(rotation_angle(alone.R.T @ T.R)))
    if T is None or _missed(coherence, T, near) > limits.doubted:
        shaped, several = _by_shape(
            _sampled(other, measured=False), surface, coherence, first.grid.step
        )
        # The depth of plain sides is no better than the outlines.
        refined = _refined(shaped, points, surface, caster, near, p[:0], q[:0])
        shaped = min(refined, shaped, key=coherence.mean_gap)
        # Specks that look alike may agree by chance, on both sides of the object.
        if T is None or coherence.mean_gap(shaped) < limits.clearly * coherence.mean_gap(T):
            T, ambiguous, by, difference = shaped, several, "shape", None
    off = _distances(T, points, surface, caster)
    residual = float(np.median(off)) if len(off) else float("nan")
    if by == "shape":
        agreeing, count = float((off < near).mean()) if len(off) else 0.0, len(off)
    missed = _missed(coherence, T, near)
    if missed > limits.most_missed or (by == "features" and residual > near):
        raise ToolkitError(
            f"no turn of the object of the first photos explains the second ({100 * missed:.0f} % "
            f"of the outlines disagree, surfaces differ by {1000 * residual:.1f} mm)",
            hint="photograph the same object again after turning it over, with a side in view that "
            "the first photos show, too",
        )
    return Turn(
        T_first_second=T, by=by, residual_m=residual, agreeing=agreeing, count=count,
        missed=missed, ambiguous=ambiguous, difference_deg=difference,
    )  # fmt: skip


def _texture_repeats(T: SE3, p: Array, q: Array, inliers: Mask, near: float, apart: float) -> bool:
    """Whether another turn explains nearly as many places, as where a texture is there twice."""
    limits = TurnSettings.current()
    p_rest, q_rest = p[~inliers], q[~inliers]
    if len(p_rest) < limits.fewest_places:
        return False
    try:
        found, others = ransac_similarity(
            q_rest, p_rest, threshold_m=near, with_scale=False, max_iterations=2000
        )
    except ToolkitError:
        return False
    enough = max(limits.fewest_places, limits.as_many * _places(p[inliers], apart))
    turned = _apart(T, SE3(found.R, found.t)) > limits.other_turn_deg
    return turned and _places(p_rest[others], apart) >= enough


def _features(side: Side) -> list[tuple[Array, NDArray[np.uint8]]]:
    """Places (N, 3) in the world of the side and descriptors of each photo's features."""
    # Without precise upscaling, pixels are off by 1/4: upside down, the error counts twice.
    sift = cv2.SIFT_create(  # type: ignore[attr-defined]
        nfeatures=_FEATURES, contrastThreshold=0.02, enable_precise_upscale=True
    )
    found = []
    for view, depth in zip(side.views, side.maps, strict=True):
        if depth is None:
            continue
        mask = eroded(view.shown, 3).astype(np.uint8)
        grey = cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY)
        keypoints, descriptors = sift.detectAndCompute(grey, mask)
        if len(keypoints) < 2:
            continue
        uv = np.array([k.pt for k in keypoints], np.float64)
        places, good = _placed(view, depth, uv)
        root = np.sqrt(descriptors / (descriptors.sum(axis=1, keepdims=True) + 1e-9))
        found.append((places[good], np.rint(512 * root[good]).astype(np.uint8)))
    return found


def _placed(view: View, m: DepthMap, uv: Array) -> tuple[Array, Mask]:
    """World points (N, 3) of pixels, and which have a sure depth."""
    column, row = (np.rint(uv) - [m.x, m.y]).astype(np.int64).T
    inside = (column >= 0) & (row >= 0) & (column < m.depth.shape[1]) & (row < m.depth.shape[0])
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    depth = m.depth[row, column].astype(np.float64)
    good = inside & (depth > 0) & (m.cost[row, column] < 0.3)
    return view.T_world_cam @ view.camera.unproject(uv, np.maximum(depth, 1e-3)), good


def _pairs(
    first: Sequence[tuple[Array, NDArray[np.uint8]]],
    second: Sequence[tuple[Array, NDArray[np.uint8]]],
) -> tuple[Array, Array]:
    """Places (N, 3) of the same features in both worlds, with wrong pairs among them."""
    p, q = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for a, d in first:
        for b, e in second:
            matches = match_descriptors(d, e, max_ratio=0.8)
            p.append(a[matches[:, 0]])
            q.append(b[matches[:, 1]])
    return np.concatenate(p), np.concatenate(q)


def _places(points: Array, apart: float) -> int:
    """Number of different places: one feature in many pairs of photos is one."""
    return len(np.unique(np.floor(points / apart), axis=0)) if len(points) else 0


def _sampled(surface: Surface, *, measured: bool) -> Array:
    """Middles (N, 3) of at most 3000 faces that depth maps measured, or of all off the table."""
    middle = surface.vertices[surface.faces].mean(axis=1)
    if measured:
        kept = surface.support > 0.3
    else:
        kept = middle[:, 2] > middle[:, 2].min() + 0.02 * np.ptp(middle[:, 2])
    middle = middle[kept]
    return np.asarray(middle[np.random.default_rng(0).permutation(len(middle))[:3000]])


def _distances(T: SE3, points: Array, surface: Surface, caster: RayCaster) -> Array:
    """Distances of moved points to those parts of the surface that were measured."""
    if len(points) == 0:
        return np.zeros(0)
    moved = T @ points
    near, _, face = caster.closest_with_faces(moved)
    off = np.linalg.norm(moved - near, axis=1)
    return np.asarray(off[surface.support[face] > 0.3], np.float64)


def _refined(
    T: SE3,
    points: Array,
    surface: Surface,
    caster: RayCaster,
    near: float,
    p: Array,
    q: Array,
) -> SE3:
    """The motion that lays points on the measured surface and features q on p."""
    if len(points) < 100 and len(p) < 3:
        return T
    scale = near
    for _ in range(30):
        rows, values, weights = [np.zeros((0, 6))], [np.zeros(0)], [np.zeros(0)]
        if len(points):
            moved = T @ points
            closest, normal, face = caster.closest_with_faces(moved)
            off = ((moved - closest) * normal).sum(axis=1)
            use = (surface.support[face] > 0.3) & (np.abs(off) < 3 * near)
            rows.append(np.hstack([normal, np.cross(moved, normal)])[use])
            values.append(off[use])
            weights.append(1 / (1 + (off[use] / scale) ** 2))
        if len(p):
            moved = T @ q
            step = max(1, len(p) // 3000)
            moved, wanted = moved[::step], p[::step]
            gap = moved - wanted
            turn = np.stack([-skew(m) for m in moved])
            block = np.concatenate(
                [np.broadcast_to(np.eye(3), (len(moved), 3, 3)), turn], axis=2
            ).reshape(-1, 6)
            w = 1 / (1 + (np.linalg.norm(gap, axis=1) / scale) ** 2)
            rows.append(block)
            values.append(gap.ravel())
            weights.append(np.repeat(w, 3))
        A, b, w = np.concatenate(rows), np.concatenate(values), np.concatenate(weights)
        if len(A) < 6:
            return T
        x = np.linalg.lstsq(A * w[:, None] ** 0.5, -b * w**0.5, rcond=1e-8)[0]
        R = Rotation.from_rotvec(x[3:]).as_matrix().astype(np.float64)
        T = SE3(R, np.asarray(x[:3], np.float64)) @ T
        scale = max(0.7 * scale, 0.15 * near)
    return T


def _by_shape(
    points: Array, surface: Surface, coherence: HullCoherence, voxel_m: float
) -> tuple[SE3, bool]:
    """The motion with the least gaps, of many turns, and whether another turn has as few."""
    limits = TurnSettings.current()
    middle = (surface.vertices.min(axis=0) + surface.vertices.max(axis=0)) / 2
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    turns = Rotation.random(_TURNS, random_state=0).as_matrix().astype(np.float64)
    motions = [SE3(R, middle - R @ centre) for R in turns]
    tried: list[SE3] = []
    for T in sorted(motions, key=coherence.mean_gap):
        if len(tried) < _FITTED and all(_apart(T, U) > limits.other_turn_deg for U in tried):
            tried.append(T)
    fitted = [coherence.fitted(T) for T in tried]
    gaps = [coherence.mean_gap(T) for T in fitted]
    T, limit = (
        fitted[int(np.argmin(gaps))],
        limits.as_well * min(gaps) + limits.of_a_voxel * voxel_m,
    )
    ambiguous = any(
        gap < limit and _apart(T, U) > limits.other_turn_deg
        for gap, U in zip(gaps, fitted, strict=True)
    )
    return T, ambiguous


def _missed(coherence: HullCoherence, T: SE3, near: float) -> float:
    """Share of the outlines that a motion leaves farther than a distance from the hull of both."""
    return float((coherence.gaps(T) > near).mean())


def _apart(a: SE3, b: SE3) -> float:
    """Angle between two rotations in degrees."""
    return float(np.degrees(rotation_angle(a.R.T @ b.R)))
