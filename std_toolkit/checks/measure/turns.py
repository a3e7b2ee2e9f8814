"""Whether the contour of an object fits better after a turn of its label.

Where most of a body looks the same after a turn, a label that is turned wrongly fits it well: what
does not fit, such as a handle on the wrong side, is taken for clutter. Each turn with a similar
silhouette is therefore compared with the label as a whole: the log likelihood that the edges of
all contour points gain above displaced contours, both poses locally improved.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from std_toolkit.checks.measure.contours import object_centre
from std_toolkit.checks.measure.motion_solver import symmetry_motions
from std_toolkit.checks.measure.object_views import MeasuredPose, ObjectViews
from std_toolkit.checks.measure.wide_search import SearchedView
from std_toolkit.geometry import SE3, so3_exp, so3_log
from std_toolkit.labels.refine.problem import RefineObject
from std_toolkit.labels.texture.alternatives import Alternative, near_symmetry
from std_toolkit.scene import Frame, Scene
from std_toolkit.settings import Settings, limit

# Frames that are compared, those in which silhouettes are, and those of a first look at turns.
_FRAMES, _SILHOUETTES, _FIRST = 6, 3, 2
# Turns that are looked at, and that pass.
_MOST, _KEPT = 10, 2


@dataclass(frozen=True, kw_only=True)
class TurnSettings(Settings):
    """When the contour speaks for a turn."""

    turned_gain: float = limit(
        5.0,
        unit="nats",
        source="world seeds 400 to 424 of setting kinds: right labels win or lose by 0.5 but for "
        "steel, wrong turns that fit gain 4 to 24",
    )
    """log likelihood of independent samples by which a turn fits clearly better"""
    open_gain: float = limit(
        1.0, unit="nats", source="the same seeds: right labels that are not of steel lose by 0.5"
    )
    """one by which it is open which of the two is right"""
    reflecting: Mapping[str, float] = limit(
        {"specular": 2.0},
        source="reflections have edges of their own: right labels of steel lose by 2.3 on these "
        "seeds, and by 6.9 on seed 569 of judging kinds, which judges no more",
    )
    """factor on both by material"""
    fewest_frames: int = limit(3, source="in one image, a turn and an error of the pose look alike")
    """frames that show the object"""

    def open_of(self, material: str) -> float:
        """`open_gain` of a material."""
        return self.open_gain * self.reflecting.get(material, 1.0)


@dataclass(frozen=True, eq=False)
class TurnByContour:
    """The turn of a label whose contour fits best.

    Attributes:
        material: of the object.
        turn: T_obj_turned, locally improved: `pose @ turn` is its pose.
        text: the turn in words.
        gain: log likelihood by which it exceeds the label; negative: the label fits better.
        telling: ids of the frames in which the two differ most, the best first.
    """

    material: str
    turn: SE3
    text: str
    gain: float
    telling: tuple[int, ...]

    @property
    def is_better(self) -> bool:
        """Whether the turn fits clearly better than the label."""
        return self._share >= TurnSettings.current().turned_gain

    @property
    def is_open(self) -> bool:
        """Whether the contour leaves open which of the two poses is right."""
        return self._share >= TurnSettings.current().open_gain and not self.is_better

    @property
    def _share(self) -> float:
        return self.gain / TurnSettings.current().reflecting.get(self.material, 1.0)


class TurnComparison:
    """Compares labels of a scene with turns of them; keeps the images that it read last.

    Args:
        scene: with labels.
        frames: registered frames whose images can be read.
    """

    def __init__(self, scene: Scene, frames: Sequence[Frame]) -> None:
        self._scene = scene
        self._views = ObjectViews(scene, frames)

    def best(self, object_id: int, obj: RefineObject) -> TurnByContour | None:
        """The turn whose contour fits best; None without one of a similar silhouette, or with too
        few frames.

        Args:
            object_id: of the object.
            obj: the same, at its label.
        """
        T, centre = obj.T_world_obj, obj.T_world_obj @ obj.centre
        chosen = self._views.large(centre, obj.radius, _FRAMES)
        if len(chosen) < TurnSettings.current().fewest_frames:
            return None
        near = near_symmetry(obj.vertices, obj.faces, obj.symmetry)
        seen_at = [self._views.poses[k].inverse() @ T for k in chosen[:_SILHOUETTES]]
        turns = near.similar(seen_at)[:_MOST]
        if not turns:
            return None
        views = self._views.of_object(object_id, obj, chosen)
        free = symmetry_motions(obj.symmetry, T, object_centre(self._scene, object_id))
        label = MeasuredPose.of(views, np.zeros(6), free)
        if label is None:
            return None
        first = {k: views[k] for k in list(views)[:_FIRST]}
        looks = [(f.gain, a) for a in turns if (f := self._found(label, first, obj, a)) is not None]
        likely = [a for _, a in sorted(looks, key=lambda look: -look[0])[:_KEPT]]
        found = [f for a in likely if (f := self._found(label, views, obj, a)) is not None]
        return max(found, key=lambda f: f.gain, default=None)

    def _found(
        self,
        label: MeasuredPose,
        views: dict[int, SearchedView],
        obj: RefineObject,
        alternative: Alternative,
    ) -> TurnByContour | None:
        turned = obj.T_world_obj @ alternative.turn
        moved = turned @ obj.T_world_obj.inverse()
        centre = next(iter(views.values())).centre
        there_centre = moved @ centre
        motion = np.concatenate([there_centre - centre, so3_log(moved.R)])
        free = symmetry_motions(obj.symmetry, turned, there_centre)
        there = MeasuredPose.of(views, motion, free)
        if there is None:
            return None
        gains = {k: there.evidence(k) - label.evidence(k) for k in views}
        step = there.motion.vector
        turn = so3_exp(step[3:])
        # The motion is about the centre of the turned object.
        improved = SE3(turn, there_centre + step[:3] - turn @ there_centre) @ turned
        order = sorted(gains, key=lambda k: -abs(gains[k]))
        return TurnByContour(
            obj.material,
            obj.T_world_obj.inverse() @ improved,
            alternative.text,
            float(sum(gains.values())),
            tuple(self._views.frames[k].id for k in order),
        )
