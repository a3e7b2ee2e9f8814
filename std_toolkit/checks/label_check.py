"""Judges labels while they change, by the measurements and the judge of `run_check`.

Nothing is written. What was measured of a pose is kept, so that after an edit only the object that
moved is measured again.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from std_toolkit.checks.gates.judge import judge_scene
from std_toolkit.checks.judgements import judgement_of
from std_toolkit.checks.measure.contours import LabelCaster
from std_toolkit.checks.measure.coverage import scene_up, spread
from std_toolkit.checks.measure.residuals import FrameObservation, measure_frame
from std_toolkit.checks.measure.textures import TextureFinding, compare_textures
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.io.documents import utc_text
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Frame, Scene
from std_toolkit.scene.judgement import Judgement
from std_toolkit.scene.label_verdicts import judgement_inputs, judgement_limits
from std_toolkit.settings import Settings, limit


@dataclass(frozen=True, kw_only=True)
class LabelCheckSettings(Settings):
    """How much is measured while labels are edited."""

    most_frames: int = limit(40, source="a verdict within 10 s of an edit at 1280x720")
    """evenly spaced frames in which contours are measured; `std-curate check` takes all"""


@dataclass(eq=False)
class _Known:
    """Measurements of one frame, each with what it was made of."""

    observed: FrameObservation | None
    of: dict[int, Any]
    problem: str = ""


@dataclass(frozen=True, eq=False)
class JudgedLabel:
    """What is known of a label.

    Attributes:
        judgement: the verdict; its poses are `T_world_obj`.
        texture: what the texture says; None for a mesh that cannot be read.
    """

    judgement: Judgement
    texture: TextureFinding | None


class LabelCheck:
    """Judges the labels of versions of one scene; may be used by several threads.

    Args:
        options: limits; by default those of `std-curate check`. Also an attribute.
    """

    def __init__(self, options: CheckOptions | None = None) -> None:
        self.options = options or CheckOptions()
        self._frames: dict[int, _Known] = {}
        self._textures: dict[int, tuple[Any, TextureFinding]] = {}
        self._caster: tuple[Any, LabelCaster] | None = None
        self._lock = threading.Lock()

    def measure(
        self,
        scene: Scene,
        *,
        seconds: float = float("inf"),
        cancelled: Callable[[], bool] = lambda: False,
    ) -> bool:
        """Measure the contours of all labels where this was not done at their poses.

        Args:
            scene: a version of the scene, such as a `MemoryScene`.
            seconds: return after the first frame that ends later; call it again to go on.
            cancelled: polled between frames.

        Returns:
            Whether everything is measured.
        """
        end = time.monotonic() + seconds
        for frame in self._chosen(scene):
            with self._lock:
                missing = self._missing(scene, frame)
                if not missing:
                    continue
                if cancelled() or time.monotonic() >= end:
                    return False
                self._measure(scene, frame, missing)
        return True

    def compare(self, scene: Scene, object_id: int) -> TextureFinding | None:
        """Compare the texture of one label with the images, unless that was done at its pose.

        Returns:
            None for a label without a readable mesh.
        """
        of = _subject(scene, object_id)
        with self._lock:
            known = self._textures.get(object_id)
            if known is not None and known[0] == of:
                return known[1]
            frames = scene.registered_frames()
            found = compare_textures(scene, frames, only=[object_id]).get(object_id)
            if found is not None:
                self._textures[object_id] = of, found
            return found

    def judge(self, scene: Scene, objects: Collection[int]) -> dict[int, JudgedLabel]:
        """Judge labels by what is measured; measures what is missing.

        Args:
            scene: a version of the scene.
            objects: ids of labelled objects; their textures count.

        Returns:
            By object id.
        """
        self.measure(scene)
        compared = {i: f for i in objects if (f := self.compare(scene, i)) is not None}
        with self._lock:
            known = {f.id: self._frames[f.id] for f in self._chosen(scene)}
        problems = {i: k.problem for i, k in known.items() if k.problem}
        poses = [T for f in scene.registered_frames() if (T := scene.T_world_cam(f.id)) is not None]
        report = judge_scene(
            scene,
            [_placed(k.observed, scene) for k in known.values() if k.observed is not None],
            problems,
            self.options,
            up=scene_up(poses, None),
            compared=compared,
            only=objects,
        )
        limits = judgement_limits(self.options.label_limits())
        inputs = judgement_inputs(scene, limits)
        now = utc_text()
        found = {}
        for item in report.objects:
            label = scene.labels.of(item.object)
            if item.object not in objects or label is None or label.T_world_obj is None:
                continue
            texture = compared.get(item.object)
            inputs_of = inputs[item.object]
            judgement = judgement_of(item, report, label, inputs_of, limits, now, texture)
            found[item.object] = JudgedLabel(judgement, texture)
        return found

    def _chosen(self, scene: Scene) -> Sequence[Frame]:
        return spread(scene.registered_frames(), LabelCheckSettings.current().most_frames)

    def _missing(self, scene: Scene, frame: Frame) -> list[int]:
        """Ids of the labels that were not measured in a frame at their poses."""
        known = self._frames.get(frame.id)
        camera = _numbers(scene.T_world_cam(frame.id))
        placed = [o.id for o in scene.objects.objects if scene.T_world_obj(o.id) is not None]
        if known is None:
            return placed
        if known.problem:
            return []
        return [i for i in placed if known.of.get(i) != (camera, _subject(scene, i))]

    def _measure(self, scene: Scene, frame: Frame, missing: Sequence[int]) -> None:
        camera = _numbers(scene.T_world_cam(frame.id))
        try:
            new = measure_frame(scene, self._cast(scene), frame, self.options, only=missing)
        except ToolkitError as error:
            self._frames[frame.id] = _Known(None, {}, str(error))
            return
        old = self._frames.get(frame.id)
        of = dict(old.of) if old is not None else {}
        objects, tallies = dict(new.objects), dict(new.tallies)
        if old is not None and old.observed is not None:
            objects |= {i: x for i, x in old.observed.objects.items() if i not in missing}
            tallies |= {i: x for i, x in old.observed.tallies.items() if i not in missing}
        of |= {i: (camera, _subject(scene, i)) for i in missing}
        self._frames[frame.id] = _Known(replace(new, objects=objects, tallies=tallies), of)

    def _cast(self, scene: Scene) -> LabelCaster:
        of = {o.id: _subject(scene, o.id) for o in scene.objects.objects}
        if self._caster is None or self._caster[0] != of:
            self._caster = of, LabelCaster.of_scene(scene)
        return self._caster[1]


def _placed(observed: FrameObservation, scene: Scene) -> FrameObservation:
    """The observation without objects that have no label any more."""
    known = {o.id for o in scene.objects.objects if scene.T_world_obj(o.id) is not None}
    return replace(
        observed,
        objects={i: x for i, x in observed.objects.items() if i in known},
        tallies={i: x for i, x in observed.tallies.items() if i in known},
    )


def _subject(scene: Scene, object_id: int) -> Any:
    """What a measurement of a label depends on, besides camera and images."""
    item = scene.objects.object(object_id)
    model = scene.objects.model(item.model)
    return item.material, model, _numbers(scene.T_world_obj(object_id))


def _numbers(T: SE3 | None) -> bytes | None:
    return None if T is None else np.asarray(T.matrix(), dtype=np.float64).tobytes()
