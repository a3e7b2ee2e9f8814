"""Labels of one annotator in the frames of the shared recording, and matching of objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, Symmetry
from std_toolkit.geometry.mesh import hull_vertices, mesh_bounds
from std_toolkit.labels.propagate import place_label
from std_toolkit.scene import Label, Model, Object, Scene
from std_toolkit.scene.label_verdicts import LabelVerdict, label_verdicts
from std_toolkit.scene.model import annotated_views, pose_from_list
from std_toolkit.scene.scene import require_metres
from std_toolkit.settings import Settings, limit

_FAR = 1e6


@dataclass(frozen=True, kw_only=True)
class SameMeshSettings(Settings):
    """When two meshes are copies of one."""

    same_mesh_m: float = limit(1e-4, unit="m", source="exporters and file formats")
    """largest vertex difference of two copies of one mesh"""


@dataclass(frozen=True, eq=False)
class Match:
    """Two labels of one physical object.

    Attributes:
        by: "name", or "place": the names differ, but the mesh is the same and no other object
            with it is nearer.
    """

    a: LabelledObject
    b: LabelledObject
    by: str


@dataclass(frozen=True, eq=False)
class Matching:
    """Result of a matching, with the objects that only one annotator labelled."""

    matches: list[Match]
    only_a: list[LabelledObject]
    only_b: list[LabelledObject]


def match_objects(a: Sequence[LabelledObject], b: Sequence[LabelledObject]) -> Matching:
    """Match the labelled objects of two annotators.

    Objects of equal names match. Of the others, those of the same mesh match whose centres are
    nearest to each other, and less than the object's diameter apart.
    """
    from scipy.optimize import linear_sum_assignment  # slow to import

    by_name = {x.name: x for x in b}
    matches = [Match(x, by_name[x.name], "name") for x in a if x.name in by_name]
    named = {m.a.name for m in matches}
    left_a = [x for x in a if x.name not in named]
    left_b = [x for x in b if x.name not in named]
    if left_a and left_b:
        cost = np.array([[_place_cost(x, y) for y in left_b] for x in left_a])
        for i, j in zip(*linear_sum_assignment(cost), strict=True):
            if cost[i, j] < _FAR:
                matches.append(Match(left_a[i], left_b[j], "place"))
    matched_a = {m.a.name for m in matches}
    matched_b = {m.b.name for m in matches}
    return Matching(
        matches,
        [x for x in a if x.name not in matched_a],
        [x for x in b if x.name not in matched_b],
    )


def same_mesh(x: LabelledObject, y: LabelledObject) -> bool:
    """Whether the meshes of two objects have the same shape in the same mesh frame.

    Raises:
        ToolkitError: a mesh is missing or damaged.
    """
    return same_shape(x.owner.scene, x.model, y.owner.scene, y.model)


def same_shape(scene_a: Scene, a: Model, scene_b: Scene, b: Model) -> bool:
    """As `same_mesh`, for models of two scenes."""
    limits = SameMeshSettings.current()
    if scene_a.mesh_digest(a.id) == scene_b.mesh_digest(b.id):
        return True
    # The same mesh in another file format.
    bounds = mesh_bounds(scene_a.mesh(a.id)) - mesh_bounds(scene_b.mesh(b.id))
    return bool(
        np.abs(bounds).max() < limits.same_mesh_m
        and abs(a.diameter_m - b.diameter_m) < limits.same_mesh_m
    )


def distance_between(x: LabelledObject, y: LabelledObject) -> float:
    """Return the distance of the centres in metres, median over common frames; inf without any."""
    common = sorted(x.poses.keys() & y.poses.keys())
    if not common:
        return float("inf")
    chosen = [common[int(i)] for i in np.linspace(0, len(common) - 1, min(9, len(common)))]
    return float(
        np.median([np.linalg.norm(x.poses[f] @ x.centre - y.poses[f] @ y.centre) for f in chosen])
    )


def _place_cost(x: LabelledObject, y: LabelledObject) -> float:
    if not same_mesh(x, y):
        return _FAR
    apart = distance_between(x, y)
    return apart if apart < x.model.diameter_m else _FAR


@dataclass(frozen=True, eq=False)
class AnnotatedScene:
    """One annotator's scene, with the frame ids of the scene that it is compared with.

    Attributes:
        name: name of the annotator in a comparison: "A", "B", ...
        scene: the scene.
        own_frame: shared frame id to frame id in this scene.
        as_annotated: use the poses as set by hand, before any refinement over several frames.
    """

    name: str
    scene: Scene
    own_frame: dict[int, int]
    as_annotated: bool = False

    @cached_property
    def posed(self) -> bool:
        """Whether camera poses are metric, so that one pose holds for all frames."""
        try:
            require_metres(self.scene)
        except ToolkitError:
            return False
        return bool(self.scene.registered_frames())

    @cached_property
    def shared_frame(self) -> dict[int, int]:
        """Frame id in this scene to shared frame id."""
        return {own: shared for shared, own in self.own_frame.items()}

    @cached_property
    def objects(self) -> list[LabelledObject]:
        """The labelled objects."""
        table = self.scene.objects
        return [
            LabelledObject(self, obj, table.model(obj.model), label)
            for obj in table.objects
            if (label := self.scene.labels.of(obj.id)) is not None
        ]

    @cached_property
    def verdicts(self) -> dict[int, LabelVerdict]:
        """What the check or the annotation tool says of the labels, as far as it holds, by id."""
        return {v.object: v for v in label_verdicts(self.scene)}

    @property
    def unlabelled(self) -> list[str]:
        """Names of the objects without a label."""
        return [o.name for o in self.scene.objects.objects if not self.scene.labels.of(o.id)]

    def camera(self, frame: int) -> Camera:
        """Return the intrinsics of a shared frame."""
        return self.scene.camera(self.scene.frame(self.own_frame[frame]))

    def T_world_cam(self, frame: int) -> SE3 | None:
        """Return the camera pose in this scene's world, metres; None if there is none."""
        own = self.own_frame.get(frame)
        return self.scene.T_world_cam(own) if own is not None and self.posed else None


