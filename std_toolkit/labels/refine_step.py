"""Refinement of the labels of a scene, and the reading of its inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import mesh_bounds
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.keyframes import choose_keyframes
from std_toolkit.labels.refine import problem
from std_toolkit.labels.refine.edges.solver import refine_poses
from std_toolkit.labels.refined_scale import MeasuredScale
from std_toolkit.labels.texture.comparison import compare_texture
from std_toolkit.log import logger
from std_toolkit.rendering.texture import TexturedSurface
from std_toolkit.scene.frame_names import frame_title
from std_toolkit.scene.model import Frame, Label, annotated_views, pose_from_list
from std_toolkit.scene.scene import Scene

if TYPE_CHECKING:
    import trimesh

# Frames in which the texture of an object is matched.
_TEXTURE_VIEWS = 32


@dataclass(frozen=True)
class RefinedLabels:
    """Refined labels and the scale of the camera poses.

    Attributes:
        labels: labels by object id.
        scale: what was measured of the scale; None unless requested.
        coupling: (6,) by object id: change of the refined pose (right perturbation) per unit of
            change of the log scale.
    """

    labels: dict[int, Label]
    scale: MeasuredScale | None
    coupling: dict[int, NDArray[np.float64]]

    def at_scale(self, factor: float) -> dict[int, Label]:
        """The labels for camera positions multiplied by `factor` instead of `scale.factor`.

        The poses that fit best with this scale, to first order.
        """
        if self.scale is None or not self.coupling:
            return self.labels
        change = float(np.log(factor / self.scale.factor))
        moved = dict(self.labels)
        for i, coupling in self.coupling.items():
            T = pose_from_list(moved[i].T_world_obj or []) @ SE3.exp(change * coupling)
            moved[i] = msgspec.structs.replace(moved[i], T_world_obj=T.flat())
        return moved


def refine_labels(
    scene: Scene,
    labels: Mapping[int, Label],
    *,
    keyframes: int,
    use_depth: bool,
    refine_scale: bool,
) -> RefinedLabels:
    """Labels with refined world poses; the caller saves them while holding the scene's lock.

    Labels of the scene that are not in `labels` act as occluders and keep their poses. With
    `refine_scale` the result is for camera poses multiplied by `RefinedLabels.scale.factor`; see
    `RefinedLabels.at_scale` for others.

    Args:
        labels: labels by object id, placed in the world; those without a world pose are returned
            unchanged.
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
        count=keyframes,
        always=sorted({f for x in placed.values() for f in annotated_views(x)}),
    )
    left_out: dict[int, ToolkitError] = {}
    views = load_views(scene, frames, use_depth=use_depth, left_out=left_out)
    objects = [
        replace(
            scene_object(scene, i, start[i], fixed=i not in placed),
            # Objects refined in the annotator are aligned; manual poses may be far off.
            rough=everything[i].method != "refine",
            texture=None
            if i not in placed
            else texture_surface(scene, i, scene.mesh(scene.objects.object(i).model)),
        )
        for i in sorted(everything)
    ]
    textured = {i: start[i] for i, o in zip(sorted(everything), objects, strict=True) if o.texture}
    texture_views = load_texture_views(scene, textured, [f.id for f in frames], left_out=left_out)
    for line in left_out_sentences(scene, left_out):
        logger.warning("%s", line)
    result = refine_poses(
        views,
        objects,
        problem.RefineOptions(use_depth=use_depth, refine_scale=refine_scale),
        texture_views=texture_views,
    )
    _report(result)
    by_id = dict(zip(sorted(everything), objects, strict=True))
    at_scale = [
        replace(v, T_world_cam=SE3(v.T_world_cam.R, v.T_world_cam.t * result.scale))
        for v in [*views, *texture_views]
    ]
    refined = dict(labels)
    coupling = {}
    for i, found in zip(sorted(everything), result.objects, strict=True):
        if i not in placed:
            continue
        if found.views == 0:
            logger.warning("%s: not visible in any keyframe, so it is not refined", found.name)
            continue
        if not found.converged:
            logger.warning("%s: the refinement did not converge; check its label", found.name)
        if found.texture_offset is not None:
            logger.warning("%s: %s", found.name, found.texture_sentence(by_id[i].centre))
        at_end = replace(by_id[i], T_world_obj=found.T_world_obj)
        around = [
            replace(o, T_world_obj=x.T_world_obj)
            for (k, o), x in zip(by_id.items(), result.objects, strict=True)
            if k != i
        ]
        # Without a texture no turn can fit it better.
        judged = compare_texture(at_scale, at_end, around) if at_end.texture is not None else None
        if judged is not None and judged.verdict == "turned":
            logger.warning("%s: %s; turn it and refine again", found.name, judged.sentence())
        refined[i] = msgspec.structs.replace(
            placed[i],
            T_world_obj=found.T_world_obj.flat(),
            refined=True,
            covariance=[float(x) for x in found.covariance.ravel()],
            weak_direction=found.weak_direction,
        )
        coupling[i] = found.scale_coupling
    if not refine_scale:
        return RefinedLabels(refined, None, {})
    measured = MeasuredScale(
        factor=result.scale,
        standard_error=result.scale_std / result.scale,
        objects=len(coupling),
        models=len({scene.objects.object(i).model for i in coupling}),
        settled=result.scale_converged and bool(coupling),
    )
    return RefinedLabels(refined, measured, coupling)


