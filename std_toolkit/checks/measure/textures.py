"""The texture of each labelled object against near-symmetric turns of its label."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from std_toolkit.checks import result
from std_toolkit.checks.measure.contours import mesh_problem
from std_toolkit.checks.measure.motion_solver import symmetry_motions
from std_toolkit.geometry import SE3
from std_toolkit.labels.refine.problem import RefineObject, RefineView, large_views
from std_toolkit.labels.refine_step import load_views, scene_object, texture_surface
from std_toolkit.labels.texture.comparison import FRAMES, TextureComparison, compare_texture
from std_toolkit.labels.texture.motion import TextureMotion, texture_motion
from std_toolkit.labels.texture.scores import cut_window
from std_toolkit.scene import Frame, Scene

# Millimetres and degrees of metres and radians.
_UNITS = np.array([1000.0] * 3 + [180 / np.pi] * 3)


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
    cameras = [scene.camera(f) for f in frames]
    poses = [T for f in frames if (T := scene.T_world_cam(f.id)) is not None]
    assert len(poses) == len(frames), "only registered frames can be compared"
    views: dict[int, RefineView] = {}
    found = {}
    for i, obj in objects.items():
        if only is not None and i not in only:
            continue
        centre = obj.T_world_obj @ obj.centre
        chosen = large_views(cameras, poses, centre, obj.radius, count=FRAMES)
        for k in chosen:
            if k not in views:
                (views[k],) = load_views(scene, [frames[k]])
        others = [o for j, o in objects.items() if j != i]
        found[i] = _compare(scene, i, obj, others, [views[k] for k in chosen])
    return found


def _compare(
    scene: Scene,
    object_id: int,
    obj: RefineObject,
    others: Sequence[RefineObject],
    views: Sequence[RefineView],
) -> TextureFinding:
    mesh = scene.mesh(scene.objects.object(object_id).model)
    surface = texture_surface(scene, object_id, mesh)
    found = compare_texture(views, replace(obj, texture=surface), others)
    # The motion to a texture that fits better after a turn, or that is plain, says nothing.
    if surface is None or found.verdict in ("turned", "ambiguous"):
        return TextureFinding(found)
    windows = [
        (k if v.frame is None else v.frame, window)
        for k, v in enumerate(views)
        if (window := cut_window(v, surface, obj.T_world_obj, others)) is not None
    ]
    centre = obj.T_world_obj @ obj.centre
    free = symmetry_motions(obj.symmetry, obj.T_world_obj, centre)
    return TextureFinding(found, texture_motion(windows, surface, obj, free=free))


def with_texture(item: result.ObjectCheck, finding: TextureFinding | None) -> result.ObjectCheck:
    """The object's row with what its texture says."""
    if finding is None:
        return item
    found = finding.comparison
    if finding.motion is not None:
        item = item.with_values([_motion(finding.motion)])
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
        ]
    )


def _motion(found: TextureMotion) -> result.Value:
    vector = found.vector * _UNITS
    covariance = found.covariance * np.outer(_UNITS, _UNITS)
    return result.Value(
        key="texture_mm",
        value=round(float(np.linalg.norm(vector[:3])), 2),
        std=round(float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1])), 2),
        unit="mm",
        source="texture",
        frames=len(found.frames),
        motion=[round(float(x), 3) for x in vector],
        covariance=[float(f"{x:.6g}") for x in covariance.ravel()],
    )


def with_textures(
    objects: Sequence[result.ObjectCheck], found: Mapping[int, TextureFinding]
) -> list[result.ObjectCheck]:
    """All rows with their comparisons."""
    return [with_texture(o, found.get(o.object)) for o in objects]


def _number(value: float) -> float | None:
    return round(value, 3) if np.isfinite(value) else None
