"""A scene folder: documents are read once and validated, images are read on demand."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.depth_maps import check_depth_unit
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io import documents, images, locks
from std_toolkit.io.documents import digest_file
from std_toolkit.scene import frame_names
from std_toolkit.scene.model import (
    Annotation,
    CameraPoses,
    Frame,
    FramePose,
    Frames,
    Label,
    Labels,
    Model,
    ObjectTable,
    SceneInfo,
    pose_from_list,
)

if TYPE_CHECKING:
    import trimesh


class Scene:
    """One recording on disk.

    Documents are immutable; `save_*` writes a new one atomically and replaces the one in memory.
    """

    def __init__(self, root: Path, info: SceneInfo, frames: Frames, objects: ObjectTable) -> None:
        self.root = root
        self.info = info
        self.frame_table = frames
        self.objects = objects
        self._meshes: dict[str, trimesh.Trimesh] = {}
        self._mesh_digests: dict[str, str] = {}
        _check_cameras(root, info, frames)

    @staticmethod
    def open(root: Path | str) -> Scene:
        """Open and validate the documents of a scene folder.

        Raises:
            ToolkitError: the folder has no scene, or a document violates its schema.
        """
        root = Path(root)
        if not (root / "scene.json").is_file():
            raise ToolkitError(
                "no scene here (scene.json is missing)",
                path=root,
                hint="make one with `std-curate import`",
            )
        objects_path = root / "objects.json"
        return Scene(
            root,
            documents.read_document(root / "scene.json", SceneInfo),
            documents.read_document(root / "frames.json", Frames),
            documents.read_document(objects_path, ObjectTable)
            if objects_path.exists()
            else ObjectTable(),
        )

    @staticmethod
    def create(
        root: Path | str, info: SceneInfo, frames: Frames, objects: ObjectTable | None = None
    ) -> Scene:
        """Write the documents of a new scene.

        scene.json is written last, so that an incomplete scene is not a scene.

        Raises:
            ToolkitError: the folder already has a scene.
        """
        root = Path(root)
        if (root / "scene.json").exists():
            raise ToolkitError(
                "there is a scene here already", path=root, hint="choose another --out"
            )
        scene = Scene(root, info, frames, objects or ObjectTable())
        documents.write_document(root / "frames.json", scene.frame_table)
        documents.write_document(root / "objects.json", scene.objects)
        documents.write_document(root / "scene.json", info)
        return scene

    def copy(self, *, objects: ObjectTable | None = None) -> Scene:
        """Return a copy of the scene that later changes of this one do not affect.

        Args:
            objects: replaces the models and objects of this scene. The copy then has no labels,
                because they may refer to other objects.
        """
        twin = Scene(self.root, self.info, self.frame_table, objects or self.objects)
        twin.__dict__["poses"] = self.poses
        twin.__dict__["labels"] = self.labels if objects is None else Labels()
        return twin

    # --- documents -------------------------------------------------------------------------

    @property
    def frames(self) -> list[Frame]:
        """Frames in recording order."""
        return self.frame_table.frames

    @cached_property
    def poses(self) -> CameraPoses | None:
        """Camera poses, or None if they have not been recovered or imported."""
        path = self.root / "poses.json"
        if not path.exists():
            return None
        return self._checked_poses(documents.read_document(path, CameraPoses))

    @cached_property
    def labels(self) -> Labels:
        """Labels; empty before the first annotation."""
        path = self.root / "labels.json"
        if not path.exists():
            return Labels()
        return self._checked_labels(documents.read_document(path, Labels))

    @cached_property
    def annotation(self) -> Annotation:
        """State of the manual annotation; empty before the first annotation."""
        path = self.root / "annotation.json"
        if not path.exists():
            return Annotation()
        return self._checked_annotation(documents.read_document(path, Annotation))

    def save_info(self, info: SceneInfo) -> None:
        """Write scene.json.

        Raises:
            ToolkitError: a frame's camera is missing from it, or it cannot be written.
        """
        _check_cameras(self.root, info, self.frame_table)
        documents.write_document(self.root / "scene.json", info)
        self.info = info

    def save_objects(self, objects: ObjectTable) -> None:
        """Write objects.json."""
        documents.write_document(self.root / "objects.json", objects)
        self.objects = objects

    def save_poses(self, poses: CameraPoses) -> None:
        """Save the camera poses, with the disagreement of the scale sources computed again.

        Raises:
            ToolkitError: a frame or camera is not in the scene.
        """
        if poses.scale is not None:
            poses = msgspec.structs.replace(poses, scale=poses.scale.consistent())
        documents.write_document(self.root / "poses.json", self._checked_poses(poses))
        self.__dict__["poses"] = poses
        self.__dict__.pop("_pose_by_frame", None)

    def save_labels(self, labels: Labels) -> None:
        """Save the labels.

        Raises:
            ToolkitError: an object or frame is not in the scene.
        """
        documents.write_document(self.root / "labels.json", self._checked_labels(labels))
        self.__dict__["labels"] = labels

    def save_annotation(self, annotation: Annotation) -> None:
        """Save the state of the annotation.

        Raises:
            ToolkitError: an object or frame is not in the scene.
        """
        documents.write_document(
            self.root / "annotation.json", self._checked_annotation(annotation)
        )
        self.__dict__["annotation"] = annotation

    def _checked_poses(self, poses: CameraPoses) -> CameraPoses:
        path = self.root / "poses.json"
        for i, pose in enumerate(poses.frames):
            if pose.frame not in self._frame_by_id:
                raise _missing("frame in frames.json", path, f"frames[{i}].frame", pose.frame)
        for key, camera in poses.cameras.items():
            recorded = self.info.cameras.get(key)
            if recorded is None:
                raise _missing("camera in scene.json", path, "cameras", key)
            if (camera.width, camera.height) != (recorded.width, recorded.height):
                raise ToolkitError(
                    f"refined for another image size than {recorded.width}x{recorded.height}",
                    path=path,
                    field=f"cameras.{key}",
                    value=f"{camera.width}x{camera.height}",
                )
        return poses

    def _checked_labels(self, labels: Labels) -> Labels:
        path = self.root / "labels.json"
        objects = {o.id for o in self.objects.objects}
        for i, label in enumerate(labels.labels):
            if label.object not in objects:
                field = f"labels[{i}].object"
                raise _missing("object in objects.json", path, field, label.object)
            for field, frame in [("frame", label.frame), *(("views", int(k)) for k in label.views)]:
                if frame not in self._frame_by_id:
                    raise _missing("frame in frames.json", path, f"labels[{i}].{field}", frame)
        return labels

    def _checked_annotation(self, annotation: Annotation) -> Annotation:
        path = self.root / "annotation.json"
        objects = {o.id for o in self.objects.objects}
        for i, row in enumerate(annotation.objects):
            if row.object not in objects:
                field = f"objects[{i}].object"
                raise _missing("object in objects.json", path, field, row.object)
            for j, click in enumerate(row.clicks):
                if click.frame not in self._frame_by_id:
                    field = f"objects[{i}].clicks[{j}].frame"
                    raise _missing("frame in frames.json", path, field, click.frame)
        return annotation

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Lock the scene for writing and reread its documents; see `scene_lock`."""
        with locks.scene_lock(self.root):
            # Another process may have written between `open` and the lock.
            self.reread()
            yield

    def reread(self) -> None:
        """Reread scene.json, frames.json and objects.json; other documents on next access.

        Raises:
            ToolkitError: see `open`; the scene is unchanged then.
        """
        now = Scene.open(self.root)
        self.info, self.frame_table, self.objects = now.info, now.frame_table, now.objects
        self._meshes.clear()
        self._mesh_digests.clear()
        for name, value in vars(type(self)).items():
            if isinstance(value, cached_property):
                self.__dict__.pop(name, None)

    # --- frames ----------------------------------------------------------------------------

    @cached_property
    def _frame_by_id(self) -> dict[int, Frame]:
        return {f.id: f for f in self.frames}

    def frame(self, frame_id: int) -> Frame:
        """Return the frame with this id.

        Raises:
            ToolkitError: there is no such frame.
        """
        if frame_id in self._frame_by_id:
            return self._frame_by_id[frame_id]
        raise ToolkitError(
            "no such frame",
            path=self.root,
            value=frame_id,
            hint="see `std-curate info SCENE --frames`",
        )

    def find_frame(self, given: str | int) -> Frame:
        """Return the frame that a user names by its id, its name or its file; see `find_frame`.

        Programs that hold an id use `frame`.

        Raises:
            ToolkitError: there is no such frame, or a number means two frames.
        """
        return frame_names.find_frame(self.frames, given, root=self.root)

    def camera(self, frame: Frame) -> Camera:
        """Return the intrinsics of a frame, refined with the poses or else from scene.json."""
        refined = self.poses.cameras if self.poses is not None else {}
        return refined.get(frame.camera, self.info.cameras[frame.camera]).camera()

    def color_path(self, frame: Frame) -> Path:
        """File of the colour image."""
        return self.root / frame.color

    def read_color(self, frame: Frame) -> NDArray[np.uint8]:
        """Read the colour image, (H, W, 3) uint8 RGB."""
        return images.read_color(self.color_path(frame), size=self.camera(frame).size)

    def read_depth(self, frame: Frame) -> NDArray[np.float32] | None:
        """Read the sensor z-depth (H, W), metres, times `depth_correction`; None if absent.

        Raises:
            ToolkitError: the image cannot be read, or has a wrong size or an implausible unit.
        """
        if frame.depth is None:
            return None
        path = self.root / frame.depth
        depth = images.read_depth(path, scale=self.info.depth_scale, size=self.camera(frame).size)
        check_depth_unit(path, depth, self.info.depth_scale)
        return depth * np.float32(self.info.depth_correction)

    # --- geometry --------------------------------------------------------------------------

    @cached_property
    def _pose_by_frame(self) -> dict[int, FramePose]:
        return {} if self.poses is None else {p.frame: p for p in self.poses.frames}

    def T_world_cam(self, frame_id: int) -> SE3 | None:
        """Return the camera pose of a frame; None if it is not registered."""
        pose = self._pose_by_frame.get(frame_id)
        if pose is None or pose.T_world_cam is None:
            return None
        return pose_from_list(pose.T_world_cam)

    def registered_frames(self) -> list[Frame]:
        """Return the frames that have a camera pose."""
        known = {i for i, pose in self._pose_by_frame.items() if pose.T_world_cam is not None}
        return [f for f in self.frames if f.id in known]

    def T_world_obj(self, object_id: int) -> SE3 | None:
        """Return the propagated pose of an object; None without label or propagation."""
        label: Label | None = self.labels.of(object_id)
        if label is None or label.T_world_obj is None:
            return None
        return pose_from_list(label.T_world_obj)

    def T_cam_obj(self, frame_id: int, object_id: int) -> SE3 | None:
        """Return the pose of an object in the camera of a frame; None if a pose is missing."""
        T_world_cam, T_world_obj = self.T_world_cam(frame_id), self.T_world_obj(object_id)
        if T_world_cam is None or T_world_obj is None:
            return None
        return T_world_cam.inverse() @ T_world_obj

    def mesh_path(self, model: Model) -> Path:
        """File of the mesh."""
        return self.root / model.mesh

    def mesh(self, model_id: str) -> trimesh.Trimesh:
        """Return the mesh of a model, vertices in metres; read once."""
        if model_id not in self._meshes:
            from std_toolkit.geometry.mesh import load_mesh

            self._meshes[model_id] = load_mesh(self.mesh_path(self.objects.model(model_id)))
        return self._meshes[model_id]

    def mesh_digest(self, model_id: str) -> str:
        """Return the hex digest of the mesh file of a model; computed once."""
        if model_id not in self._mesh_digests:
            path = self.mesh_path(self.objects.model(model_id))
            self._mesh_digests[model_id] = digest_file(path)
        return self._mesh_digests[model_id]


def _check_cameras(root: Path, info: SceneInfo, frames: Frames) -> None:
    for i, frame in enumerate(frames.frames):
        if frame.camera not in info.cameras:
            raise ToolkitError(
                "no such camera in scene.json",
                path=root / "frames.json",
                field=f"frames[{i}].camera",
                value=frame.camera,
            )


def require_metres(scene: Scene) -> None:
    """Check that the camera poses are metric; for steps that combine them with metric data.

    Raises:
        ToolkitError: the unit of the camera poses is unknown.
    """
    poses = scene.poses
    if poses is not None and poses.scale is not None and poses.scale.unit != "metre":
        raise ToolkitError(
            "the unit of these camera poses is unknown",
            path=scene.root / "poses.json",
            field="scale.unit",
            value=poses.scale.unit,
            hint="run `std-curate poses` with a scale source (sensor depth, --board FILE, or an "
            "object annotated in two or more frames)",
        )


def _missing(what: str, path: Path, field: str, value: object) -> ToolkitError:
    return ToolkitError(f"no such {what}", path=path, field=field, value=value)
