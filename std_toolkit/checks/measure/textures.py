"""Texture and contour of each labelled object against turns of its label."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from std_toolkit.checks import result
from std_toolkit.checks.measure.contours import mesh_problem
from std_toolkit.checks.measure.motion import motion_value
from std_toolkit.checks.measure.motion_solver import symmetry_motions
from std_toolkit.checks.measure.shared_errors import seen_errors
from std_toolkit.checks.measure.turns import TurnByContour, TurnComparison
from std_toolkit.geometry import SE3
from std_toolkit.labels.refine.problem import RefineObject
from std_toolkit.labels.refine_step import scene_object, texture_surface
from std_toolkit.labels.texture.comparison import (
    TextureComparison,
    Windows,
    compare_texture,
)
from std_toolkit.labels.texture.motion import TextureMotion, texture_motion
from std_toolkit.labels.texture_step import scene_views
from std_toolkit.scene import Frame, Scene

_MOTION_VIEWS = 8


@dataclass(frozen=True, eq=False)
class TextureFinding:
    """What the texture of an object says of its label.

    Attributes:
        comparison: with near-symmetric turns.
        motion: from the label to where the texture agrees; None where it does not say.
    """

    comparison: TextureComparison
    motion: TextureMotion | None = None

    @property
    def is_textured(self) -> bool:
        """Whether the mesh has a texture that was looked for."""
        return self.motion is not None or bool(np.isfinite(self.comparison.score))


def compare_textures(
    scene: Scene, frames: Sequence[Frame], *, only: Collection[int] | None = None
) -> dict[int, TextureFinding]:
    """Compare the texture of every labelled object with a few of the frames.

    Where the texture does not decide which turn is right, the contour is compared.

    Args:
        scene: the scene with its labels.
        frames: registered frames whose images can be read.
        only: ids of the objects to compare; None compares all.

    Returns:
        Findings by object id; objects without a label in the world or a readable mesh are
        left out.
    """
    placed: dict[int, SE3] = {}
    for item in scene.objects.objects:
        pose = scene.T_world_obj(item.id)
        if pose is not None and mesh_problem(scene, item.model) is None:
            placed[item.id] = pose
    objects = {i: scene_object(scene, i, pose) for i, pose in placed.items()}
    views = scene_views(scene, frames)
    turns = TurnComparison(scene, frames)
    found = {}
    for i, obj in objects.items():
        if only is None or i in only:
            mesh = scene.mesh(scene.objects.object(i).model)
            # Textures are large, so that they are kept for one object at a time.
            textured = replace(obj, texture=texture_surface(scene, i, mesh))
            others = [o for j, o in objects.items() if j != i]
            # The comparison and the motion look at about the same views.
            surface = textured.texture
            windows = None if surface is None else Windows(views, textured, surface, others)
            comparison = compare_texture(views, textured, others, windows=windows)
            if comparison.verdict in ("undecided", "ambiguous"):
                comparison = _by_contour(comparison, turns.best(i, obj))
            motion = _motion_of(windows, comparison)
            if motion is not None:
                motion = with_cameras(scene, obj, motion)
            found[i] = TextureFinding(comparison, motion)
    return found


def _by_contour(found: TextureComparison, turn: TurnByContour | None) -> TextureComparison:
    """The comparison with what the contour says of turns, where it says anything against a label.

    A turn whose silhouette is the same in all frames stays ambiguous.
    """
    if turn is None or not (turn.is_better or turn.is_open):
        return found
    return replace(
        found,
        verdict="turned" if turn.is_better else "undecided",
        turn=turn.turn,
        text=turn.text,
        telling=turn.telling[:3],
        contour_gain=turn.gain,
    )


def _motion_of(windows: Windows | None, found: TextureComparison) -> TextureMotion | None:
    """The motion from the label to the texture in the views that show it largest."""
    # A texture that fits better after a turn, or that is not there, says nothing of a motion.
    if windows is None or found.verdict in ("turned", "ambiguous", "other"):
        return None
    views, obj = windows.views, windows.obj
    centre = obj.T_world_obj @ obj.centre
    chosen = views.large(centre, obj.radius, count=_MOTION_VIEWS)
    windows.add(chosen)
    parts = [(views.frames[k], windows.cut[k]) for k in chosen if k in windows.cut]
    free = symmetry_motions(obj.symmetry, obj.T_world_obj, centre)
    return texture_motion(parts, windows.surface, obj, free=free)


def with_cameras(scene: Scene, obj: RefineObject, motion: TextureMotion) -> TextureMotion:
    """The motion with the errors of the camera poses, each frame counting alike."""
    errors = seen_errors(scene, motion.frames, obj.T_world_obj @ obj.centre)
    added = np.sum(errors, axis=0) / len(errors) ** 2
    # What a symmetry leaves open stays open.
    kept = motion.covariance @ np.linalg.pinv(motion.covariance, rcond=1e-6, hermitian=True)
    return replace(motion, covariance=motion.covariance + kept @ added @ kept.T)


def with_texture(item: result.ObjectCheck, finding: TextureFinding | None) -> result.ObjectCheck:
    """The object's row with what its texture says."""
    if finding is None:
        return item
    found = finding.comparison
    if finding.motion is not None:
        at = finding.motion
        item = item.with_values(
            [motion_value("texture_mm", "texture", at.vector, at.covariance, frames=len(at.frames))]
        )
    return item.with_values(
        [
            result.Value(
                key="texture",
                value=_number(found.score),
                source="texture",
                frames=found.frames,
                text=found.verdict,
            ),
            result.Value(
                key="texture_rival",
                value=_number(found.rival_score),
                source="texture",
                frames=found.frames,
                text=found.text,
            ),
            result.Value(
                key="texture_says",
                value=_number(found.contour_gain),
                source="contour" if found.by_contour else "texture",
                text=found.sentence(),
            ),
        ]
    )


def with_textures(
    objects: Sequence[result.ObjectCheck], found: Mapping[int, TextureFinding]
) -> list[result.ObjectCheck]:
    """All rows with their comparisons."""
    return [with_texture(o, found.get(o.object)) for o in objects]


def _number(value: float) -> float | None:
    return round(value, 3) if np.isfinite(value) else None
