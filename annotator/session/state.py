"""Annotation state: immutable documents, camera poses, and snapshots of both for other threads."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from annotator.session.meshes import MeshLibrary
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.scene import Object, ObjectTable, Scene, document
from std_toolkit.scene.judgement import Judgement, kept_judgement
from std_toolkit.scene.model import Material, Model
from std_toolkit.scene.scene import require_metres

if TYPE_CHECKING:
    import trimesh

Status = Literal["open", "done"]


class Click(document.Document, frozen=True, kw_only=True):
    """Clicked 2D-3D correspondence.

    Attributes:
        u, v: pixel in the recorded image (lens distortion included), centres at integers.
        point: the same point on the mesh, metres, mesh frame.
    """

    u: float
    v: float
    point: document.Vector3

    def check(self) -> None:
        # JSON has no NaN: such a click could not be decoded.
        if not all(math.isfinite(x) for x in (self.u, self.v, *self.point)):
            raise ToolkitError("a click needs finite numbers", value=[self.u, self.v, *self.point])


class Placement(document.Document, frozen=True, kw_only=True):
    """Pose of an object in one frame, with its provenance.

    Attributes:
        T_cam_obj: mesh frame to the camera of the frame, metres.
        method: origin of the pose, such as "drag", "typed", "pnp", "refine".
        refinement: sentence on the refinement that computed it, or "" if moved by hand since.
        annotator: name of the annotator.
        time: UTC, ISO 8601.
    """

    T_cam_obj: document.Pose16
    method: str = ""
    refinement: str = ""
    annotator: str = ""
    time: str = ""

    def check(self) -> None:
        document.check_pose(self.T_cam_obj, "T_cam_obj")

    @property
    def pose(self) -> SE3:
        return document.pose_from_list(self.T_cam_obj)


class ObjectState(document.Document, frozen=True, kw_only=True):
    """Annotation of one object.

    Attributes:
        id: 1..254, its value in masks.
        placements: poses by frame id. In a scene with metric camera poses there is at most one, and
            it holds for every frame; otherwise each frame has its own.
        clicks: 2D-3D correspondences by frame id.
        status: "done" if the annotator has finished it.
        note: free text, such as what to check.
        locked: whether edits of its pose are refused.
        judgement: what was measured of the pose in the frame `judged_frame`, as long as there is
            such a measurement; `Queries.judgement` says whether it still holds.
        judged_frame: frame whose camera `judgement.T_obj` refers to.
    """

    id: document.ObjectId
    name: str
    model: str
    material: Material
    status: Status = "open"
    note: str = ""
    locked: bool = False
    judgement: Judgement | msgspec.UnsetType = msgspec.UNSET
    judged_frame: document.Count | msgspec.UnsetType = msgspec.UNSET
    placements: dict[document.Count, Placement] = msgspec.field(default_factory=dict)
    clicks: dict[document.Count, list[Click]] = msgspec.field(default_factory=dict)

    def check(self) -> None:
        document.check_name(self.name)


class AnnotationState(document.Document, frozen=True, kw_only=True):
    """Complete state that edits change."""

    models: list[Model] = msgspec.field(default_factory=list)
    objects: list[ObjectState] = msgspec.field(default_factory=list)

    def check(self) -> None:
        document.check_unique([m.id for m in self.models], "models", "id")
        document.check_unique([o.name for o in self.objects], "objects", "name")
        document.check_unique([str(o.id) for o in self.objects], "objects", "id")
        for obj in self.objects:
            self.model(obj.model)

    def object(self, name: str) -> ObjectState:
        """Return an entry by name; raises ToolkitError with the known names if there is none."""
        return document.find_row(self.objects, "name", name, "object")

    def model(self, model_id: str) -> Model:
        """Return an entry by name; raises ToolkitError with the known names if there is none."""
        return document.find_row(self.models, "id", model_id, "model")

    def model_of(self, name: str) -> Model:
        return self.model(self.object(name).model)

    def with_object(self, obj: ObjectState) -> AnnotationState:
        """Return a copy in which `obj` replaces the object of its id or is added."""
        kept = [o for o in self.objects if o.id != obj.id]
        return msgspec.structs.replace(self, objects=sorted([*kept, obj], key=lambda o: o.id))

    def with_model(self, model: Model) -> AnnotationState:
        """Return a copy in which `model` replaces the model of its id or is added."""
        kept = [m for m in self.models if m.id != model.id]
        return msgspec.structs.replace(self, models=sorted([*kept, model], key=lambda m: m.id))


@dataclass(frozen=True)
class Judged:
    """A judgement, and the frame of coordinates of its poses.

    Attributes:
        judgement: the verdict.
        frame: frame id of the camera; None for the world.
    """

    judgement: Judgement
    frame: int | None = None


@dataclass(frozen=True)
class Cameras:
    """Metric camera poses of a scene; immutable.

    Attributes:
        problem: text on why poses of objects cannot be propagated between frames; None if they can.
        frames: ids of the frames in which a pose can be set, in recording order.
    """

    problem: str | None
    frames: tuple[int, ...]
    _T_world_cam: dict[int, SE3] = field(repr=False)

    @staticmethod
    def of(scene: Scene) -> Cameras:
        """Read the camera poses; raises ToolkitError if poses.json cannot be read."""
        problem = _pose_problem(scene)
        if problem is not None:
            return Cameras(problem, tuple(f.id for f in scene.frames), {})
        known = {f.id: T for f in scene.frames if (T := scene.T_world_cam(f.id)) is not None}
        return Cameras(None, tuple(known), known)

    @property
    def posed(self) -> bool:
        """Whether one pose of an object holds in all frames."""
        return self.problem is None

    @cached_property
    def frame_set(self) -> frozenset[int]:
        return frozenset(self.frames)

    def T_world_cam(self, frame: int) -> SE3 | None:
        """Return the camera pose in metres; None if there is none."""
        return self._T_world_cam.get(frame)

    def pose(self, state: AnnotationState, name: str, frame: int) -> SE3 | None:
        """Return T_cam_obj of an object in a frame; None if it has none."""
        placements = state.object(name).placements
        if frame in placements:
            return placements[frame].pose
        T_world_cam, T_world_obj = self.T_world_cam(frame), self.T_world_obj(state, name)
        if T_world_cam is None or T_world_obj is None:
            return None
        return T_world_cam.inverse() @ T_world_obj

    def judgement(
        self, state: AnnotationState, name: str, measured: Judged | None = None
    ) -> Judgement | None:
        """Return what was measured of an object's present pose, in the camera of its first frame.

        Notes, status and nudges keep it while the pose lies within a tenth of its deviation from
        the one that was measured; nudges add up. None if there is none, or the pose left it behind.

        Args:
            measured: what was measured meanwhile; it counts first.
        """
        obj = state.object(name)
        if measured is None and not isinstance(obj.judged_frame, msgspec.UnsetType):
            assert not isinstance(obj.judgement, msgspec.UnsetType)
            measured = Judged(obj.judgement, obj.judged_frame)
        if measured is None or not obj.placements:
            return None
        at = measured.frame
        now = self.T_world_obj(state, name) if at is None else self.pose(state, name, at)
        judgement = kept_judgement(measured.judgement, now)
        if isinstance(judgement, msgspec.UnsetType):
            return None
        frame = next(iter(obj.placements))
        if frame == at:
            return judgement
        there = self.pose(state, name, frame)
        if there is None or now is None:
            return None
        T_there_here = there @ now.inverse()
        moved = {
            key: (T_there_here @ document.pose_from_list(T)).flat()
            for key in ("T_obj", "T_rival")
            if (T := getattr(judgement, key)) is not None
        }
        return msgspec.structs.replace(judgement, **moved)

    def T_world_obj(self, state: AnnotationState, name: str) -> SE3 | None:
        """Return the world pose of an object; None if not placed in a frame with a camera pose."""
        for frame, placement in state.object(name).placements.items():
            T_world_cam = self.T_world_cam(frame)
            if T_world_cam is not None:
                return T_world_cam @ placement.pose
        return None


def _pose_problem(scene: Scene) -> str | None:
    if scene.poses is None or not scene.registered_frames():
        return "The scene has no camera poses, so each frame is labelled on its own."
    try:
        require_metres(scene)
    except ToolkitError:
        return "The camera poses have no metric scale, so each frame is labelled on its own."
    return None


class Queries:
    """Queries shared by `Session` and `Snapshot`, which provide state, cameras and meshes."""

    @property
    def state(self) -> AnnotationState:
        """The annotation state; immutable."""
        raise NotImplementedError

    @property
    def cameras(self) -> Cameras:
        """Camera poses in metres; immutable."""
        raise NotImplementedError

    @property
    def meshes(self) -> MeshLibrary:
        """The mesh cache."""
        raise NotImplementedError

    @property
    def posed(self) -> bool:
        """Whether camera poses are metric: one pose of an object holds in all frames."""
        return self.cameras.posed

    @property
    def pose_problem(self) -> str | None:
        """Text on why poses of objects cannot be propagated between frames; None if they can."""
        return self.cameras.problem

    @property
    def frames(self) -> tuple[int, ...]:
        """Ids of the frames in which a pose can be set, in recording order."""
        return self.cameras.frames

    def T_world_cam(self, frame: int) -> SE3 | None:
        """Return the camera pose in metres; None if there is none."""
        return self.cameras.T_world_cam(frame)

    def T_cam_of(self, frame: int, frame_name: str) -> SE3 | None:
        """Transform of "world" or "camera 12" to the camera of a frame; None if unknown."""
        if frame_name == f"camera {frame}":
            return SE3.identity()
        T_world_cam = self.T_world_cam(frame)
        if T_world_cam is None or frame_name == "world":
            return None if T_world_cam is None else T_world_cam.inverse()
        T_world_other = self.T_world_cam(int(frame_name.split()[-1]))
        return None if T_world_other is None else T_world_cam.inverse() @ T_world_other

    def object(self, name: str) -> ObjectState:
        """Return an object by name; raises ToolkitError if there is none."""
        return self.state.object(name)

    def pose(self, name: str, frame: int) -> SE3 | None:
        """Return T_cam_obj of an object in a frame; None if it has no pose."""
        return self.cameras.pose(self.state, name, frame)

    def judgement(self, name: str) -> Judgement | None:
        """Return what was measured of an object's present pose; see `Cameras.judgement`."""
        return self.cameras.judgement(self.state, name)

    def T_world_obj(self, name: str) -> SE3 | None:
        """Return the world pose of an object; None if not placed or without metric camera poses."""
        return self.cameras.T_world_obj(self.state, name)

    def mesh(self, model_id: str) -> trimesh.Trimesh:
        """Return the mesh of a library model, metres; must not be modified.

        Raises:
            ToolkitError: there is no such model, or its file is missing or damaged.
        """
        return self.meshes.mesh(self.state.model(model_id))

    def centre(self, model_id: str) -> NDArray[np.float64]:
        """Return the (3,) bounding box centre of a model, mesh frame, metres; raises as `mesh`."""
        return self.meshes.centre(self.state.model(model_id))


