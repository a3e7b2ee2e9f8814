"""Residual motion of a label in six degrees of freedom, from image edges along its contour.

Each contour point gives one equation: the image edge lies `offset` pixels from the contour along
its normal, and a small motion of the object moves the contour by `jacobian @ motion` pixels. Which
edge of a profile belongs to the object is unknown. Every point therefore keeps several edges, and
the motion is the one at which a mixture of these edges and of clutter is most likely. The equations
of several frames are solved together, because one frame leaves the distance weakly determined.

A motion is a vector (6,): translation of the object's centre in metres, and rotation vector about
the centre in radians, both along the axes of the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.contours import Contour
from std_toolkit.checks.edges import Profiles, edge_peaks
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.symmetry import Symmetry

Array = NDArray[np.float64]

FEWEST_POINTS = 16
FEWEST_FRAMES = 4
# Chi square with three degrees of freedom that chance exceeds as rarely as three deviations.
_SIGNIFICANT_CHI2 = 14.16
# A motion with a smaller gain in log likelihood is not shown: among clutter, the edges at the label
# are nearly as likely.
_LEAST_GAIN = 2.0
# Parts of a significant motion below this number of deviations are left out.
_CONTRIBUTES = 2.0
_LARGEST_SAMPLE = 120
_EDGES_PER_POINT = 4
# Errors of neighbouring contour points are correlated: one independent sample per 60 px.
_INDEPENDENT_PX = 60.0
# Anti-aliasing, shading and the mesh move edges by this much even where the label is exact.
_SMALLEST_STD_PX = 0.25
_PRIOR = np.array([0.03] * 3 + [0.25] * 3)
_PRIOR_SIZE = 0.1
# Widths in px of the edge's likelihood: wide ones find the motion, the last one measures it.
_WIDTHS_PX = (6.0, 4.0, 2.5, 1.5, 1.0, 0.7)
_STEPS = 3
_FIXED = 1e-6
# A contour point is on an edge if one is this near.
_ON_EDGE_PX = 1.25
# Displaced contours differ by less than this for other reasons than noise.
_SMALLEST_MARGIN = 0.15
_CHANCE_SHIFTS_PX = np.array([-10, -8, -6, -4.5, 4.5, 6, 8, 10])


@dataclass(frozen=True, eq=False)
class MotionEquations:
    """Edges near one object's contour in one frame.

    Attributes:
        offsets: (P, K) float32 positions of edges along the normals in px, inf where there are
            fewer than K.
        strengths: (P, K) float32 weights of these edges, 0..1.
        clutter: (P,) float32 number of edges per px of the profile.
        jacobian: (P, 7) float32 px per unit of motion, and per unit of relative size.
        length_px: length of the contour that the points stand for.
    """

    offsets: NDArray[np.float32]
    strengths: NDArray[np.float32]
    clutter: NDArray[np.float32]
    jacobian: NDArray[np.float32]
    length_px: float

    def support(self, motion: Array) -> tuple[float, float]:
        """Share of the points on an edge after a motion, and that of displaced contours.

        Args:
            motion: (6,), or (7,) with the relative size.
        """
        offsets = self.offsets - (self.jacobian[:, : len(motion)] @ motion)[:, None]
        on_edge = float((np.abs(offsets).min(axis=1) < _ON_EDGE_PX).mean())
        moved = np.abs(offsets[None] - _CHANCE_SHIFTS_PX[:, None, None]).min(axis=2)
        return on_edge, float((moved < _ON_EDGE_PX).mean())

    @property
    def independent(self) -> float:
        """Number of independent samples of the contour."""
        return max(self.length_px / _INDEPENDENT_PX, 3.0)

    def beats_chance(self, motion: Array) -> bool:
        """Whether more points lie on edges than displaced contours explain, at two deviations."""
        share, chance = self.support(motion)
        deviation = np.sqrt(max(chance * (1 - chance), 0.02) / self.independent)
        return share - chance > max(2 * deviation, _SMALLEST_MARGIN)


@dataclass(frozen=True)
class Support:
    """Share of contour points on image edges, against displaced contours.

    Attributes:
        share, chance: means over the frames, weighted by the length of the contour.
        deviation: standard deviation of their difference.
        frames: fraction of the frames that beat chance alone.
    """

    share: float
    chance: float
    deviation: float
    frames: float


def pooled_support(equations: Sequence[MotionEquations], motion: Array) -> Support:
    """Support over frames after a motion (6,) or (7,); at least one entry."""
    weights = np.array([e.independent for e in equations])
    values = np.array([e.support(motion) for e in equations])
    share, chance = weights @ values / weights.sum()
    deviation = np.sqrt(max(chance * (1 - chance), 0.02) / weights.sum())
    beaten = [e.beats_chance(motion) for e in equations]
    return Support(float(share), float(chance), float(deviation), float(np.mean(beaten)))


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion with its uncertainty.

    Attributes:
        vector: (6,), see the module.
        covariance: (6, 6).
        size: size of the object relative to its mesh, minus 1; None if it was not solved.
        size_std: its standard deviation.
        residual_px: robust standard deviation of the edges around the moved contour.
        gain: log likelihood of the independent samples gained by the motion.
    """

    vector: Array
    covariance: Array
    size: float | None
    size_std: float | None
    residual_px: float
    gain: float

    @property
    def translation_mm(self) -> tuple[float, float]:
        """Length of the significant translation and the standard deviation along it, mm."""
        length, std = self._significant(slice(3))
        return 1000 * length, 1000 * std

    @property
    def rotation_deg(self) -> tuple[float, float]:
        """Angle of the significant rotation and the standard deviation of it, degrees."""
        length, std = self._significant(slice(3, 6))
        return float(np.rad2deg(length)), float(np.rad2deg(std))

    def _significant(self, part: slice) -> tuple[float, float]:
        """Length of the significant part, and the standard deviation along it."""
        vector = self.vector[part] if self.gain >= _LEAST_GAIN else np.zeros(3)
        return _significant(vector, self.covariance[part, part])