@dataclass(frozen=True, eq=False)
class LabelledObject:
    """Label of one object by one annotator."""

    owner: AnnotatedScene
    object: Object
    model: Model
    label: Label

    @property
    def name(self) -> str:
        return self.object.name

    @property
    def symmetry(self) -> Symmetry:
        return self.model.symmetry.symmetry()

    @property
    def judged(self) -> LabelVerdict:
        """The stored verdict on the label; "unknown" if there is none that holds."""
        return self.owner.verdicts[self.object.id]

    @cached_property
    def outline(self) -> NDArray[np.float64]:
        """(H, 3) hull vertices of the mesh, mesh frame, metres."""
        return hull_vertices(self.owner.scene.mesh(self.model.id))

    @cached_property
    def centre(self) -> NDArray[np.float64]:
        """(3,) centre of the bounding box, mesh frame, metres."""
        return np.asarray(mesh_bounds(self.owner.scene.mesh(self.model.id)).mean(axis=0))

    @cached_property
    def views(self) -> dict[int, SE3]:
        """T_cam_obj as set by hand, by shared frame id."""
        shared = self.owner.shared_frame
        return {
            shared[frame]: T for frame, T in annotated_views(self.label).items() if frame in shared
        }

    @cached_property
    def T_world_obj(self) -> SE3 | None:
        """Pose in this scene's world; None without metric camera poses.

        Raises:
            ToolkitError: several annotations of the object contradict each other.
        """
        if not self.owner.posed:
            return None
        numbers = self.label.T_world_obj
        if numbers is None or self.owner.as_annotated:
            numbers = place_label(self.owner.scene, self.label).T_world_obj
        return None if numbers is None else pose_from_list(numbers)

    @cached_property
    def poses(self) -> dict[int, SE3]:
        """T_cam_obj in every shared frame for which this label holds."""
        found = {}
        for frame in self.owner.own_frame:
            T_world_cam = self.owner.T_world_cam(frame)
            if self.owner.as_annotated and frame in self.views:
                found[frame] = self.views[frame]
            elif T_world_cam is not None and self.T_world_obj is not None:
                found[frame] = T_world_cam.inverse() @ self.T_world_obj
            elif frame in self.views:
                found[frame] = self.views[frame]
        return found


def open_work(annotated: AnnotatedScene) -> list[str]:
    """Return a sentence on the labels that an annotator has not accepted, if there are any."""
    rows = annotated.scene.annotation
    if not rows.objects:
        return []
    open_ = [x.name for x in annotated.objects if rows.of(x.object.id).status != "done"]
    return [f"{annotated.name} has not marked as done: {', '.join(open_)}"] if open_ else []
