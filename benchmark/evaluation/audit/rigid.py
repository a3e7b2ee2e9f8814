"""Which frames show objects that do not move against each other, and how well their labels say so.

The judge measures a label in several frames at once where objects stand still and the camera moves.
Camera poses are those of the set if its labels agree with them. Otherwise they follow from the
labels: those of all objects of a frame move together. Frames of which neither holds, or in which
the camera hardly moves, stand alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Literal

import numpy as np

from benchmark.data.labelled import LabelledFrame, LabelledObject
from std_toolkit.arrays import Array
from std_toolkit.geometry import SE3, Symmetry, rotation_error, umeyama
from std_toolkit.geometry.mesh import mesh_bounds
from std_toolkit.geometry.symmetry import nearest_variant
from std_toolkit.settings import Settings, limit

Cameras = Literal["of the set", "from the labels", "none"]
_ROUNDS, _MOST_PAIRS = 3, 30


@dataclass(frozen=True, kw_only=True)
class StillSettings(Settings):
    """When labels of several frames are those of a scene that stands still."""

    off_mm: float = limit(
        2.0, unit="mm", source="a fit to coordinates of 8 bits is up to 0.8 mm off"
    )
    """largest median over labels of how far the corners of an object lie from its place"""
    fewest_frames: int = limit(4, source="`motion.fewest_frames` of the judge")
    """frames that a scene needs"""
    parallax_deg: float = limit(
        5.0, unit="deg", source="frames of a camera that stands still repeat one measurement"
    )
    """smallest angle between two views of the objects"""


@dataclass(frozen=True, eq=False)
class Thing:
    """An object of a scene over its frames.

    Attributes:
        label: its label in the first frame that has one.
        corners: (8, 3) of its bounding box, or about its origin where it has no mesh.
        T_cam_obj: its labels by frame.
    """

    label: LabelledObject
    corners: Array
    T_cam_obj: Mapping[int, SE3]

    @property
    def symmetry(self) -> Symmetry:
        return self.label.symmetry.symmetry()

    @property
    def centre(self) -> Array:
        """(3,) centre of the box."""
        return np.asarray(self.corners.mean(axis=0))


@dataclass(frozen=True, eq=False)
class Group:
    """Frames that are judged together.

    Attributes:
        frames: those of a scene that stands still, or a single one.
        things: its objects by name.
        cameras: where the camera poses come from.
        T_world_cam: by frame; the identity of a single one.
        T_world_obj: by name.
        off: distance of the centre in mm and angle in degrees of each label from its object's
            place, by frame and name; empty for a single frame.
    """

    frames: Sequence[LabelledFrame]
    things: Mapping[str, Thing]
    cameras: Cameras
    T_world_cam: Mapping[int, SE3]
    T_world_obj: Mapping[str, SE3]
    off: Mapping[tuple[int, str], tuple[float, float]] = field(default_factory=dict)


def groups_of(frames: Sequence[LabelledFrame]) -> list[Group]:
    """The frames of one scene in groups that can be judged: runs that stand still, or each alone.

    Raises:
        ToolkitError: a mesh is damaged.
    """
    given = {f.index: f.T_world_cam for f in frames if f.T_world_cam is not None}
    if len(given) == len(frames):
        parts = _segments(frames, things_of(frames), given)
        found = [_still(part, things_of(part), given, "of the set") for part in parts]
        if all(g is not None for g in found):
            return [g for g in found if g is not None]
    groups = []
    for run in _runs(frames, things_of(frames)):
        cameras = _cameras_by_labels(run, things_of(run))
        parts = [run] if cameras is None else _segments(run, things_of(run), cameras)
        for part in parts:
            mine = things_of(part)
            if len(parts) > 1:
                cameras = _cameras_by_labels(part, mine)
            still = None if cameras is None else _still(part, mine, cameras, "from the labels")
            kept = set() if still is None else {f.index for f in still.frames}
            groups += [] if still is None else [still]
            groups += [_alone(f, mine) for f in part if f.index not in kept]
    return groups


def _segments(
    frames: Sequence[LabelledFrame], things: Mapping[str, Thing], cameras: Mapping[int, SE3]
) -> list[list[LabelledFrame]]:
    """The frames cut where an object was moved: two frames that follow agree on a new place.

    A label that is off in one frame alone is no move.
    """
    far = 2 * StillSettings.current().off_mm / 1000
    cuts = set()
    for thing in things.values():
        seen = [f.index for f in frames if f.index in thing.T_cam_obj and f.index in cameras]
        poses = [cameras[f] @ thing.T_cam_obj[f] for f in seen]
        place = poses[0] if poses else None
        for pose, after, index in zip(poses[1:], poses[2:], seen[1:], strict=False):
            assert place is not None
            if _apart(thing, pose, place) > far >= _apart(thing, after, pose):
                cuts.add(index)
                place = pose
    parts: list[list[LabelledFrame]] = [[]]
    for frame in frames:
        if frame.index in cuts and parts[-1]:
            parts.append([])
        parts[-1].append(frame)
    return parts


def _apart(thing: Thing, a: SE3, b: SE3) -> float:
    """Mean distance in metres of the corners of two poses, over symmetries."""
    near = nearest_variant(a, b, thing.corners, thing.symmetry)
    return float(np.linalg.norm(near @ thing.corners - b @ thing.corners, axis=1).mean())


def _still(
    frames: Sequence[LabelledFrame],
    things: Mapping[str, Thing],
    cameras: Mapping[int, SE3],
    name: Cameras,
) -> Group | None:
    """The frames as a scene that stands still; None if it does not, or cannot be measured so."""
    limits = StillSettings.current()
    kept = [f for f in frames if f.index in cameras]
    if len(kept) < limits.fewest_frames:
        return None
    placed = {n: _place(t, cameras) for n, t in things.items()}
    off = [o for n, t in things.items() for o in _corners_off(t, placed[n], cameras)]
    if not off or 1000 * float(np.median(off)) > limits.off_mm:
        return None
    if _parallax_deg(cameras, things, placed) < limits.parallax_deg:
        return None
    beside = {
        (f, n): _beside(t, placed[n], cameras[f] @ T)
        for n, t in things.items()
        for f, T in t.T_cam_obj.items()
        if f in cameras
    }
    return Group(kept, things, name, cameras, placed, beside)


def _runs(
    frames: Sequence[LabelledFrame], things: Mapping[str, Thing]
) -> list[list[LabelledFrame]]:
    """Frames that follow each other, cut where objects were moved against each other."""
    runs: list[list[LabelledFrame]] = []
    for frame in frames:
        if runs and _moved_alike(runs[-1][-1], frame, things):
            runs[-1].append(frame)
        else:
            runs.append([frame])
    return runs


def _moved_alike(a: LabelledFrame, b: LabelledFrame, things: Mapping[str, Thing]) -> bool:
    """Whether one motion of the camera explains the labels of two frames."""
    before = {o.name: o.T_cam_obj for o in a.objects}
    both = [o for o in b.objects if o.name in before]
    if len(both) < 2:
        return False
    corners = np.stack([things[o.name].corners for o in both])
    there = np.stack([before[o.name] @ c for o, c in zip(both, corners, strict=True)])
    motion: SE3 | None = None
    here = there
    for _ in range(2):
        poses = [o.T_cam_obj for o in both]
        if motion is not None:
            back = motion.inverse()
            poses = [
                back
                @ nearest_variant(motion @ o.T_cam_obj, before[o.name], c, things[o.name].symmetry)
                for o, c in zip(both, corners, strict=True)
            ]
        here = np.stack([T @ c for T, c in zip(poses, corners, strict=True)])
        motion = _fitted(here, there)
    assert motion is not None
    off = _off(motion, here, there)
    return 1000 * float(np.median(off)) <= StillSettings.current().off_mm


def things_of(frames: Sequence[LabelledFrame]) -> dict[str, Thing]:
    """The objects of a scene by name."""
    labels: dict[str, LabelledObject] = {}
    poses: dict[str, dict[int, SE3]] = {}
    for frame in frames:
        for item in frame.objects:
            labels.setdefault(item.name, item)
            poses.setdefault(item.name, {})[frame.index] = item.T_cam_obj
    return {n: Thing(o, _box(o), poses[n]) for n, o in labels.items()}


def _alone(frame: LabelledFrame, things: Mapping[str, Thing]) -> Group:
    poses = {o.name: o.T_cam_obj for o in frame.objects}
    shown = {n: things[n] for n in poses}
    return Group([frame], shown, "none", {frame.index: SE3.identity()}, poses)


def _box(item: LabelledObject) -> Array:
    low, high = np.full(3, -0.05), np.full(3, 0.05)
    if item.mesh is not None:
        low, high = mesh_bounds(item.mesh.load())
    return np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1])
                     for z in (low[2], high[2])])  # fmt: skip


def _cameras_by_labels(
    frames: Sequence[LabelledFrame], things: Mapping[str, Thing]
) -> dict[int, SE3] | None:
    """Camera poses under which the labels of each frame lie best at the places of the objects."""
    if len(things) < 2:
        return None
    first = max(things.values(), key=lambda t: (len(t.T_cam_obj), t.symmetry.is_trivial))
    cameras = {f: T.inverse() for f, T in first.T_cam_obj.items()}
    for _ in range(_ROUNDS):
        placed = {n: _place(t, cameras) for n, t in things.items()
                  if any(f in cameras for f in t.T_cam_obj)}  # fmt: skip
        for frame in frames:
            world, seen = [], []
            for item in frame.objects:
                if item.name not in placed:
                    continue
                thing = things[item.name]
                there = placed[item.name]
                here = item.T_cam_obj
                if frame.index in cameras:
                    camera = cameras[frame.index]
                    near = nearest_variant(camera @ here, there, thing.corners, thing.symmetry)
                    here = camera.inverse() @ near
                world.append(there @ thing.corners)
                seen.append(here @ thing.corners)
            # One object alone would follow its own label.
            if len(world) < 2:
                cameras.pop(frame.index, None)
                continue
            cameras[frame.index] = _fitted(np.stack(seen), np.stack(world))
    enough = len(cameras) >= StillSettings.current().fewest_frames
    return cameras if enough else None


def _fitted(here: Array, there: Array) -> SE3:
    """The rigid motion (N, 8, 3) -> (N, 8, 3) of most objects, those that are off left out.

    Least squares, or least absolute distances, would turn about the axis through two objects to
    please a third one. Pairs of objects therefore propose motions, and the median decides.
    """
    pairs = list(combinations(range(len(here)), 2))
    step = -(-len(pairs) // _MOST_PAIRS)
    found = [_off(_fit(here[list(p)], there[list(p)]), here, there) for p in pairs[::step]]
    best = min(found, key=lambda off: (float(np.median(off)), float(off.sum())))
    limit_m = max(2 * float(np.median(best)), StillSettings.current().off_mm / 1000)
    kept = best <= limit_m
    return _fit(here[kept], there[kept])


def _fit(here: Array, there: Array) -> SE3:
    fit = umeyama(here.reshape(-1, 3), there.reshape(-1, 3), with_scale=False)
    return SE3(fit.R, fit.t)


def _off(motion: SE3, here: Array, there: Array) -> Array:
    """(N,) mean distances in metres of the corners."""
    return np.asarray(np.linalg.norm(motion @ here - there, axis=2).mean(axis=1))


def _place(thing: Thing, cameras: Mapping[int, SE3]) -> SE3:
    """The pose in the world that is nearest to those of all frames."""
    poses = [cameras[f] @ T for f, T in thing.T_cam_obj.items() if f in cameras]
    if not poses:
        return next(iter(thing.T_cam_obj.values()))
    if not thing.symmetry.is_trivial:
        poses = [nearest_variant(T, poses[0], thing.corners, thing.symmetry) for T in poses]
    corners = np.stack([T @ thing.corners for T in poses])
    apart = np.linalg.norm(corners[:, None] - corners[None], axis=3).mean(axis=2)
    return poses[int(np.argmin(apart.sum(axis=1)))]


def _corners_off(thing: Thing, place: SE3, cameras: Mapping[int, SE3]) -> list[float]:
    """Mean distance in metres of the corners from their place, by frame."""
    return [
        _apart(thing, cameras[f] @ T, place) for f, T in thing.T_cam_obj.items() if f in cameras
    ]


def _beside(thing: Thing, place: SE3, pose: SE3) -> tuple[float, float]:
    near = nearest_variant(pose, place, thing.corners, thing.symmetry)
    mm = 1000 * float(np.linalg.norm(near @ thing.centre - place @ thing.centre))
    return mm, float(np.rad2deg(rotation_error(pose, place, thing.symmetry)))


def _parallax_deg(
    cameras: Mapping[int, SE3], things: Mapping[str, Thing], placed: Mapping[str, SE3]
) -> float:
    """Largest angle between two views of the middle of the objects."""
    middle = np.mean([placed[n] @ t.centre for n, t in things.items()], axis=0)
    rays = np.array([T.t - middle for T in cameras.values()])
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-9)
    return float(np.rad2deg(np.arccos(np.clip(rays @ rays.T, -1, 1)).max()))