def motion_equations(
    contour: Contour, profiles: Profiles, camera: Camera, T_world_cam: SE3, centre: Array
) -> MotionEquations | None:
    """The equations of one object in one frame.

    Args:
        contour: its visible contour.
        profiles: of the contour, from `read_profiles`.
        camera, T_world_cam: the view.
        centre: (3,) centre of the object in the world, metres.

    Returns:
        None if too few points have a depth.
    """
    rows = np.flatnonzero(contour.depth[profiles.index] > 0)
    if len(rows) > _LARGEST_SAMPLE:
        rows = rows[np.linspace(0, len(rows) - 1, _LARGEST_SAMPLE).round().astype(int)]
    if len(rows) < FEWEST_POINTS:
        return None
    at = profiles.index[rows]
    z = contour.depth[at]
    rays = camera.unproject(contour.points[at])
    x, y = rays[:, 0], rays[:, 1]
    arm = (rays * z[:, None]) @ T_world_cam.R.T + T_world_cam.t - centre
    n = contour.normals[at]
    # Distortion changes the scale of the normals by less than the search needs.
    along = np.stack(
        [
            n[:, 0] * camera.fx / z,
            n[:, 1] * camera.fy / z,
            -(n[:, 0] * camera.fx * x + n[:, 1] * camera.fy * y) / z,
        ],
        axis=1,
    )
    force = along @ T_world_cam.R.T
    size = (force * arm).sum(axis=1, keepdims=True)
    jacobian = np.concatenate([force, np.cross(arm, force), size], axis=1)
    position, strength = edge_peaks(profiles)
    position, strength = position[rows], strength[rows]
    count = np.isfinite(position).sum(axis=1)
    best = np.argsort(-strength, axis=1, kind="stable")[:, :_EDGES_PER_POINT]
    reach = float(profiles.offsets[-1] - profiles.offsets[0])
    return MotionEquations(
        np.take_along_axis(position, best, axis=1).astype(np.float32),
        np.take_along_axis(strength, best, axis=1).astype(np.float32),
        np.maximum(count / reach, 0.02).astype(np.float32),
        jacobian.astype(np.float32),
        float(contour.own.sum()),
    )


def symmetry_motions(symmetry: Symmetry, T_world_obj: SE3, centre: Array) -> Array:
    """(N, 6) motions that do not change the appearance of the object."""
    if symmetry.is_spherical:
        return np.eye(6)[3:]
    rows = []
    for axis, offset in symmetry.continuous:
        w = T_world_obj.R @ (np.asarray(axis) / np.linalg.norm(axis))
        rows.append(np.concatenate([np.cross(w, centre - T_world_obj @ np.asarray(offset)), w]))
    return np.array(rows).reshape(-1, 6)


