"""Rank of a pose among nearby poses, by the agreement of silhouettes with image edges.

The distance from a contour to the nearest edge is small in clutter at any pose. Whether nearby
poses agree better does not depend on how cluttered the image is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.measure.silhouettes import MeasuredContour, SampledSurface, SilhouetteView
from std_toolkit.geometry import SE3, Symmetry, rotation_error, so3_exp
from std_toolkit.scene import Scene
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

POSES, LARGEST_SHIFT_M, LARGEST_TURN = 200, 0.03, np.deg2rad(15)

# Wider turns about the axes of the mesh find a pose that was refined into a wrong minimum.
_WIDE_TURNS = np.deg2rad([20, 30, 40, 50, 60, 75, 90])

# The best of them are improved by small random steps, in a few frames. They count if they remain
# far from the pose.
_CLIMBS, _CLIMB, _RIVAL_FRAMES = 4, 75, 4
_STEP_TURN, _STEP_M = np.deg2rad(8), 0.012

MOST_FRAMES = 8


@dataclass(frozen=True, kw_only=True)
class RankSettings(Settings):
    """When a pose beats the poses nearby."""

    good_share: float = limit(0.95, source=NOT_RECORDED)
    """a pose is good if it beats this share of nearby poses, over all frames"""
    frame_share: float = limit(0.9, source=NOT_RECORDED)
    """a frame tells something if the pose beats this share in it alone"""
    tie: float = limit(0.01, source=NOT_RECORDED)
    """agreements that differ by less are equal"""
    fewest_frames: int = limit(
        2,
        source="one image alone does not tell a turn from a shift in depth",
    )
    """frames that must tell something"""
    same: float = limit(1.0, unit="cells", source=NOT_RECORDED)
    """poses whose contours differ by less are the same pose to the images"""
    far_turn: float = limit(np.deg2rad(12), unit="rad", source=NOT_RECORDED)
    """a rival is turned by more, or its contours differ"""


@dataclass(frozen=True)
class PoseRank:
    """Rank of one pose.

    Attributes:
        beaten: number of nearby poses that agree less with the images.
        nearby: number of nearby poses that look different.
        frames: ids of the frames in which the contour is visible.
        telling: ids of those frames in which the pose alone stands out from the nearby ones.
        rival: agreement of the best turn 12 deg or more away minus that of the pose, both locally
            improved; positive: the other turn fits better; -1 if there is none, or if the pose is
            not good anyway.
        score: mean agreement of contour and edges, 0 to 1.
    """

    beaten: int
    nearby: int
    frames: tuple[int, ...]
    telling: tuple[int, ...]
    rival: float
    score: float

    @property
    def good(self) -> bool:
        """Whether the pose beats its neighbours in most frames and no wider turn fits better."""
        limits = RankSettings.current()
        return (
            self.nearby > 0
            and len(self.telling) >= limits.fewest_frames
            and self.beaten >= limits.good_share * self.nearby
            and 2 * len(self.telling) > len(self.frames)
            and self.rival < -limits.tie
        )

    def sentence(self) -> str:
        """The rank in words, without a full stop."""
        limits = RankSettings.current()
        if not self.frames:
            return "not ranked: its contour is visible in no frame"
        if not self.nearby:
            return "not ranked: nearby poses look the same"
        silent, total = len(self.frames) - len(self.telling), len(self.frames)
        text = f"better than {self.beaten} of {self.nearby} nearby poses"
        if silent:
            text += f"; {silent} of {total} frames {'is' if silent == 1 else 'are'} inconclusive"
        elif total < limits.fewest_frames:
            text += "; one frame alone confirms no pose"
        if self.rival >= -limits.tie:
            text += "; another turn fits as well"
        return text


def rank_objects(
    scene: Scene,
    poses: Mapping[int, Callable[[int], SE3 | None]],
    meshes: Mapping[int, object],
    symmetries: Mapping[int, Symmetry],
    frames: Sequence[int],
    *,
    count: int = POSES,
    seed: int = 0,
    cancelled: Callable[[], bool] = lambda: False,
) -> dict[int, PoseRank]:
    """Rank the poses of objects among random perturbations of them.

    Args:
        scene: provides images and cameras.
        poses: object id to T_cam_obj by frame id, of all objects; None without a pose.
        meshes: object id to mesh, metres.
        symmetries: by the ids of the objects to rank. Turns about a symmetry axis are no
            perturbations.
        frames: at most `MOST_FRAMES` that show the object are used, evenly spread.
        count: number of perturbations.
        seed: of the perturbations.
        cancelled: polled repeatedly; True returns the ranks known so far.

    Returns:
        By object id.

    Raises:
        ToolkitError: an image is unreadable.
    """
    surfaces = {
        i: SampledSurface.of(np.asarray(meshes[i].vertices), np.asarray(meshes[i].faces))  # type: ignore[attr-defined]
        for i in meshes
    }
    chosen = {
        i: _spread(
            [f for f in dict.fromkeys(frames) if _in_view(scene, f, poses[i], surfaces[i])],
            MOST_FRAMES,
        )
        for i in symmetries
    }
    views: dict[int, list[SilhouetteView]] = {i: [] for i in symmetries}
    for frame_id in sorted({f for known in chosen.values() for f in known}):
        frame = scene.frame(frame_id)
        placed = {i: T for i, pose in poses.items() if (T := pose(frame_id)) is not None}
        image = scene.read_color(frame)
        for i in (k for k in symmetries if frame_id in chosen[k]):
            if cancelled():
                return {}
            others = [(surfaces[k], T) for k, T in placed.items() if k != i and k in surfaces]
            view = SilhouetteView.cut(
                frame_id,
                image,
                scene.camera(frame),
                surfaces[i],
                placed[i],
                others,
                reach_m=LARGEST_SHIFT_M,
            )
            if view is not None:
                views[i].append(view)
    ranks: dict[int, PoseRank] = {}
    for i, symmetry in symmetries.items():
        if cancelled():
            break
        ranks[i] = _rank(views[i], surfaces[i], symmetry, count, seed, cancelled)
    return ranks


def _in_view(
    scene: Scene, frame_id: int, pose: Callable[[int], SE3 | None], surface: SampledSurface
) -> bool:
    """Whether the centre of an object is inside the image of a frame."""
    T = pose(frame_id)
    if T is None or (centre := T @ surface.centre)[2] <= 0:
        return False
    camera = scene.camera(scene.frame(frame_id))
    uv = camera.project(centre)
    return bool(((uv >= 0) & (uv < camera.size)).all())


def _spread(frames: Sequence[int], count: int) -> list[int]:
    """At most `count` of the frames, evenly spread."""
    picks = np.linspace(0, len(frames) - 1, min(len(frames), count)).round().astype(int)
    return [frames[k] for k in picks]


def _rank(
    views: Sequence[SilhouetteView],
    surface: SampledSurface,
    symmetry: Symmetry,
    count: int,
    seed: int,
    cancelled: Callable[[], bool],
) -> PoseRank:
    limits = RankSettings.current()
    own = [view.measure(surface, view.pose) for view in views]
    kept = [k for k, measured in enumerate(own) if measured is not None]
    views = [views[k] for k in kept]
    base = [m for m in own if m is not None]
    ids = tuple(v.frame for v in views)
    if not views:
        return PoseRank(0, 0, (), (), -1.0, 0.0)
    mine = np.array([m.score for m in base])
    near: list[Array] = []
    for change in _perturbations(surface, symmetry, count, seed):
        if cancelled():
            break
        scores = _scores(views, base, surface, change)
        if scores is not None:
            near.append(scores)
    if not near:
        return PoseRank(0, 0, ids, (), -1.0, float(mine.mean()))
    table = np.stack(near)
    telling = tuple(
        i for k, i in enumerate(ids) if (table[:, k] < mine[k]).mean() >= limits.frame_share
    )
    beaten = int((table.mean(axis=1) < mine.mean()).sum())
    found = PoseRank(beaten, len(near), ids, telling, -1.0, float(mine.mean()))
    if not found.good:
        return found
    rival = _rival(views, base, surface, symmetry, np.random.default_rng(seed), cancelled)
    return replace(found, rival=rival)


def _scores(
    views: Sequence[SilhouetteView],
    base: Sequence[MeasuredContour],
    surface: SampledSurface,
    change: SE3,
    *,
    distinct: bool = True,
) -> Array | None:
    """Scores of a changed pose in the views, (V,); None if `distinct` and it looks the same."""
    limits = RankSettings.current()
    found = [v.measure(surface, v.pose @ change) for v in views]
    apart = [
        limits.same + 1 if f is None else v.distance(f) for v, f in zip(views, found, strict=True)
    ]
    if distinct and max(apart) < limits.same:
        return None
    least = [0.7 * b.points for b in base]
    # A contour that is mostly hidden is measured on fewer points, but counts as the whole.
    return np.array(
        [
            0.0 if f is None else f.score * min(1.0, f.points / n)
            for f, n in zip(found, least, strict=True)
        ]
    )


def _rival(
    views: Sequence[SilhouetteView],
    base: Sequence[MeasuredContour],
    surface: SampledSurface,
    symmetry: Symmetry,
    random: np.random.Generator,
    cancelled: Callable[[], bool],
) -> float:
    """Best score of a pose that is turned far, minus that of the pose; both locally improved."""
    picks = _spread(range(len(views)), _RIVAL_FRAMES)
    views, base = [views[k] for k in picks], [base[k] for k in picks]

    def score(change: SE3) -> float:
        scores = _scores(views, base, surface, change, distinct=False)
        return 0.0 if scores is None else float(scores.mean())

    def climb(change: SE3) -> tuple[float, SE3]:
        best, size = score(change), 1.0
        for k in range(_CLIMB):
            step = surface.about_centre(
                so3_exp(_in_ball(random) * _STEP_TURN * size), _in_ball(random) * _STEP_M * size
            )
            value = score(change @ step)
            if value > best:
                best, change = value, change @ step
            if k % 25 == 24:
                size *= 0.6
        return best, change

    starts: list[SE3] = []
    for change in sorted(_wide_turns(surface, symmetry), key=score, reverse=True):
        if cancelled() or len(starts) == _CLIMBS:
            break
        if all(rotation_error(change, s, symmetry) > _WIDE_TURNS[0] - 0.01 for s in starts):
            starts.append(change)
    own, _ = climb(SE3.identity())
    found = [-1.0]
    for start in starts:
        value, change = climb(start)
        apart = rotation_error(change, SE3.identity(), symmetry) >= RankSettings.current().far_turn
        if apart and _scores(views, base, surface, change) is not None:
            found.append(value - own)
    return max(found)


def _perturbations(surface: SampledSurface, symmetry: Symmetry, count: int, seed: int) -> list[SE3]:
    """Changes of a pose, T_obj_changed, up to `LARGEST_SHIFT_M` and `LARGEST_TURN`."""
    random = np.random.default_rng(seed)
    changes = []
    for _ in range(count):
        shift = _in_ball(random) * LARGEST_SHIFT_M
        turn = _without_symmetry(_in_ball(random) * LARGEST_TURN, symmetry)
        changes.append(surface.about_centre(so3_exp(turn), shift))
    return changes


def _wide_turns(surface: SampledSurface, symmetry: Symmetry) -> list[SE3]:
    changes = []
    for axis in np.eye(3):
        for angle in (*_WIDE_TURNS, *-_WIDE_TURNS):
            turn = _without_symmetry(axis * angle, symmetry)
            if np.linalg.norm(turn) >= _WIDE_TURNS[0] - 1e-6:
                changes.append(surface.about_centre(so3_exp(turn), np.zeros(3)))
    return changes


def _in_ball(random: np.random.Generator) -> Array:
    way = random.normal(size=3)
    return np.asarray(way / np.linalg.norm(way) * random.uniform() ** (1 / 3))


def _without_symmetry(turn: Array, symmetry: Symmetry) -> Array:
    """The part of a rotation vector that is across all symmetry axes."""
    if symmetry.is_spherical:
        return np.zeros(3)
    for axis, _ in symmetry.continuous:
        a = np.asarray(axis) / np.linalg.norm(axis)
        turn = turn - (turn @ a) * a
    return turn
