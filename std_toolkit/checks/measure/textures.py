"""The texture of each labelled object against near-symmetric turns of its label."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from std_toolkit.checks import result
from std_toolkit.checks.measure.contours import mesh_problem
from std_toolkit.geometry import SE3
from std_toolkit.labels.refine_step import scene_object, texture_surface
from std_toolkit.labels.texture.comparison import TextureComparison
from std_toolkit.labels.texture_step import compare_objects, scene_views
from std_toolkit.scene import Frame, Scene


def compare_textures(
    scene: Scene, frames: Sequence[Frame], *, only: Collection[int] | None = None
) -> dict[int, TextureComparison]:
    """Compare the texture of every labelled object with a few of the frames.

    Args:
        scene: the scene with its labels.
        frames: registered frames whose images can be read.
        only: ids of the objects to compare; None compares all.

    Returns:
        Comparisons by object id; objects without a label in the world or a readable mesh are
        left out.
    """
    placed: dict[int, SE3] = {}
    for item in scene.objects.objects:
        pose = scene.T_world_obj(item.id)
        if pose is not None and mesh_problem(scene, item.model) is None:
            placed[item.id] = pose
    objects = {i: scene_object(scene, i, pose) for i, pose in placed.items()}
    views = scene_views(scene, frames)
    found = {}
    for i, obj in objects.items():
        if only is None or i in only:
            mesh = scene.mesh(scene.objects.object(i).model)
            # Textures are large, so that they are kept for one object at a time.
            textured = replace(obj, texture=texture_surface(scene, i, mesh))
            found |= compare_objects(views, {**objects, i: textured}, [i])
    return found


def with_texture(item: result.ObjectCheck, found: TextureComparison | None) -> result.ObjectCheck:
    """The object's row with the comparison of its texture."""
    if found is None:
        return item
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


def with_textures(
    objects: Sequence[result.ObjectCheck], found: Mapping[int, TextureComparison]
) -> list[result.ObjectCheck]:
    """All rows with their comparisons."""
    return [with_texture(o, found.get(o.object)) for o in objects]


def _number(value: float) -> float | None:
    return round(value, 3) if np.isfinite(value) else None
