"""The refinement of a scene's labels: reads the keyframes, refines, writes what it found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.label import annotated_views
from std_toolkit.labels.refine.keyframes import choose_keyframes
from std_toolkit.labels.refine.problem import (
    RefineObject,
    RefineOptions,
    RefineResult,
    RefineView,
)
from std_toolkit.labels.refine.solver import refine_poses
from std_toolkit.log import logger
from std_toolkit.scene.model import Frame, Label, pose_from_list
from std_toolkit.scene.scene import Scene

if TYPE_CHECKING:
    import trimesh

    from std_toolkit.labels.propagate import PropagateOptions


@dataclass(frozen=True)
class RefinedLabels:
    """Refined labels and the scale they were found in.

    Attributes:
        labels: by object id.
        scale: factor on the positions of the camera poses; 1 unless asked for.
        scale_std: standard deviation of the factor.
    """

    labels: dict[int, Label]
    scale: float
    scale_std: float


def refine_labels(
    scene: Scene, labels: Mapping[int, Label], options: PropagateOptions
) -> RefinedLabels:
    """Labels with refined world poses; the caller saves them while holding the scene's lock.

    Labels of the scene that are not among `labels` take part as occluders and keep their poses.
    With `refine_scale` they fit camera poses multiplied by `RefinedLabels.scale`.

    Args:
        labels: by object id, placed in the world; those without a world pose are passed through.
    """
    placed = {i: x for i, x in labels.items() if x.T_world_obj is not None}
    others = {
        x.object: x
        for x in scene.labels.labels
        if x.object not in labels and x.T_world_obj is not None
    }
    everything = {**placed, **others}
    start = {i: pose_from_list(x.T_world_obj) for i, x in everything.items() if x.T_world_obj}
    frames = choose_keyframes(
        scene,
        {i: start[i] for i in placed},
        count=options.keyframes,
        always=sorted({f for x in placed.values() for f in annotated_views(x)}),
    )
    views = load_views(scene, frames, use_depth=options.use_depth)
    objects = [
        replace(
            scene_object(scene, i, start[i], fixed=i not in placed),
            # What was refined in the annotator is in place; what a hand has placed may be far.
            rough=everything[i].method != "refine",
        )
        for i in sorted(everything)
    ]
    result = refine_poses(
        views,
        objects,
        RefineOptions(use_depth=options.use_depth, refine_scale=options.refine_scale),
    )
    _report(result)
    refined = dict(labels)
    for i, found in zip(sorted(everything), result.objects, strict=True):
        if i not in placed:
            continue
        if found.views == 0:
            logger.warning("%s: visible in no keyframe, so it is not refined", found.name)
            continue
        if not found.converged:
            logger.warning("%s: the refinement did not settle; check its label", found.name)
        refined[i] = msgspec.structs.replace(
            placed[i],
            T_world_obj=found.T_world_obj.flat(),
            refined=True,
            covariance=[float(x) for x in found.covariance.ravel()],
            weak_direction=found.weak_direction,
        )
    return RefinedLabels(refined, result.scale, result.scale_std)


def load_views(scene: Scene, frames: list[Frame], *, use_depth: bool = True) -> list[RefineView]:
    """The frames as a refinement wants them; all must be registered."""
    views = []
    for frame in frames:
        T_world_cam = scene.T_world_cam(frame.id)
        assert T_world_cam is not None
        depth = scene.read_depth(frame) if use_depth else None
        views.append(
            RefineView.of(
                scene.camera(frame), T_world_cam, scene.read_color(frame), depth, frame=frame.id
            )
        )
    return views


def scene_object(
    scene: Scene,
    object_id: int,
    T_world_obj: SE3,
    *,
    fixed: bool = False,
    mesh: trimesh.Trimesh | None = None,
) -> RefineObject:
    """An object of the scene at a pose, as a refinement wants it.

    Args:
        mesh: its mesh, where it is at hand; else it is read.
    """
    thing = scene.objects.object(object_id)
    model = scene.objects.model(thing.model)
    if mesh is None:
        mesh = scene.mesh(model.id)
    return RefineObject(
        thing.name,
        np.asarray(mesh.vertices, dtype=np.float64),
        np.asarray(mesh.faces, dtype=np.int64),
        T_world_obj,
        thing.material,
        model.symmetry.symmetry(),
        fixed,
    )


def _report(result: RefineResult) -> None:
    for found in result.objects:
        depth = f", depth {1000 * found.depth_rms_m:.1f} mm" if found.depth_rms_m else ""
        logger.info(
            "%s: edges %.2f px in %d views%s; %s",
            found.name,
            found.edge_rms_px,
            found.views,
            depth,
            found.weak_direction,
        )
    if result.depth_factor_std > 0:
        logger.info(
            "sensor depth factor %.4f +- %.4f (true depth = factor * sensor depth)",
            result.depth_factor,
            result.depth_factor_std,
        )
    if result.scale_std > 0:
        logger.info(
            "scale of the camera poses: factor %.4f +- %.4f", result.scale, result.scale_std
        )
