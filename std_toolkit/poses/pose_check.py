"""Check of known camera poses: do they explain the features that match between the images?

Matches are verified with an essential or fundamental matrix, which does not depend on the poses.
They are joined to tracks, each track is triangulated with the poses, and the point is projected
into every image of the track. Points behind a camera and tracks that no point explains count with
their error, so that wrong poses cannot look good by dropping what they fail on.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.poses.colmap import to_colmap_camera, to_colmap_pixels, to_rigid3d
from std_toolkit.poses.known_cameras import KnownPoses
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Enough for a median to a few per cent.
_TRACKS = 3000
_TRACKS_OF_ALTERNATIVE = 400
# Errors beyond this are all alike: no point explains the track.
_LARGEST_PX = 1000.0


@dataclass(frozen=True, kw_only=True)
class PoseCheckSettings(Settings):
    """When tracks contradict known camera poses."""

    fewest_tracks: int = limit(30, source=NOT_RECORDED)
    """fewer tracks check nothing"""
    better_factor: float = limit(3.0, source=NOT_RECORDED)
    """a convention that explains the images this many times better is named"""


@dataclass(frozen=True, eq=False)
class Tracks:
    """Features of one point each in several images.

    Attributes:
        frame: (N,) frame id of each observation, sorted by track.
        uv: (N, 2) pixels.
        offsets: (T + 1,) ranges of the tracks.
    """

    frame: NDArray[np.int64]
    uv: NDArray[np.float64]
    offsets: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def sample(self, count: int) -> Tracks:
        """Return evenly spaced tracks of the longer-moving half, which constrain poses most."""
        spans = [np.ptp(self.uv[a:b], axis=0).max() for a, b in self._ranges()]
        moving = np.flatnonzero(np.array(spans) >= np.median(spans)) if spans else np.zeros(0, int)
        chosen = moving[np.linspace(0, len(moving) - 1, min(count, len(moving))).astype(int)]
        parts = [np.arange(self.offsets[t], self.offsets[t + 1]) for t in chosen]
        rows = np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)
        ends = np.cumsum([0, *(len(p) for p in parts)])
        return Tracks(self.frame[rows], self.uv[rows], ends)

    def among(self, frames: Collection[int]) -> Tracks:
        """Return the tracks of these frames."""
        rows = np.flatnonzero(np.isin(self.frame, list(frames)))
        track = np.repeat(np.arange(len(self)), np.diff(self.offsets))[rows]
        counts = np.bincount(track, minlength=len(self))
        rows = rows[counts[track] >= 2]
        return Tracks(self.frame[rows], self.uv[rows], np.cumsum([0, *counts[counts >= 2]]))

    def _ranges(self) -> list[tuple[int, int]]:
        return list(pairwise(self.offsets.tolist()))

    def errors(self, T_world_cam: Mapping[int, SE3], camera: Mapping[int, Camera]) -> Any:
        """Return the (N,) reprojection errors in pixels of the triangulated tracks.

        Args:
            T_world_cam: pose by frame id.
            camera: intrinsics by frame id.
        """
        frames = sorted(set(self.frame.tolist()))
        rigid = {f: to_rigid3d(T_world_cam[f].inverse()) for f in frames}
        lens = {f: to_colmap_camera(camera[f], 1) for f in frames}
        estimation = pycolmap.EstimateTriangulationOptions()
        estimation.residual_type = pycolmap.TriangulationResidualType.REPROJECTION_ERROR
        estimation.ransac.max_error = 4.0
        estimation.ransac.random_seed = 0
        pixels = to_colmap_pixels(self.uv)
        xyz = np.zeros((len(self.uv), 3))
        for a, b in self._ranges():
            seen = [int(f) for f in self.frame[a:b]]
            found = pycolmap.estimate_triangulation(
                pixels[a:b], [rigid[f] for f in seen], [lens[f] for f in seen], estimation
            )
            xyz[a:b] = _linear(self.uv[a:b], seen, T_world_cam, camera) if found is None else (
                found["xyz"]
            )  # fmt: skip
        errors = np.full(len(self.uv), _LARGEST_PX)
        for f in frames:
            rows = np.flatnonzero(self.frame == f)
            local = T_world_cam[f].inverse() @ xyz[rows]
            front = local[:, 2] > 1e-9
            projected = camera[f].project(local[front])
            errors[rows[front]] = np.linalg.norm(projected - self.uv[rows[front]], axis=1)
        return np.minimum(np.nan_to_num(errors, nan=_LARGEST_PX), _LARGEST_PX)


def _linear(
    uv: NDArray[np.float64],
    seen: Sequence[int],
    T_world_cam: Mapping[int, SE3],
    camera: Mapping[int, Camera],
) -> NDArray[np.float64]:
    """Triangulate by least squares of all rays."""
    A, b = np.zeros((3, 3)), np.zeros(3)
    for pixel, f in zip(uv, seen, strict=True):
        T = T_world_cam[f]
        ray = T.R @ camera[f].unproject(pixel)
        if not np.isfinite(ray).all():  # a pixel that no ray reaches
            continue
        ray /= np.linalg.norm(ray)
        P = np.eye(3) - np.outer(ray, ray)
        A += P
        b += P @ T.t
    return np.asarray(np.linalg.lstsq(A, b, rcond=None)[0])


def join_tracks(
    pairs: Sequence[tuple[int, int, NDArray[np.integer]]], uv: Mapping[int, NDArray[np.float64]]
) -> Tracks:
    """Join verified matches of image pairs to tracks.

    Args:
        pairs: (frame id, frame id, (M, 2) feature indices).
        uv: (N, 2) pixels of the features by frame id.

    Returns:
        Tracks with at most one feature per image; others are contradictory and left out.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    frames = sorted(uv)
    start = dict(zip(frames, np.cumsum([0, *(len(uv[f]) for f in frames[:-1])]), strict=True))
    total = sum(len(uv[f]) for f in frames)
    a = np.concatenate([start[i] + m[:, 0] for i, _, m in pairs] or [np.zeros(0, np.int64)])
    b = np.concatenate([start[j] + m[:, 1] for _, j, m in pairs] or [np.zeros(0, np.int64)])
    a, b = a.astype(np.int64), b.astype(np.int64)
    graph = coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(total, total))
    _, label = connected_components(graph, directed=False)
    used = np.unique(np.concatenate([a, b]))
    frame = np.concatenate([np.full(len(uv[f]), f) for f in frames])[used]
    pixels = np.concatenate([uv[f] for f in frames])[used]
    order = np.lexsort((frame, label[used]))
    label, frame, pixels = label[used][order], frame[order], pixels[order]
    cuts = np.flatnonzero(np.diff(label, prepend=-1, append=-1))
    keep = [
        np.arange(s, e)
        for s, e in pairwise(cuts.tolist())
        if e - s >= 2 and (np.diff(frame[s:e]) > 0).all()
    ]
    rows = np.concatenate(keep) if keep else np.zeros(0, dtype=np.int64)
    return Tracks(frame[rows], pixels[rows], np.cumsum([0, *(len(k) for k in keep)]))


