"""One object in a few images at a time, wherever its label may be displaced to."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.checks.measure.contours import NOTHING, LabelCaster
from std_toolkit.checks.measure.edges import noise_level, smooth_image
from std_toolkit.checks.measure.motion import MotionEquations
from std_toolkit.checks.measure.motion_solver import Motion, solve_motion
from std_toolkit.checks.measure.shared_errors import chance_likelihood
from std_toolkit.checks.measure.wide_search import SearchedView
from std_toolkit.errors import ToolkitError
from std_toolkit.labels.refine.problem import RefineObject, large_views
from std_toolkit.scene import Frame, Scene

_REACH_PX = 16.0
# Smoothed images in memory; neighbouring objects are compared in the same frames.
_IMAGES = 8


class ObjectViews:
    """Views of single objects of a scene; keeps the images that it read last.

    Args:
        scene: with labels.
        frames: registered frames whose images can be read.

    Attributes:
        frames, poses: the frames, and the poses of their cameras.
    """

    def __init__(self, scene: Scene, frames: Sequence[Frame]) -> None:
        self._scene, self.frames = scene, list(frames)
        self.poses = [T for f in self.frames if (T := scene.T_world_cam(f.id)) is not None]
        self._cameras = [scene.camera(f) for f in self.frames]
        self._images: OrderedDict[int, _Image | None] = OrderedDict()

    @cached_property
    def _all(self) -> LabelCaster:
        return LabelCaster.of_scene(self._scene)

    def large(self, centre: Array, radius: float, count: int) -> list[int]:
        """Indices of the frames that show a ball largest, from all around."""
        return large_views(self._cameras, self.poses, centre, radius, count=count)

    def of_object(
        self, object_id: int, obj: RefineObject, chosen: Sequence[int]
    ) -> dict[int, SearchedView]:
        """The object at its label in the chosen frames, by index; the other labels hide it."""
        world = obj.T_world_obj @ np.asarray(obj.vertices)
        alone = LabelCaster({object_id: (world, np.asarray(obj.faces))})
        return {k: v for k in chosen if (v := self._view(k, object_id, alone)) is not None}

    def _view(self, k: int, object_id: int, alone: LabelCaster) -> SearchedView | None:
        if k not in self._images:
            self._images[k] = self._read(k)
            while len(self._images) > _IMAGES:
                self._images.popitem(last=False)
        self._images.move_to_end(k)
        image = self._images[k]
        if image is None:
            return None
        return SearchedView(
            alone,
            object_id,
            self._cameras[k],
            self.poses[k],
            image.smoothed,
            image.noise,
            _REACH_PX,
            (image.object_id == NOTHING) | (image.object_id == object_id),
        )

    def _read(self, k: int) -> _Image | None:
        try:
            image = self._scene.read_color(self.frames[k])
        except (ToolkitError, OSError):  # the check names the frame
            return None
        camera, pose = self._cameras[k], self.poses[k]
        ids = np.full((camera.height, camera.width), NOTHING, np.int32)
        within = self._all.possible(camera, pose)
        if within.any():
            ids[within] = self._all.cast_pixels(camera, pose, within).object_id
        return _Image(smooth_image(image), noise_level(image), ids)


@dataclass(frozen=True, eq=False)
class _Image:
    """An image with the nearest label of each pixel."""

    smoothed: NDArray[np.float32]
    noise: float
    object_id: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class MeasuredPose:
    """The contours at one pose, by view, and the small motion from there that improves it."""

    equations: dict[int, MotionEquations]
    motion: Motion
    chance: float

    @staticmethod
    def of(views: Mapping[int, SearchedView], motion: Array, free: Array) -> MeasuredPose | None:
        seen = {k: e for k, v in views.items() if (e := v.equations(motion)) is not None}
        found = {k: e.after(motion) for k, e in seen.items()}
        solved = solve_motion(list(found.values()), free)
        if solved is None:
            return None
        return MeasuredPose(found, solved, chance_likelihood(list(found.values()), solved.vector))

    def evidence(self, k: int) -> float:
        """Log likelihood of a view above displaced contours; 0 where the object is not seen."""
        e = self.equations.get(k)
        return 0.0 if e is None else self._above_chance(e, self.motion.vector)

    @property
    def total(self) -> float:
        """Log likelihood of all views above displaced contours."""
        return sum(self.evidence(k) for k in self.equations)

    @property
    def unmoved(self) -> float:
        """The same without the small motion."""
        return sum(self._above_chance(e, np.zeros(6)) for e in self.equations.values())

    def _above_chance(self, e: MotionEquations, motion: Array) -> float:
        return e.independent * (e.likelihood(motion) - self.chance)
