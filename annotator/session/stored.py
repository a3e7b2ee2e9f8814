"""The scene's documents that an annotation reads and writes, and the state they stand for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from annotator.session.cameras import Cameras
from annotator.session.state import AnnotationState, Click, ObjectState, Placement
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.labels.label import annotated_views
from std_toolkit.labels.propagate import place_label
from std_toolkit.scene import Annotation, Label, LabelProvenance, Labels, ObjectTable, Scene
from std_toolkit.scene.document import Document
from std_toolkit.scene.model import pose_from_list

# Two poses whose numbers differ by no more are one pose, written down twice.
_SAME = 1e-9


class Stored(Document, frozen=True, kw_only=True):
    """objects.json, labels.json and annotation.json as they were at one moment."""

    objects: ObjectTable
    labels: Labels
    annotation: Annotation

    @staticmethod
    def of(scene: Scene) -> Stored:
        """Raises ToolkitError for a document that cannot be read."""
        return Stored(objects=scene.objects, labels=scene.labels, annotation=scene.annotation)


@dataclass(frozen=True)
class Opened:
    """A state with what could not be taken over as it is.

    Attributes:
        warnings: sentences for people.
    """

    state: AnnotationState
    warnings: tuple[str, ...]


def state_of(scene: Scene, cameras: Cameras, stored: Stored) -> Opened:
    """The state that the documents stand for; images are not read.

    A label that was propagated is placed by its pose in the world; one that was annotated in
    several frames and not propagated yet by what agrees best with all of them.
    """
    warnings: list[str] = []
    objects = []
    for thing in stored.objects.objects:
        label = stored.labels.of(thing.id)
        work = stored.annotation.of(thing.id)
        placements: dict[int, Placement] = {}
        if label is not None:
            placements, problem = _placements(scene, cameras, label)
            if problem:
                warnings.append(f"{thing.name}: {problem}")
        clicks: dict[int, list[Click]] = {}
        for click in work.clicks:
            clicks.setdefault(click.frame, []).append(
                Click(u=click.u, v=click.v, point=click.point)
            )
        objects.append(
            ObjectState(
                id=thing.id,
                name=thing.name,
                model=thing.model,
                material=thing.material,
                status=work.status if placements else "open",
                note=work.note,
                placements=placements,
                clicks=dict(sorted(clicks.items())),
            )
        )
    state = AnnotationState(
        models=sorted(stored.objects.models, key=lambda m: m.id),
        objects=sorted(objects, key=lambda o: o.id),
    )
    return Opened(state, tuple(warnings))


def _placements(
    scene: Scene, cameras: Cameras, label: Label
) -> tuple[dict[int, Placement], str | None]:
    annotated = {label.frame: label.T_cam_obj, **{int(k): T for k, T in label.views.items()}}
    if not cameras.posed:
        return {f: _placement(label, T) for f, T in sorted(annotated.items())}, None
    usable = [f for f in annotated if f in cameras.frame_set]
    frame = usable[0] if usable else label.frame
    if label.T_world_obj is None and len(usable) <= 1:
        # Also where its frame has no camera pose: the label holds in that frame then.
        return {frame: _placement(label, annotated[frame])}, None
    problem = None
    if label.T_world_obj is not None:
        T_world_obj = pose_from_list(label.T_world_obj)
    else:
        T_world_obj, problem = _fused(scene, cameras, label, frame)
    if not usable:
        # Propagated from a frame that lost its camera pose since.
        frame = cameras.frames[0]
    T_world_cam = cameras.T_world_cam(frame)
    assert T_world_cam is not None
    T_cam_obj = (T_world_cam.inverse() @ T_world_obj).flat()
    if usable and np.abs(np.subtract(T_cam_obj, annotated[frame])).max() <= _SAME:
        T_cam_obj = annotated[frame]
    return {frame: _placement(label, T_cam_obj)}, problem


def _fused(scene: Scene, cameras: Cameras, label: Label, frame: int) -> tuple[SE3, str | None]:
    try:
        placed = place_label(scene, label)
        assert placed.T_world_obj is not None
        return pose_from_list(placed.T_world_obj), None
    except ToolkitError as error:
        T_world_cam = cameras.T_world_cam(frame)
        assert T_world_cam is not None
        problem = f"shown as annotated in frame {frame} only, not in all its frames: {error}"
        return T_world_cam @ annotated_views(label)[frame], problem


def _placement(label: Label, T_cam_obj: list[float]) -> Placement:
    known = label.provenance if isinstance(label.provenance, LabelProvenance) else None
    refinement = known.refinement if known is not None else ""
    if label.refined and T_cam_obj != label.T_cam_obj:
        refinement = "adjusted over several frames when it was propagated"
    return Placement(
        T_cam_obj=T_cam_obj,
        method=label.method,
        refinement=refinement,
        annotator=label.annotator,
        time=known.time if known is not None else "",
    )