@dataclass(frozen=True)
class PoseVerdict:
    """Result of `check_poses`.

    Attributes:
        median_px: median reprojection error; None if too few features match.
        fits: whether the poses explain the images.
        notes: sentences for the user.
    """

    median_px: float | None
    fits: bool
    notes: list[str]


def check_poses(known: KnownPoses, tracks: Tracks, camera: Mapping[int, Camera]) -> PoseVerdict:
    """Check that the poses as a whole explain the images.

    Args:
        known: the poses.
        tracks: matched features of the frames with poses.
        camera: intrinsics by frame id.

    Raises:
        ToolkitError: they do not, or too few features match, unless the options keep such poses.
            A convention that explains the images is named.
    """
    limits = PoseCheckSettings.current()
    limit, path = known.options.cameras_max_px, known.filed.path
    chosen = tracks.sample(_TRACKS)
    if len(chosen) < limits.fewest_tracks:
        problem = (
            f"the poses cannot be checked: only {len(tracks)} features match between the images"
        )
        if not known.options.cameras_unchecked:
            raise ToolkitError(
                problem, path=path,
                hint="put texture into view, or keep the poses with --cameras-unchecked",
            )  # fmt: skip
        return PoseVerdict(None, False, [problem])
    median = float(np.median(chosen.errors(known.poses(), camera)))
    if median > limit:
        problem = f"these poses do not explain the images: {_px(median)}"
        advice = _explained(known, tracks, camera, median)
        if not known.options.cameras_unchecked:
            raise ToolkitError(
                problem, path=path,
                hint=advice
                or f"limit {limit:g} px; check intrinsics, order and convention, or keep the poses "
                "with --cameras-unchecked",
            )  # fmt: skip
        return PoseVerdict(median, False, [f"{problem}; {advice}" if advice else problem])
    notes = [f"the poses explain the images: median {median:.2f} px over {len(chosen)} points"]
    return PoseVerdict(median, True, notes)


def _px(error: float) -> str:
    if error >= _LARGEST_PX:
        return "points lie behind the cameras"
    return f"{error:.1f} px" if error < 10 else f"{error:.0f} px"


def _explained(
    known: KnownPoses, tracks: Tracks, camera: Mapping[int, Camera], median: float
) -> str:
    """Name the convention or the shift of the list that explains the images, if one does."""
    found = [_shifted(known, tracks, camera)]
    sample = tracks.sample(_TRACKS_OF_ALTERNATIVE)
    for other, advice in known.convention.alternatives(known.filed.quaternion):
        error = float(np.median(sample.errors(known.poses(other), camera)))
        found.append((error, f"{other.title} explains them: {_px(error)}; {advice}"))
    error, text = min(found)
    good = error <= known.options.cameras_max_px
    return text if good and error * PoseCheckSettings.current().better_factor < median else ""


def refuse_shifted(
    known: KnownPoses, tracks: Tracks, camera: Mapping[int, Camera], median: float
) -> None:
    """Refuse poses that explain the images much better if the list is shifted by one.

    Args:
        known: the poses.
        tracks: matched features of the frames with poses.
        camera: intrinsics by frame id.
        median: median reprojection error of the poses.

    Raises:
        ToolkitError: a shift explains the images better; it is named.
    """
    error, text = _shifted(known, tracks, camera)
    if error * PoseCheckSettings.current().better_factor < median:
        raise ToolkitError(
            f"these poses do not explain all images: {_px(median)}",
            path=known.filed.path,
            hint=text,
        )


def _shifted(known: KnownPoses, tracks: Tracks, camera: Mapping[int, Camera]) -> tuple[float, str]:
    """Median error of the better shift of the list by one pose, and what it means."""
    best = _LARGEST_PX, ""
    for step, when in ((1, "late"), (-1, "early")):
        poses = known.shifted(step)
        sample = tracks.among(poses).sample(_TRACKS_OF_ALTERNATIVE)
        if len(sample) < PoseCheckSettings.current().fewest_tracks:
            continue
        error = float(np.median(sample.errors(poses, camera)))
        side = "next" if step > 0 else "previous"
        text = (
            f"the pose of the {side} row explains each image: {_px(error)}; the list is {when} by "
            f"one image: give each image the pose of the {side} row"
        )
        best = min(best, (error, text))
    return best
