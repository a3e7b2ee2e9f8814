"""Residual motion of a label in six degrees of freedom, from image edges along its contour.

Each contour point gives one equation: the image edge lies `offset` pixels from the contour along
its normal, and a small motion of the object moves the contour by `jacobian @ motion` pixels. Which
edge of a profile belongs to the object is unknown. Every point therefore keeps several edges, and
the motion is the one at which a mixture of these edges and of clutter is most likely
(`motion_solver`). The equations of several frames are solved together, because one frame leaves the
distance weakly determined.

A motion is a vector (6,): translation of the object's centre in metres, and rotation vector about
the centre in radians, both along the axes of the world.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.measure.array_file import ArrayFile, FiledArray
from std_toolkit.checks.measure.contours import Contour
from std_toolkit.checks.measure.edges import Profiles, edge_peaks
from std_toolkit.checks.result import Source, Value
from std_toolkit.geometry import SE3, Camera
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

# From metres and radians to the millimetres and degrees of reports.
REPORTED = np.array([1000.0] * 3 + [180 / np.pi] * 3)
_LARGEST_SAMPLE = 120
_EDGES_PER_POINT = 4
# Six of a motion, and the size.
_UNKNOWNS = 7
# Errors of neighbouring contour points are correlated: one independent sample per 60 px.
INDEPENDENT_PX = 60.0
# (P,) px by which edges lie beside the contour, and their weights, from the jacobian.
Beside = Callable[[NDArray[np.floating]], tuple[Array, Array]]
# Meshes and shades move edges by less than this width of their likelihood.
_WIDTH_PX = 1.0
_CHANCE_SHIFTS_PX = np.array([-10, -8, -6, -4.5, 4.5, 6, 8, 10])


@dataclass(frozen=True, kw_only=True)
class MotionSettings(Settings):
    """Contours from which a motion is measured."""

    fewest_points: int = limit(16, source=NOT_RECORDED)
    """points of a contour in one frame"""
    fewest_frames: int = limit(
        4,
        source="errors of mesh and lens move a whole contour in one image",
    )
    """with fewer frames a motion is no evidence"""
    on_edge_px: float = limit(1.25, unit="px", source=NOT_RECORDED)
    """a contour point is on an edge if one is this near"""
    smallest_margin: float = limit(
        0.15,
        source="displaced contours differ by less for other reasons than noise",
    )
    """smallest share above chance by which a frame confirms a label"""


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

    def load(self) -> MotionEquations:
        """The equations themselves, see `FiledEquations.load`."""
        return self

    def after(self, motion: Array) -> MotionEquations:
        """The same edges, with offsets from the contour after a motion (6,) or (7,)."""
        along = (self.jacobian[:, : len(motion)] @ motion)[:, None]
        return replace(self, offsets=(self.offsets - along).astype(np.float32))

    def filed(self, file: ArrayFile) -> FiledEquations:
        """The equations moved into a file.

        Raises:
            ToolkitError: the disk is full.
        """
        rows = [self.offsets, self.strengths, self.clutter[:, None], self.jacobian]
        return FiledEquations(file.put(np.concatenate(rows, axis=1)), self.length_px)

    def support(self, motion: Array, beside: Beside | None = None) -> tuple[float, float]:
        """Share of the points on an edge after a motion, and that of displaced contours.

        Args:
            motion: (6,), or (7,) with the relative size.
            beside: edges that do not lie on the contour, and how much they count.
        """
        limits = MotionSettings.current()
        along = self.jacobian[:, : len(motion)] @ motion
        part = np.full(len(along), 1 / len(along))
        if beside is not None:
            shift, weight = beside(self.jacobian)
            along, part = along + shift, weight / weight.sum()
        offsets = self.offsets - along[:, None]
        on_edge = float(part @ (np.abs(offsets).min(axis=1) < limits.on_edge_px))
        moved = np.abs(offsets[None] - _CHANCE_SHIFTS_PX[:, None, None]).min(axis=2)
        return on_edge, float((moved < limits.on_edge_px).mean(axis=0) @ part)

    def likelihood(self, motion: Array) -> float:
        """Mean log likelihood of the points against clutter alone, after a motion (6,) or (7,)."""
        from std_toolkit.checks.measure.edge_sums import likelihood_gain  # loads numba

        e = self
        return float(
            likelihood_gain(e.offsets, e.strengths, e.clutter, e.jacobian, motion, _WIDTH_PX)
        )

    @property
    def independent(self) -> float:
        """Number of independent samples of the contour."""
        return max(self.length_px / INDEPENDENT_PX, 3.0)

    def beats_chance(self, share: float, chance: float) -> bool:
        """Whether more points lie on edges than displaced contours explain, at two deviations.

        Args:
            share, chance: from `support`.
        """
        deviation = np.sqrt(max(chance * (1 - chance), 0.02) / self.independent)
        return bool(share - chance > max(2 * deviation, MotionSettings.current().smallest_margin))


@dataclass(frozen=True, eq=False, slots=True)
class FiledEquations:
    """`MotionEquations` in a file, for the time between the frame and the end of the recording."""

    rows: FiledArray
    length_px: float

    def load(self) -> MotionEquations:
        """The equations, read from the file."""
        rows = np.asarray(self.rows)
        edges = (rows.shape[1] - _UNKNOWNS - 1) // 2
        return MotionEquations(
            rows[:, :edges],
            rows[:, edges : 2 * edges],
            rows[:, 2 * edges],
            rows[:, 2 * edges + 1 :],
            self.length_px,
        )


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


def pooled_support(
    equations: Sequence[MotionEquations | FiledEquations],
    motion: Array,
    beside: Beside | None = None,
) -> Support:
    """Support over frames after a motion, see `MotionEquations.support`; at least one entry."""
    independent, found, beaten = [], [], []
    for entry in equations:
        frame = entry.load()
        support = frame.support(motion, beside)
        independent.append(frame.independent)
        found.append(support)
        beaten.append(frame.beats_chance(*support))
    weights = np.array(independent)
    share, chance = weights @ np.array(found) / weights.sum()
    deviation = np.sqrt(max(chance * (1 - chance), 0.02) / weights.sum())
    return Support(float(share), float(chance), float(deviation), float(np.mean(beaten)))


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
    if len(rows) < MotionSettings.current().fewest_points:
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


def motion_value(
    key: str, source: Source, motion: Array, covariance: Array, *, frames: int, text: str = ""
) -> Value:
    """The value of a report for a motion: its length, and the largest deviation of a translation.

    Args:
        key, source, frames, text: of the value.
        motion, covariance: (6,) and (6, 6), metres and radians.
    """
    moved, known = motion * REPORTED, covariance * np.outer(REPORTED, REPORTED)
    return Value(
        key=key,
        value=round(float(np.linalg.norm(moved[:3])), 2),
        std=round(float(np.sqrt(np.linalg.eigvalsh(known[:3, :3])[-1])), 2),
        unit="mm",
        source=source,
        frames=frames,
        text=text,
        motion=[round(float(x), 3) for x in moved],
        covariance=[float(f"{x:.6g}") for x in known.ravel()],
    )