def load_views(
    scene: Scene,
    frames: Sequence[Frame],
    *,
    use_depth: bool = True,
    left_out: dict[int, ToolkitError] | None = None,
) -> list[problem.RefineView]:
    """The frames as inputs of a refinement; all must be registered.

    Args:
        left_out: receives the errors of frames that cannot be read, by frame id; None raises the
            first one.

    Raises:
        ToolkitError: a frame, or with `left_out` every frame, cannot be read.
    """
    assert scene.poses is not None
    covariances = {p.frame: p.covariance for p in scene.poses.frames if p.covariance is not None}
    views = []
    for frame in frames:
        T_world_cam = scene.T_world_cam(frame.id)
        assert T_world_cam is not None
        try:
            color = scene.read_color(frame)
            depth = scene.read_depth(frame) if use_depth else None
        except ToolkitError as error:
            if left_out is None:
                raise
            left_out[frame.id] = error
            continue
        known = covariances.get(frame.id)
        views.append(
            problem.RefineView.of(
                scene.camera(frame),
                T_world_cam,
                color,
                depth,
                frame=frame.id,
                pose_covariance=None if known is None else np.reshape(known, (6, 6)),
            )
        )
    if left_out and frames and not views:
        raise left_out[frames[0].id]
    return views


def left_out_sentences(scene: Scene, left_out: Mapping[int, ToolkitError]) -> list[str]:
    """One sentence per frame that was left out, with its file and the reason."""
    return [
        f"{frame_title(scene.frame(i))} is left out: {error.problem}"
        for i, error in sorted(left_out.items())
    ]


def texture_surface(scene: Scene, object_id: int, mesh: trimesh.Trimesh) -> TexturedSurface | None:
    """The mesh of an object with its colours; None if it has none or the object is clear."""
    # A clear object shows what is behind it, whatever its mesh is painted with.
    if scene.objects.object(object_id).material == "transparent":
        return None
    return TexturedSurface.from_mesh(mesh)


def load_texture_views(
    scene: Scene,
    objects: Mapping[int, SE3],
    loaded: Sequence[int],
    *,
    left_out: dict[int, ToolkitError],
) -> list[problem.RefineView]:
    """More frames in which the textures of objects are matched, without depth.

    Args:
        objects: T_world_obj of the objects with a texture, by id.
        loaded: ids of the frames that are loaded anyway.
        left_out: receives the errors of frames that cannot be read, by frame id.
    """
    frames = [f for f in scene.registered_frames() if f.id not in set(loaded)]
    cameras = [scene.camera(f) for f in frames]
    poses = [T for f in frames if (T := scene.T_world_cam(f.id)) is not None]
    chosen: set[int] = set()
    for i, T in objects.items():
        low, high = mesh_bounds(scene.mesh(scene.objects.object(i).model))
        radius = float(np.linalg.norm(high - low)) / 2
        count = max(_TEXTURE_VIEWS - len(loaded), 0)
        chosen |= set(
            problem.large_views(cameras, poses, T @ ((low + high) / 2), radius, count=count)
        )
    # Each object has its own best views; together they stay affordable.
    kept = sorted(chosen)
    if len(kept) > 2 * _TEXTURE_VIEWS:
        kept = [
            kept[k] for k in np.linspace(0, len(kept) - 1, 2 * _TEXTURE_VIEWS).round().astype(int)
        ]
    views = []
    for k in kept:
        # These frames only add to others, so that none of them need be readable.
        with suppress(ToolkitError):
            views += load_views(scene, [frames[k]], use_depth=False, left_out=left_out)
    return views


def scene_object(
    scene: Scene,
    object_id: int,
    T_world_obj: SE3,
    *,
    fixed: bool = False,
    mesh: trimesh.Trimesh | None = None,
) -> problem.RefineObject:
    """An object of the scene at a pose, as input of a refinement.

    Args:
        mesh: its mesh, if loaded; otherwise it is read.
    """
    obj = scene.objects.object(object_id)
    model = scene.objects.model(obj.model)
    if mesh is None:
        mesh = scene.mesh(model.id)
    return problem.RefineObject(
        obj.name,
        np.asarray(mesh.vertices, dtype=np.float64),
        np.asarray(mesh.faces, dtype=np.int64),
        T_world_obj,
        obj.material,
        model.symmetry.symmetry(),
        fixed,
    )


def _report(result: problem.RefineResult) -> None:
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