def solve_motion(
    equations: Sequence[MotionEquations],
    free: Array | None = None,
    *,
    with_size: bool = False,
    systematic_px: float = 0.0,
) -> Motion | None:
    """The motion common to all frames.

    Args:
        equations: one entry per frame.
        free: (N, 6) motions that are left out, from `symmetry_motions`.
        with_size: solve for the size of the object, too.
        systematic_px: standard deviation of an error that edges of all frames share; it is part of
            the covariance.

    Returns:
        None without equations.
    """
    if not equations:
        return None
    from std_toolkit.checks.edge_sums import climb  # loads numba

    dof = 7 if with_size else 6
    J = np.concatenate([e.jacobian for e in equations]).astype(np.float64)[:, :dof]
    offsets = np.concatenate([e.offsets for e in equations]).astype(np.float64)
    strengths = np.concatenate([e.strengths for e in equations]).astype(np.float64)
    clutter = np.concatenate([e.clutter for e in equations]).astype(np.float64)
    # The number of independent samples that each row stands for.
    share = np.concatenate(
        [np.full(len(e.offsets), e.length_px / _INDEPENDENT_PX / len(e.offsets)) for e in equations]
    )
    known = np.isfinite(offsets)
    offsets = np.where(known, offsets, 0.0)
    strengths = np.where(known, strengths, 0.0)
    prior = np.diag(1 / np.concatenate([_PRIOR, [_PRIOR_SIZE]])[:dof] ** 2)
    for motion in np.zeros((0, 6)) if free is None else free:
        row = np.zeros(dof)
        row[:6] = motion
        prior += np.outer(row, row) / _FIXED**2

    def responsibility(xi: Array, width: float) -> tuple[Array, Array]:
        e = offsets - (J @ xi)[:, None]
        density = strengths * np.exp(-0.5 * (e / width) ** 2) / (np.sqrt(2 * np.pi) * width)
        total = density.sum(axis=1) + clutter
        return density / total[:, None], np.log(total)

    zero = np.zeros(dof)
    last = _WIDTHS_PX[-1]

    def score(xi: Array) -> float:
        return float((share * responsibility(xi, last)[1]).sum() - 0.5 * xi @ prior @ xi)

    rows = offsets, strengths, clutter, share, np.ascontiguousarray(J), prior
    found = [climb(*rows, zero, np.array(_WIDTHS_PX[first:]), _STEPS) for first in (0, 2, 4)]
    xi = max(found, key=score)
    r, _ = responsibility(xi, last)
    e = offsets - (J @ xi)[:, None]
    weight = share[:, None] * r
    # Truncation by the width makes the residual a little too small.
    std = float(np.sqrt((weight * e**2).sum() / max(weight.sum(), 1e-9)))
    std = max(1.2 * std, _SMALLEST_STD_PX)
    w = weight.sum(axis=1) / std**2
    covariance = np.linalg.inv((J * w[:, None]).T @ J + prior)
    # px per metre and per radian.
    for part in (slice(3), slice(3, 6)):
        sensitivity = float((J[:, part] ** 2).sum(axis=1).mean())
        covariance[part, part] += np.eye(3) * systematic_px**2 / max(sensitivity, 1e-9)
    return Motion(
        xi[:6],
        covariance[:6, :6],
        float(xi[6]) if with_size else None,
        float(np.sqrt(covariance[6, 6])) if with_size else None,
        std,
        score(xi) - score(zero),
    )


def _significant_part(vector: Array, covariance: Array) -> Array:
    """The vector along the principal directions that contribute; zero if it is not significant."""
    values, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    along = axes.T @ vector
    deviations = along / np.sqrt(np.maximum(values, 1e-18))
    if (deviations**2).sum() < _SIGNIFICANT_CHI2:
        return np.zeros(3)
    along[np.abs(deviations) < _CONTRIBUTES] = 0
    return np.asarray(axes @ along)


def _significant(vector: Array, covariance: Array) -> tuple[float, float]:
    part = _significant_part(vector, covariance)
    length = float(np.linalg.norm(part))
    if length > 0:
        unit = part / length
        return length, float(np.sqrt(unit @ covariance @ unit))
    return 0.0, float(np.sqrt(max(np.linalg.eigvalsh((covariance + covariance.T) / 2)[-1], 0)))
