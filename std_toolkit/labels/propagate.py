"""From annotated frames to every registered frame: one world pose per object."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import hull_vertices
from std_toolkit.io.atomic import sweep_temporaries
from std_toolkit.labels.fuse import AnnotatedView, fuse_views
from std_toolkit.labels.label import annotated_views, without_derived
from std_toolkit.log import logger
from std_toolkit.scene.metres import require_metres
from std_toolkit.scene.model import Label, Labels
from std_toolkit.scene.provenance import digest_file, digest_of, is_fresh, write_record
from std_toolkit.scene.scene import Scene

STEP = "propagate"


@dataclass(frozen=True, kw_only=True)
class PropagateOptions:
    """How labels are carried over.

    Attributes:
        refine: adjust each object's one pose jointly over spread keyframes.
        refine_scale: estimate one scale of the whole reconstruction as well; the camera poses
            are rewritten with it. Only with `refine`.
        objects: names of the objects to work on; default: all labelled ones.
        keyframes: frames used for the refinement.
        use_depth: let sensor depth take part, on diffuse objects only.
    """

    refine: bool = False
    refine_scale: bool = False
    objects: tuple[str, ...] | None = None
    keyframes: int = 10
    use_depth: bool = True

    def __post_init__(self) -> None:
        if self.refine_scale and not self.refine:
            raise ToolkitError("--refine-scale needs --refine")
        if not 2 <= self.keyframes <= 200:
            raise ToolkitError("must be 2 to 200", field="keyframes", value=self.keyframes)


def propagate_labels(scene: Scene, options: PropagateOptions | None = None) -> Labels:
    """Set `T_world_obj` of every label: T_world_cam(annotated frame) @ T_cam_obj.

    Frames get their poses from it through `Scene.T_cam_obj`, which is None for a frame that is
    not registered. An object annotated in several registered frames gets the pose that agrees
    best with all of them, in pixels. With `refine` the poses are adjusted to the images (see
    `labels.refine`). Writes labels.json while holding the scene's lock; a step already done with
    the same inputs is skipped.

    Raises:
        ToolkitError: no camera poses, poses of unknown unit, no labels, an unknown object, or no
            label that was annotated in a registered frame.
    """
    options = options or PropagateOptions()
    with scene.lock():
        sweep_temporaries(scene.root)
        require_metres(scene)
        chosen = _chosen_labels(scene, options)
        digest = _digest(scene, chosen, options)
        if is_fresh(scene.root, STEP, digest):
            logger.info("propagate: up to date")
            return scene.labels
        placed = {x.object: place_label(scene, x) for x in chosen}
        lost = [x.object for x in placed.values() if x.T_world_obj is None]
        for object_id in lost:
            logger.warning(
                "object %s: none of its annotated frames is registered, so it gets no labels",
                scene.objects.object(object_id).name,
            )
        if len(lost) == len(placed):
            raise ToolkitError(
                "no label was annotated in a registered frame",
                path=scene.root,
                hint="annotate in a frame that `std-curate trajectory` lists as registered",
            )
        scale: AbstractContextManager[None] = nullcontext()
        if options.refine:
            from std_toolkit.labels.refine.step import refine_labels

            refined = refine_labels(scene, placed, options)
            placed = refined.labels
            if options.refine_scale:
                from std_toolkit.labels.refine.rescale import rescaled_poses

                scale = rescaled_poses(scene, refined.scale, refined.scale_std)
        labels = Labels(labels=[placed.get(x.object, x) for x in scene.labels.labels])
        with scale:
            scene.save_labels(labels)
            write_record(
                scene.root,
                STEP,
                _digest(scene, chosen, options),
                outputs=[scene.root / "labels.json"],
                parameters=_parameters(options),
            )
    return labels


def place_label(scene: Scene, label: Label) -> Label:
    """The label with `T_world_obj` from its annotations; None where no such frame is registered."""
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


def _digest(scene: Scene, chosen: list[Label], options: PropagateOptions) -> str:
    images: list[str] = []
    if options.refine:
        # All of them: which ones become keyframes is part of what is computed from them.
        for frame in scene.registered_frames():
            images.append(digest_file(scene.color_path(frame)))
            if frame.depth is not None and options.use_depth:
                images.append(digest_file(scene.root / frame.depth))
    meshes = [digest_file(scene.mesh_path(model)) for model in scene.objects.models]
    return digest_of(
        [without_derived(x) for x in chosen],
        scene.objects,
        scene.info,
        scene.frame_table,
        scene.poses,
        images,
        meshes,
        _parameters(options),
    )


def _parameters(options: PropagateOptions) -> dict[str, Any]:
    return {name: getattr(options, name) for name in options.__dataclass_fields__}
