"""What speaks for a wrong camera pose, and what for objects that moved, in single frames.

A camera pose is wrong only where several objects moved as if the camera had, or the surroundings
put the camera elsewhere (`scene_points`). Objects that lie elsewhere in other frames moved. With
one object, and surroundings that say nothing, the two cannot be told apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.checks.measure.aggregate import AggregateSettings
from std_toolkit.checks.measure.contours import LabelCaster, mesh_problem, object_centre
from std_toolkit.checks.measure.frame_motion import Displaced, ObjectFrames
from std_toolkit.checks.measure.motion_solver import symmetry_motions
from std_toolkit.checks.measure.residuals import FrameObservation
from std_toolkit.checks.measure.scene_points import CameraEvidence, ScenePoints
from std_toolkit.checks.measure.shared_errors import seen_errors
from std_toolkit.checks.measure.wide_search import SearchedView
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Scene
from std_toolkit.settings import Settings, limit


@dataclass(frozen=True, kw_only=True)
class FrameEvidenceSettings(Settings):
    """How much is looked at again, and when objects agree on a camera."""

    most_frames: int = limit(12, source="a frame costs as much as the labels of ten")
    """frames whose surroundings are compared"""
    share_of_frames: float = limit(0.05, source="the time of the check stays linear")
    """the same as a share of the frames, where that is more"""
    seen_least: float = limit(
        0.6, source="where a camera is 30 mm off, objects of steel or glass keep up to a half"
    )
    """frames in which no object has this part of its usual likelihood are asked about, too"""
    most_seen_least: int = limit(3, source="right frames cost time, and are seldom seen so badly")
    """largest number of these"""
    most_runs: int = limit(4, source="a search costs as much as the labels of ten frames")
    """runs of frames in which each object is looked for"""
    agreement: float = limit(0.3, source="one frame measures the distance weakly")
    """part of its displacement by which an object may miss what a camera explains"""


@dataclass(frozen=True)
class FrameEvidence:
    """Faults of single frames.

    Attributes:
        camera: what is wrong with a camera pose in words, by frame id.
        displaced: runs of frames in which an object lies elsewhere, by object id; those with a
            wrong camera pose are left out.
        right: ids of the frames in which the surroundings or other objects confirm the camera.
        unseen: frames that do not show an object at its label nor elsewhere, by object id.
    """

    camera: Mapping[int, str] = field(default_factory=dict)
    displaced: Mapping[int, Sequence[Displaced]] = field(default_factory=dict)
    right: frozenset[int] = frozenset()
    unseen: Mapping[int, Sequence[int]] = field(default_factory=dict)


def frame_evidence(
    scene: Scene, observed: Sequence[FrameObservation], options: CheckOptions
) -> FrameEvidence:
    """Find the frames that contradict the other frames of their objects.

    Args:
        scene: the scene that was measured.
        observed: the measured frames.
        options: limits.
    """
    return _Suspects(scene, observed, options).evidence()


class _Suspects:
    def __init__(
        self, scene: Scene, observed: Sequence[FrameObservation], options: CheckOptions
    ) -> None:
        self.scene, self.options = scene, options
        self.observed = {f.frame: f for f in observed}
        self.objects: dict[int, ObjectFrames] = {}
        self._likelihood: dict[int, float] = {}
        seen = AggregateSettings.current().judged_fraction
        for item in scene.objects.objects:
            T_world_obj = scene.T_world_obj(item.id)
            if T_world_obj is None or mesh_problem(scene, item.model) is not None:
                continue
            symmetry = scene.objects.model(item.model).symmetry.symmetry()
            shown = [
                (f.frame, o)
                for f in observed
                if (o := f.objects.get(item.id)) and o.visible_fraction >= seen
            ]
            centre = object_centre(scene, item.id)
            found = ObjectFrames(
                shown,
                symmetry_motions(symmetry, T_world_obj, centre),
                smallest_mm=options.max_motion_mm,
                cameras=seen_errors(scene, [f for f, _ in shown], centre),
            )
            if found.tells:
                self.objects[item.id] = found
            for f, part in zip(found.frames, found.part, strict=False):
                known = self._likelihood.get(f.frame, -np.inf)
                self._likelihood[f.frame] = max(float(part), known)
        self.camera: dict[int, str] = {}
        self.right: set[int] = set()

    def evidence(self) -> FrameEvidence:
        """All of it; images are read again only where a frame contradicts the others."""
        if self._seen_least or any(o.displaced or o.unfit for o in self.objects.values()):
            caster = LabelCaster.of_scene(self.scene)
            self._ask_surroundings(caster)
            for i, found in self.objects.items():
                found.leave_out(self.camera)
                if found.unfit:
                    self._look_for(i, found, caster)
            self._ask_objects()
        return FrameEvidence(
            self.camera,
            {i: o.displaced for i, o in self.objects.items() if o.displaced},
            frozenset(self.right),
            {i: o.unfit for i, o in self.objects.items() if o.unfit},
        )

    def _off(self) -> dict[int, set[int]]:
        """Objects that are not at their labels, by frame id."""
        off: dict[int, set[int]] = {}
        for i, found in self.objects.items():
            for frame in (*found.unfit, *(f for d in found.displaced for f in d.frames)):
                off.setdefault(frame, set()).add(i)
        return off

    @cached_property
    def _seen_least(self) -> list[int]:
        """Frames whose camera pose may be wrong though no object says so, the likeliest first.

        Reflections and refraction show something everywhere, so that steel and glass fit badly in
        all frames or in none. Their surroundings say more.
        """
        limits = FrameEvidenceSettings.current()
        # Where no object tells of frames, nothing else does.
        below = limits.seen_least if self.objects else np.inf
        low = [f for f, part in self._likelihood.items() if part < below]
        return sorted(low, key=lambda f: self._likelihood[f])[: limits.most_seen_least]

    def _ask_surroundings(self, caster: LabelCaster) -> None:
        limits = FrameEvidenceSettings.current()
        off = self._off()
        for frame, objects in off.items():
            # A camera that is wrong moves all objects.
            if sum(frame in o.fits for o in self.objects.values()) >= len(objects):
                self.right.add(frame)
        runs = _runs(sorted(set(off) - self.right), list(self.observed))
        most = max(limits.most_frames, round(limits.share_of_frames * len(self.observed)))
        points = ScenePoints(self.scene, caster)
        answers: dict[int, CameraEvidence] = {}
        asked = _ends_first(runs)[:most]
        asked += [f for f in self._seen_least if f not in off]
        for frame in asked:
            # Neighbours within a run agree with each other if an object was moved.
            answers[frame] = points.judge(frame, (off.keys() | set(asked)) - self.right)
            if answers[frame].verdict == "wrong":
                e = answers[frame]
                self.camera[frame] = f"{e.mm:.0f} mm and {e.deg:.1f} deg off by its surroundings"
        self.right |= {f for f, e in answers.items() if e.verdict == "right"}
        for run in runs:
            known = [answers[f].verdict for f in run if f in answers]
            if known and all(v == "right" for v in known):
                self.right.update(run)

    def _look_for(self, object_id: int, found: ObjectFrames, caster: LabelCaster) -> None:
        T = self.scene.T_world_obj(object_id)
        assert T is not None

        def view(frame_id: int) -> SearchedView | None:
            frame = self.scene.frame(frame_id)
            T_world_cam = self.scene.T_world_cam(frame_id)
            measured = self.observed[frame_id].objects[object_id].T_world_obj
            try:
                image = self.scene.read_color(frame)
            except ToolkitError:
                return None
            if T_world_cam is None or measured is None:
                return None
            # The label that was measured may be another one than that of the scene.
            change = measured @ T.inverse()
            return SearchedView.of_image(
                image,
                caster,
                object_id,
                self.scene.camera(frame),
                change.inverse() @ T_world_cam,
                reach_px=self.options.search_px,
            )

        found.search(view, FrameEvidenceSettings.current().most_runs)

    def _ask_objects(self) -> None:
        """Accuse the cameras that explain the motions of several objects."""
        single: dict[int, dict[int, Displaced]] = {}
        for i, found in self.objects.items():
            for run in found.displaced:
                for frame in run.frames:
                    single.setdefault(frame, {})[i] = run
        for frame, runs in single.items():
            if frame not in self.right and len(runs) >= 2 and self._agree(frame, runs):
                self.camera[frame] = f"{len(runs)} objects moved as if the camera had"
        for found in self.objects.values():
            found.leave_out(self.camera)

    def _agree(self, frame: int, runs: Mapping[int, Displaced]) -> bool:
        """Whether one motion of the camera explains those of all objects in a frame."""
        limits = FrameEvidenceSettings.current()
        T_world_cam = self.scene.T_world_cam(frame)
        assert T_world_cam is not None
        A, b = np.eye(6) * 1e-6, np.zeros(6)
        for i, run in runs.items():
            J = _seen_motion(object_centre(self.scene, i), T_world_cam)
            weight = np.linalg.inv(run.covariance + np.diag([1e-6] * 3 + [1e-3] * 3))
            A += J.T @ weight @ J
            b += J.T @ weight @ run.motion
        camera = np.linalg.solve(A, b)
        for i, found in self.objects.items():
            expected = _seen_motion(object_centre(self.scene, i), T_world_cam) @ camera
            if i in runs:
                missed = found.shift_mm(frame, runs[i].motion - expected)
                tolerance = max(self.options.max_motion_mm, limits.agreement * runs[i].mm)
            elif frame in found.fits:
                missed, tolerance = found.shift_mm(frame, expected), self.options.max_motion_mm
            else:
                continue
            if missed > tolerance:
                return False
        return True


def _seen_motion(centre: Array, T_world_cam: SE3) -> Array:
    """(6, 6) motion of an object at a place that is seen if the camera moves by a twist."""
    x, y, z = centre - T_world_cam.t
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    # The camera's translation, and its rotation about its own centre, along the world's axes.
    return np.block([[-np.eye(3), cross], [np.zeros((3, 3)), -np.eye(3)]])


def _runs(frames: Sequence[int], order: Sequence[int]) -> list[list[int]]:
    """Frames that follow each other in the recording."""
    place = {f: k for k, f in enumerate(order)}
    runs: list[list[int]] = []
    for f in frames:
        if runs and place[f] == place[runs[-1][-1]] + 1:
            runs[-1].append(f)
        else:
            runs.append([f])
    return runs


def _ends_first(runs: Sequence[Sequence[int]]) -> list[int]:
    """All frames, the first and the last of each run before those between."""
    ends = [f for run in runs for f in dict.fromkeys((run[0], run[-1]))]
    return ends + [f for run in runs for f in run[1:-1]]
