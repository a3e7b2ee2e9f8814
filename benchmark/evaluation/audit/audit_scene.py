"""Frames of a data set as the scene that the judge reads; nothing is written."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmark.data.labelled import FrameImages, LabelledSet
from benchmark.evaluation.audit.rigid import Group
from std_toolkit.checks.gates.located import SHIFT, TURN, Located
from std_toolkit.checks.measure.contours import object_centre
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.geometry.mesh import mesh_diameter, mesh_extents
from std_toolkit.scene import (
    CameraModel,
    CameraPoses,
    Frame,
    FramePose,
    Frames,
    Label,
    Labels,
    Model,
    Object,
    ObjectTable,
    Scene,
    SceneInfo,
)
from std_toolkit.scene.document import safe_name
from std_toolkit.scene.memory_scene import MemoryScene

_KEPT_FRAMES = 3
# Of sets without images: nothing is projected then.
_NO_CAMERA = Camera(640, 480, 600.0, 600.0, 319.5, 239.5)


class AuditScene(Scene):
    """A group of frames with its labels. Object and frame ids count from 1 and 0.

    Args:
        name: of the scene.
        group: the frames; objects without a mesh are left out.
        source: of the images.

    Attributes:
        names: of the objects, by id.
    """

    def __init__(self, name: str, group: Group, source: LabelledSet) -> None:
        self._source, self._indices = source, [f.index for f in group.frames]
        self._images: dict[int, FrameImages] = {}
        known = {n: t for n, t in group.things.items() if t.label.mesh is not None}
        self.names = dict(enumerate(known, 1))
        frames = [
            Frame(id=k, name=safe_name(f.key.name), color=f"{k}.png", depth=f"{k}.png")
            for k, f in enumerate(group.frames)
        ]
        has_images = all(f.has_images for f in group.frames)
        camera = self._first_camera() if has_images else _NO_CAMERA
        meshes = {}
        models = {}
        for thing in known.values():
            label = thing.label
            assert label.mesh is not None
            mesh = label.mesh.load()
            key = safe_name(label.model)
            meshes[key] = mesh
            models[key] = Model(
                id=key,
                mesh=f"{key}.ply",
                size_m=[max(float(x), 1e-6) for x in mesh_extents(mesh)],
                diameter_m=mesh_diameter(mesh),
                symmetry=label.symmetry,
            )
        super().__init__(
            # There is no folder: rendered truth, which the judge would trust, is no part of a set.
            Path("/dev/null") / safe_name(name),
            SceneInfo(name=safe_name(name), cameras={"color": CameraModel.of(camera)}),
            Frames(frames=frames),
            ObjectTable(
                models=list(models.values()),
                objects=[
                    Object(id=i, name=safe_name(n), model=safe_name(known[n].label.model),
                           material=known[n].label.material)
                    for i, n in self.names.items()
                ],
            ),
        )  # fmt: skip
        self._meshes = meshes
        self.__dict__["poses"] = CameraPoses(
            frames=[
                FramePose(frame=k, status="registered", T_world_cam=group.T_world_cam[i].flat())
                for k, i in enumerate(self._indices)
            ]
        )
        self.__dict__["labels"] = Labels(
            labels=[self._label(i, n, group) for i, n in self.names.items()]
        )

    def _label(self, object_id: int, name: str, group: Group) -> Label:
        T_world_obj = group.T_world_obj[name]
        T_cam_obj = group.T_world_cam[self._indices[0]].inverse() @ T_world_obj
        return Label(
            object=object_id, frame=0, T_cam_obj=T_cam_obj.flat(), T_world_obj=T_world_obj.flat()
        )

    def _first_camera(self) -> Camera:
        """That of the first frame that can be read."""
        problem: ToolkitError | None = None
        for frame_id in range(len(self._indices)):
            try:
                return self._read(frame_id).camera
            except ToolkitError as error:
                problem = problem or error
        assert problem is not None  # a group has frames
        raise problem

    def _read(self, frame_id: int) -> FrameImages:
        found = self._images.get(frame_id)
        if found is None:
            while len(self._images) >= _KEPT_FRAMES:
                self._images.pop(next(iter(self._images)))
            found = self._images[frame_id] = self._source.images(self._indices[frame_id])
        return found

    def camera(self, frame: Frame) -> Camera:
        """See `Scene.camera`; frames may have cameras of their own."""
        return self._read(frame.id).camera

    def read_color(self, frame: Frame) -> NDArray[np.uint8]:
        """See `Scene.read_color`."""
        return self._read(frame.id).color

    def read_depth(self, frame: Frame) -> NDArray[np.float32] | None:
        """See `Scene.read_depth`."""
        return self._read(frame.id).depth


class MovedScene(MemoryScene):
    """The frames of an audit with labels moved; see `of`."""

    def __init__(self, scene: AuditScene, labels: Labels) -> None:
        super().__init__(scene, labels=labels)
        self._of = scene

    @staticmethod
    def of(scene: AuditScene, motions: Mapping[int, Located]) -> MovedScene:
        """The scene with some objects where a measurement puts them, by object id."""
        labels = scene.labels
        for object_id, at in motions.items():
            label, pose = labels.of(object_id), scene.T_world_obj(object_id)
            assert label is not None
            assert pose is not None
            centre = object_centre(scene, object_id)
            R = so3_exp(np.deg2rad(at.motion[TURN]))
            change = SE3(R, centre - R @ centre + at.motion[SHIFT] / 1000)
            moved = msgspec.structs.replace(label, T_world_obj=(change @ pose).flat())
            labels = labels.with_label(moved)
        return MovedScene(scene, labels)

    def camera(self, frame: Frame) -> Camera:
        """See `Scene.camera`."""
        return self._of.camera(frame)

    def read_color(self, frame: Frame) -> NDArray[np.uint8]:
        """See `Scene.read_color`."""
        return self._of.read_color(frame)

    def read_depth(self, frame: Frame) -> NDArray[np.float32] | None:
        """See `Scene.read_depth`."""
        return self._of.read_depth(frame)
