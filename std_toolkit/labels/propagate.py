"""Propagation of annotations in one or more frames to every registered frame.

Computes one world pose per object, and the summary lines of a propagation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.mesh import hull_vertices
from std_toolkit.geometry.se3 import SE3, skew
from std_toolkit.geometry.symmetry import Symmetry, mssd, nearest_variant
from std_toolkit.io.atomic import sweep_temporaries
from std_toolkit.io.documents import digest_file, digest_of
from std_toolkit.jobs.artefact import Artefact
from std_toolkit.log import logger
from std_toolkit.options import PropagateOptions
from std_toolkit.scene.judgement import kept_judgement
from std_toolkit.scene.label_verdicts import label_verdicts
from std_toolkit.scene.model import (
    Label,
    Labels,
    annotated_views,
    pose_from_list,
    without_derived,
)
from std_toolkit.scene.scene import Scene, require_metres

if TYPE_CHECKING:
    from std_toolkit.labels.refine_step import RefinedLabels

STEP = "propagate"

Array = NDArray[np.float64]


def propagate_labels(scene: Scene, options: PropagateOptions | None = None) -> Labels:
    """Set `T_world_obj` of every label: T_world_cam(annotated frame) @ T_cam_obj.

    `Scene.T_cam_obj` derives the poses in frames from it and is None for a frame that is not
    registered. An object annotated in several registered frames gets the pose that agrees best
    with all of them, in pixels. With `refine` the poses are refined with the images (see
    `labels.refine`). A label that hardly moved keeps its judgement. Writes labels.json while
    holding the scene's lock. If the inputs did not change, the step is skipped.

    Raises:
        ToolkitError: no camera poses, poses of unknown unit, no labels, an unknown object, or no
            label annotated in a registered frame.
    """
    options = options or PropagateOptions()
    with scene.lock():
        sweep_temporaries(scene.root)
        require_metres(scene)
        chosen = _chosen_labels(scene, options)
        files = _file_digests(scene, options)
        if _artefact(scene, chosen, options, files).is_kept():
            return scene.labels
        placed = {x.object: place_label(scene, x) for x in chosen}
        lost = [x.object for x in placed.values() if x.T_world_obj is None]
        for object_id in lost:
            logger.warning(
                "object %s: none of its annotated frames is registered, so it is not propagated",
                scene.objects.object(object_id).name,
            )
        if len(lost) == len(placed):
            raise ToolkitError(
                "no label is annotated in a registered frame",
                path=scene.root,
                hint="annotate in a frame that `std-curate trajectory` lists as registered",
            )
        scale: AbstractContextManager[None] = nullcontext()
        if options.refine:
            placed, scale = _refine(scene, placed, options)
        labels = Labels(labels=[_judged(placed, x) for x in scene.labels.labels])
        with scale:
            scene.save_labels(labels)
            # The camera poses may have a new scale; the files are those that were read.
            made = _artefact(scene, chosen, options, files)
            made.write([])
    return labels


def _judged(placed: dict[int, Label], before: Label) -> Label:
    """The label as it is now, with what the check said of it if it hardly moved."""
    label = placed.get(before.object, before)
    T = None if label.T_world_obj is None else pose_from_list(label.T_world_obj)
    return msgspec.structs.replace(label, judgement=kept_judgement(before.judgement, T))


def _refine(
    scene: Scene, placed: dict[int, Label], options: PropagateOptions
) -> tuple[dict[int, Label], AbstractContextManager[None]]:
    """Refined labels, and the change of the scale of the camera poses that they need."""
    from std_toolkit.labels.refine_step import refine_labels
    from std_toolkit.labels.refined_scale import decide_scale
    from std_toolkit.poses.publish import rescaled_poses

    def refined(*, with_scale: bool) -> RefinedLabels:
        return refine_labels(
            scene,
            placed,
            keyframes=options.keyframes,
            use_depth=options.use_depth,
            refine_scale=with_scale,
        )

    found = refined(with_scale=options.refine_scale)
    if found.scale is None:
        return found.labels, nullcontext()
    assert scene.poses is not None
    decision = decide_scale(scene.poses.scale, found.scale)
    (logger.warning if decision.kept else logger.info)("--refine-scale: %s", decision.sentence)
    if not found.scale.settled:
        # The refined poses belong to a scale that is not used.
        return refined(with_scale=False).labels, nullcontext()
    labels = found.at_scale(decision.factor)
    for label in scene.labels.labels:
        if label.object not in labels and label.T_world_obj is not None:
            labels[label.object] = _rescaled_label(label, decision.factor)
    return labels, rescaled_poses(scene, decision.factor, decision.report)


def _rescaled_label(label: Label, factor: float) -> Label:
    """A label that is not propagated now, moved with the world."""
    T = SE3.from_matrix(label.T_world_obj or [])
    return msgspec.structs.replace(label, T_world_obj=SE3(T.R, factor * T.t).flat())


def place_label(scene: Scene, label: Label) -> Label:
    """The label with `T_world_obj` from its annotations; None if no such frame is registered."""
    model = scene.objects.model_of(label.object)
    views = []
    for frame, T_cam_obj in annotated_views(label).items():
        T_world_cam = scene.T_world_cam(frame)
        if T_world_cam is not None:
            views.append(AnnotatedView(scene.camera(scene.frame(frame)), T_world_cam, T_cam_obj))
    bare = without_derived(label)
    if not views:
        return bare
    name = scene.objects.object(label.object).name
    outline = hull_vertices(scene.mesh(model.id))
    try:
        pose = fuse_views(views, outline, model.symmetry.symmetry())
    except ToolkitError as error:
        raise ToolkitError(
            error.problem,
            path=scene.root / "labels.json",
            field=name,
            value=error.value,
            hint=error.hint,
        ) from error
    return msgspec.structs.replace(bare, T_world_obj=pose.flat())


def _chosen_labels(scene: Scene, options: PropagateOptions) -> list[Label]:
    if scene.poses is None:
        raise ToolkitError(
            "the scene has no camera poses", path=scene.root, hint="run `std-curate poses` first"
        )
    if options.objects is None:
        chosen = list(scene.labels.labels)
    else:
        chosen = []
        for name in options.objects:
            label = scene.labels.of(scene.objects.object_named(name).id)
            if label is None:
                raise ToolkitError("this object has no label", path=scene.root, value=name)
            chosen.append(label)
    if not chosen:
        raise ToolkitError(
            "the scene has no labels", path=scene.root, hint="set one with `std-curate label`"
        )
    return chosen


def _file_digests(scene: Scene, options: PropagateOptions) -> dict[str, str]:
    """Digests of the images and of the meshes that a propagation reads."""
    images: list[Path] = []
    # All frames: the selection of keyframes depends on them.
    for frame in scene.registered_frames() if options.refine else []:
        images.append(scene.color_path(frame))
        if frame.depth is not None and options.use_depth:
            images.append(scene.root / frame.depth)
    meshes = [scene.mesh_path(model) for model in scene.objects.models]
    return {
        name: digest_of([digest_file(path) for path in paths])
        for name, paths in (("images", images), ("meshes", meshes))
    }


def _artefact(
    scene: Scene, chosen: list[Label], options: PropagateOptions, files: dict[str, str]
) -> Artefact:
    inputs = files | {
        "annotations": digest_of([without_derived(x) for x in chosen]),
        # The result, instead of the file: a check writes its judgements there.
        "labels": digest_of(scene.labels.without_judgements()),
        "objects": digest_of(scene.objects),
        "cameras": digest_of(scene.info, scene.frame_table),
        "camera poses": digest_of(scene.poses),
    }
    return Artefact(scene.root, STEP, inputs, vars(options), limits=("labels.",))


@dataclass(frozen=True, eq=False)
class AnnotatedView:
    """One annotation with its camera.

    Attributes:
        camera: intrinsics of the frame.
        T_world_cam: pose of the frame, metres.
        T_cam_obj: the annotated pose.
    """

    camera: Camera
    T_world_cam: SE3
    T_cam_obj: SE3

    @property
    def T_world_obj(self) -> SE3:
        return self.T_world_cam @ self.T_cam_obj


def fuse_views(
    views: Sequence[AnnotatedView], points: NDArray[np.floating], symmetry: Symmetry
) -> SE3:
    """T_world_obj that agrees best with all annotations, in pixels.

    An annotation in one image is accurate laterally and weak along the viewing ray. Pixel errors
    weight it accordingly: views from different sides determine each other's depth, unlike a mean
    of the poses.

    Args:
        views: at least one. The symmetric variant of the first is kept.
        points: (P, 3) points on the object (hull vertices, bounding-box corners), mesh frame.
        symmetry: a later view may show any symmetric variant of the first.

    Raises:
        ToolkitError: no views, or views that contradict each other by more than half of the
            object's size.
    """
    if not views:
        raise ToolkitError("no annotated view")
    first = views[0].T_world_obj
    if len(views) == 1:
        return first
    X = np.asarray(points, dtype=np.float64)
    size = float(np.ptp(X, axis=0).max())
    aligned = [(views[0], views[0].T_cam_obj)]
    for view in views[1:]:
        T = nearest_variant(view.T_world_obj, first, X, symmetry)
        apart = mssd(T, first, X)
        if apart > size:
            raise ToolkitError(
                "two annotations of one object contradict each other",
                value=f"{apart * 1000:.0f} mm apart in the world",
                hint="is one of them for another object, or a camera pose wrong?",
            )
        aligned.append((view, view.T_world_cam.inverse() @ T))
    pose = first
    targets = [(v, v.camera.without_distortion().project(T @ X)) for v, T in aligned]
    for _ in range(30):
        A, b = np.zeros((6, 6)), np.zeros(6)
        for view, pixels in targets:
            error, J = _projection(view, pose, X, pixels)
            # Huber loss limits the influence of one inaccurate view.
            weight = np.minimum(1, 5 / np.maximum(np.linalg.norm(error, axis=1), 1e-9))
            A += np.einsum("n,nij,nik->jk", weight, J, J)
            b += np.einsum("n,nij,ni->j", weight, J, error)
        step = np.linalg.solve(A + 1e-9 * np.diag(np.diag(A)), -b)
        pose = pose @ SE3.exp(step)
        if np.linalg.norm(step) < 1e-10:
            break
    return pose


def _projection(view: AnnotatedView, pose: SE3, X: Array, pixels: Array) -> tuple[Array, Array]:
    """Pixel errors (N, 2) and their derivative (N, 2, 6) by a right perturbation of the pose."""
    T = view.T_world_cam.inverse() @ pose
    p = T @ X
    z = np.maximum(p[:, 2], 1e-3)
    camera = view.camera
    u = camera.fx * p[:, 0] / z + camera.cx
    v = camera.fy * p[:, 1] / z + camera.cy
    zero = np.zeros_like(z)
    d_pixel = np.stack(
        [
            np.stack([camera.fx / z, zero, -camera.fx * p[:, 0] / z**2], axis=-1),
            np.stack([zero, camera.fy / z, -camera.fy * p[:, 1] / z**2], axis=-1),
        ],
        axis=1,
    )
    d_point = np.concatenate(
        [np.broadcast_to(T.R, (len(X), 3, 3)), -T.R @ np.stack([skew(x) for x in X])], axis=-1
    )
    return np.stack([u, v], axis=-1) - pixels, d_pixel @ d_point


def label_lines(scene: Scene, labels: Labels) -> Iterator[str]:
    """One line per label, and more on its uncertainty and its verdict if they are known."""
    registered = len(scene.registered_frames())
    verdicts = {v.object: v for v in label_verdicts(scene)}
    for label in labels.labels:
        name = scene.objects.object(label.object).name
        if label.T_world_obj is None:
            yield f"{name}: no label (not annotated in a registered frame)"
            continue
        how = "refined" if label.refined else "propagated"
        views = 1 + len(label.views)
        yield (
            f"{name}: {how} from {views} annotated frame{'s' if views > 1 else ''} "
            f"to {registered} of {len(scene.frames)} frames"
        )
        if label.covariance is not None:
            std = np.sqrt(np.diag(np.reshape(label.covariance, (6, 6))))
            millimetres = ", ".join(f"{1000 * x:.2f}" for x in std[:3])
            degrees = ", ".join(f"{np.rad2deg(x):.2f}" for x in std[3:])
            yield f"  standard deviation ({millimetres}) mm, ({degrees}) deg on the object's axes"
        if label.weak_direction:
            yield f"  {label.weak_direction}"
        judged = verdicts.get(label.object)
        if judged is not None and not isinstance(label.judgement, msgspec.UnsetType):
            yield f"  {judged.line().removeprefix(f'{name}: ')}"
