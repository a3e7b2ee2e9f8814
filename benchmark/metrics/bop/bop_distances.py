"""BOP's distances between a model at two poses: MSSD in space and MSPD in the image.

Source: T. Hodan et al., "BOP Challenge 2020", equations 3 and 4. Both are the largest distance of a
vertex, minimised over the symmetries of the model. Rotations are used as filed: they need not be
exactly orthonormal.

A turn about a continuous symmetry axis is minimised exactly. Each vertex moves on a circle; a few
vertices determine the best angle, and the vertex that is farthest there joins them until it is one
of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, Symmetry

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]

# Projects points (3, ...) of the camera frame to pixels (2, ...) that may lack a constant offset.
Project = Callable[[Floats], Floats]

# Angles of the first search; BOP's step leaves out at most 1 % of the object's extent.
TURN_STEPS = 315

_CANDIDATES = 3  # local minima that are refined
_ZOOM = np.linspace(-1, 1, 17)
_ZOOMS = 8  # each narrows the bracket to an eighth; together to 1e-9 rad
_ROUNDS = 40
_EXTREMES = np.stack(np.meshgrid(*3 * [[-1.0, 0.0, 1.0]]), axis=-1).reshape(-1, 3)


@dataclass(frozen=True)
class Pinhole:
    """Projection by focal lengths, without lens distortion, relative to the principal point.

    Points that are not in front of the camera give infinity.

    Attributes:
        fx, fy: focal lengths, pixels.

    >>> Pinhole(60, 60)(np.array([0.5, 0.25, 1.0])).tolist()
    [30.0, 15.0]
    """

    fx: float
    fy: float

    def __call__(self, points: Floats) -> Floats:
        z = points[2]
        if not z.min() > 0:
            return np.full((2, *z.shape), np.inf)
        seen = points[:2] / z
        seen[0] *= self.fx
        seen[1] *= self.fy
        return seen

    def of(self, R: Floats, t: Floats) -> tuple[Floats, Floats]:
        """(3, 3) and (3,) that map points of the object to homogeneous pixels."""
        focal = np.array([self.fx, self.fy, 1.0])
        return focal[:, None] * R, focal * t


def pinhole(camera: Camera) -> Pinhole:
    """The projection of a camera without its principal point and distortion.

    Args:
        camera: its focal lengths are used.

    Returns:
        The projection.

    >>> pinhole(Camera(64, 48, 60, 60, 31.5, 23.5))
    Pinhole(fx=60.0, fy=60.0)
    """
    return Pinhole(camera.fx, camera.fy)


def fisheye624(f: tuple[float, float], coefficients: Sequence[float]) -> Project:
    """Projection of the model FISHEYE624, relative to the principal point.

    The angle from the optical axis is the radius; a polynomial of it, tangential and thin-prism
    distortion follow.

    Args:
        f: focal lengths, pixels.
        coefficients: k1 ... k6, p1, p2, s1 ... s4.

    Returns:
        The projection.

    Raises:
        ToolkitError: not 12 coefficients.

    >>> straight = fisheye624((100.0, 100.0), 12 * [0.0])
    >>> straight(np.array([1.0, 0.0, 0.0])).round(6).tolist()  # 90 degrees off the axis
    [157.079633, 0.0]
    """
    if len(coefficients) != 12:
        raise ToolkitError("FISHEYE624 has 12 coefficients", value=len(coefficients))
    *radial, p1, p2, s1, s2, s3, s4 = coefficients

    def project(points: Floats) -> Floats:
        x, y, z = points
        r = np.hypot(x, y)
        angle = np.arctan2(r, z)
        squared = angle**2
        factor = 1 + sum(k * squared ** (i + 1) for i, k in enumerate(radial))
        scale = factor * angle / np.maximum(r, 1e-300)
        u, v = x * scale, y * scale
        r2 = u * u + v * v
        across = 2 * u * v
        u_out = u + p2 * across + p1 * (r2 + 2 * u * u) + s1 * r2 + s2 * r2 * r2
        v_out = v + p1 * across + p2 * (r2 + 2 * v * v) + s3 * r2 + s4 * r2 * r2
        return np.stack([f[0] * u_out, f[1] * v_out])

    return project


@dataclass(frozen=True, eq=False)
class ModelDistances:
    """Distances of a model between poses.

    Attributes:
        vertices: (V, 3) of the model, object frame, metres. MSPD needs all of them: unlike
            distances in space, distances of projections need not be largest on the hull.
        hull: (K, 3) those of the hull.
        symmetry: of the model.
        steps: samples of a full turn about a continuous axis; None for the exact minimum.

    Raises:
        ToolkitError: arrays of another shape.
    """

    vertices: Floats
    hull: Floats
    symmetry: Symmetry
    steps: int | None = None

    def __post_init__(self) -> None:
        for name in ("vertices", "hull"):
            points = np.asarray(getattr(self, name), dtype=np.float64)
            if points.ndim != 2 or points.shape[1] != 3 or not len(points):
                raise ToolkitError("must be (V, 3)", field=name, value=points.shape)
            # Contiguous by coordinate: several times as fast.
            object.__setattr__(self, name, np.ascontiguousarray(points.T))

    @cached_property
    def _discrete(self) -> list[SE3]:
        return self.symmetry.discrete_transforms()

    def mssd(self, estimates: Sequence[SE3], truths: Sequence[SE3]) -> Floats:
        """(E, G) maximum symmetry-aware surface distances, metres."""
        found = np.full((len(estimates), len(truths)), np.inf)
        for j, truth in enumerate(truths):
            for S in self._discrete:
                R, t = truth.R @ S.R, truth.R @ S.t + truth.t
                for i, estimate in enumerate(estimates):
                    found[i, j] = min(found[i, j], self._space(estimate, R, t))
        return found

    def _space(self, estimate: SE3, R: Floats, t: Floats) -> float:
        if self.symmetry.is_spherical and self.steps is None:
            centre = np.asarray(self.symmetry.continuous[0][1])
            return float(np.linalg.norm((estimate.R - R) @ centre + estimate.t - t))
        if not self.symmetry.continuous:
            from benchmark.metrics.bop.projected_points import largest_move

            return float(np.sqrt(largest_move(self.hull, estimate.R - R, estimate.t - t)))
        target = estimate.R @ self.hull + estimate.t[:, None]

        def distance(points: Floats, which: Ids) -> Floats:
            return np.asarray(((points - target[:, which, None]) ** 2).sum(axis=0))

        return self._over_turns(self.hull, R, t, distance)

    def mspd(self, estimates: Sequence[SE3], truths: Sequence[SE3], project: Project) -> Floats:
        """(E, G) maximum symmetry-aware projection distances, pixels."""
        found = np.full((len(estimates), len(truths)), np.inf)
        if not estimates:
            return found
        if isinstance(project, Pinhole) and not self.symmetry.continuous:
            return self._pinhole_mspd(estimates, truths, project)
        seen = [project(_placed(self.vertices, T.R, T.t)) for T in estimates]
        for j, truth in enumerate(truths):
            for S in self._discrete:
                R, t = truth.R @ S.R, truth.R @ S.t + truth.t
                for i, pixels in enumerate(self._pixels(seen, R, t, project)):
                    found[i, j] = min(found[i, j], pixels)
        return found

    def _pinhole_mspd(
        self, estimates: Sequence[SE3], truths: Sequence[SE3], project: Pinhole
    ) -> Floats:
        from benchmark.metrics.bop.projected_points import largest_distance  # numba loads slowly

        found = np.full((len(estimates), len(truths)), np.inf)
        for j, truth in enumerate(truths):
            for S in self._discrete:
                true = project.of(truth.R @ S.R, truth.R @ S.t + truth.t)
                for i, estimate in enumerate(estimates):
                    seen = project.of(estimate.R, estimate.t)
                    pixels = largest_distance(self.vertices, *seen, *true)
                    found[i, j] = min(found[i, j], pixels)
        return found

    def _pixels(
        self, seen: Sequence[Floats], R: Floats, t: Floats, project: Project
    ) -> list[float]:
        if not self.symmetry.continuous:
            true = project(_placed(self.vertices, R, t))
            return [_largest(one, true) for one in seen]
        found = []
        for one in seen:

            def distance(points: Floats, which: Ids, one: Floats = one) -> Floats:
                if not np.isfinite(one[0, 0]):
                    return np.full(points.shape[1:], np.inf)
                return np.asarray(((project(points) - one[:, which, None]) ** 2).sum(axis=0))

            found.append(self._over_turns(self.vertices, R, t, distance))
        return found

    def _over_turns(
        self, points: Floats, R: Floats, t: Floats, distance: Callable[[Floats, Ids], Floats]
    ) -> float:
        """Least of the largest distances over all turns.

        Args:
            points: (3, V) of the model.
            R, t: true pose.
            distance: squared distances (P, A) of points (3, P, A) with these indices (P,).
        """
        best = np.inf
        for axis, offset in self.symmetry.continuous:
            a, o = np.asarray(axis) / np.linalg.norm(axis), np.asarray(offset)[:, None]
            arm = points - o
            along = np.outer(a, a @ arm)
            across = arm - along
            circle = R @ np.stack([o + along, across, np.cross(a, across, axis=0)])
            circle[0] += t[:, None]
            best = min(best, _least_turn(circle, points, distance, self.steps))
        return float(np.sqrt(best))


def _placed(points: Floats, R: Floats, t: Floats) -> Floats:
    placed = R @ points
    placed += t[:, None]
    return placed


def _largest(one: Floats, other: Floats) -> float:
    if not (np.isfinite(one[0, 0]) and np.isfinite(other[0, 0])):
        return np.inf
    apart = one - other
    apart *= apart
    apart[0] += apart[1]
    return float(np.sqrt(apart[0].max()))


def _least_turn(
    circle: Floats,
    points: Floats,
    distance: Callable[[Floats, Ids], Floats],
    steps: int | None,
) -> float:
    """Least of the largest squared distances over the angles of one axis.

    Args:
        circle: (3, 3, V) centre, cosine and sine parts of the circles, camera frame.
        points: (3, V) of the model.
        distance: as in `ModelDistances._over_turns`.
        steps: samples of the turn; None for the exact minimum.
    """
    count = steps or TURN_STEPS
    grid = 2 * np.pi * np.arange(count) / count

    def at(angles: Floats, which: Ids) -> Floats:
        centre, cosine, sine = circle[:, :, which, None]
        return distance(centre + cosine * np.cos(angles) + sine * np.sin(angles), which)

    everything = np.arange(points.shape[1])
    which = np.unique((_EXTREMES @ points).argmax(axis=1))
    best = np.inf
    for _ in range(_ROUNDS):

        def largest(angles: Floats, which: Ids = which) -> Floats:
            return np.asarray(at(angles, which).max(axis=0))

        angle, lowest = _lowest(largest, grid, steps is None)
        full = at(np.array([angle]), everything)[:, 0]
        best = min(best, float(full.max()))
        # No angle is better than the best one for some of the vertices.
        if not best > lowest * (1 + 1e-12):
            break
        which = np.append(which, full.argmax())
    return best


def _lowest(value: Callable[[Floats], Floats], grid: Floats, refine: bool) -> tuple[float, float]:
    """Angle of the least value, and that value."""
    values = value(grid)
    k = int(values.argmin())
    if not refine or not np.isfinite(values[k]):
        return float(grid[k]), float(values[k])
    falls = (values <= np.roll(values, 1)) & (values <= np.roll(values, -1))
    minima = np.flatnonzero(falls)
    minima = minima[np.argsort(values[minima])[:_CANDIDATES]]
    best = float(grid[k]), float(values[k])
    for angle in grid[minima]:
        width = float(grid[1]) if len(grid) > 1 else np.pi
        for _ in range(_ZOOMS):
            near = angle + width * _ZOOM
            there = value(near)
            angle, width = near[there.argmin()], width / 8
            best = min(best, (float(angle), float(there.min())), key=lambda x: x[1])
    return best