class Snapshot(Queries):
    """Immutable copy of a session, unaffected by later edits.

    Attributes:
        scene: the scene with the models and objects of the state, including unsaved ones; for
            cameras, images and depth. It has no labels: `pose` returns poses of objects.
        writable: whether files may be added to the scene folder.
        annotator: name of the annotator.
    """

    def __init__(
        self,
        scene: Scene,
        state: AnnotationState,
        cameras: Cameras,
        meshes: MeshLibrary,
        *,
        writable: bool,
        annotator: str,
    ) -> None:
        self.scene = scene.copy(objects=object_table(state))
        self.writable = writable
        self.annotator = annotator
        self._state, self._cameras, self._meshes = state, cameras, meshes

    def with_model(self, model: Model) -> Snapshot:
        """Return a copy with an additional model, such as the first of several added meshes."""
        return Snapshot(
            self.scene,
            self._state.with_model(model),
            self._cameras,
            self._meshes,
            writable=self.writable,
            annotator=self.annotator,
        )

    @property
    def state(self) -> AnnotationState:
        return self._state

    @property
    def cameras(self) -> Cameras:
        return self._cameras

    @property
    def meshes(self) -> MeshLibrary:
        return self._meshes


def object_table(state: AnnotationState) -> ObjectTable:
    """Return the contents of objects.json for a state."""
    return ObjectTable(
        models=state.models,
        objects=[
            Object(id=o.id, name=o.name, model=o.model, material=o.material) for o in state.objects
        ],
    )
