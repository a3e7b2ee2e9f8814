"""Known faults put into a scene in memory; no file of the scene changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.detectability import FaultName
from std_toolkit.checks.measure.contours import object_centre
from std_toolkit.geometry import SE3
from std_toolkit.geometry.se3 import so3_exp
from std_toolkit.geometry.turned_surface import turn_about
from std_toolkit.scene import CameraPoses, Frame, ObjectTable, Scene
from std_toolkit.scene.memory_scene import MemoryScene
from std_toolkit.scene.model import Label, pose_from_list

Vector = tuple[float, float, float]

# Axes that differ by less than 10 degrees count as one.
_PARALLEL = float(np.cos(np.deg2rad(10)))


@dataclass(frozen=True, kw_only=True)
class FaultKind:
    """A kind of fault.

    Attributes:
        name: see `detectability.FaultName`.
        heading, title: in words, short and in full.
        unit: of the sizes.
        sizes: sizes to try, ascending.
        signs: directions to try.
        of_scene: whether it concerns the whole scene instead of one object.
    """

    name: FaultName
    heading: str
    title: str
    unit: Literal["mm", "deg", "%", "px"]
    sizes: tuple[float, ...]
    signs: tuple[int, ...] = (1, -1)
    of_scene: bool = False


_MM = (1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 30.0, 50.0)
_DEG = (1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 30.0, 45.0)
KINDS = (
    FaultKind(
        name="sideways", heading="sideways", title="translation sideways", unit="mm", sizes=_MM
    ),
    FaultKind(
        name="along", heading="along view", title="translation along the view", unit="mm", sizes=_MM
    ),
    FaultKind(name="tilt", heading="tilt", title="tilt towards the camera", unit="deg", sizes=_DEG),
    FaultKind(
        name="turn", heading="turn", title="rotation about the upright axis", unit="deg", sizes=_DEG
    ),
    FaultKind(name="scale", heading="size", title="size of the mesh", unit="%", sizes=_DEG[:7]),
    FaultKind(
        name="moved",
        heading="moved",
        title="moved in half of the frames",
        unit="mm",
        sizes=_MM,
        signs=(1,),
    ),
    FaultKind(
        name="camera",
        heading="camera",
        title="camera pose of one frame",
        unit="mm",
        sizes=(*_MM[2:], 80.0, 120.0),
        signs=(1,),
        of_scene=True,
    ),
    FaultKind(
        name="alignment",
        heading="depth shift",
        title="depth shifted against colour",
        unit="px",
        sizes=(1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0),
        signs=(1,),
        of_scene=True,
    ),
)


@dataclass(frozen=True)
class Fault:
    """A fault of a given size.

    Attributes:
        name: kind of the fault.
        size: signed, in the unit of the kind.
        object: id of the object; 0 for a fault of the scene.
        frame: id of the frame with the wrong camera pose.
        up, along: unit vectors in the world: up, and from the cameras to the object.
    """

    name: FaultName
    size: float
    object: int = 0
    frame: int | None = None
    up: Vector = (0.0, 0.0, 1.0)
    along: Vector = (0.0, 1.0, 0.0)

    @property
    def sideways(self) -> NDArray[np.float64]:
        """Horizontal unit vector across the view."""
        across = np.cross(self.along, self.up)
        length = float(np.linalg.norm(across))
        if length < 1e-3:  # the view is vertical: any horizontal direction is across it
            across = np.cross(self.up, np.eye(3)[int(np.argmin(np.abs(self.up)))])
            length = float(np.linalg.norm(across))
        return np.asarray(across / length)


class FaultyScene(MemoryScene):
    """A scene in memory with a fault.

    Args:
        scene: the scene.
        depth_shift_px: number of columns by which sensor depth is moved to the right.
        changes: see `MemoryScene`.
    """

    def __init__(self, scene: Scene, *, depth_shift_px: int = 0, **changes: Any) -> None:
        super().__init__(scene, **changes)
        self._depth_shift_px = depth_shift_px

    def read_depth(self, frame: Frame) -> NDArray[np.float32] | None:
        """See `Scene.read_depth`; columns without a source have no measurement."""
        depth = super().read_depth(frame)
        shift = self._depth_shift_px
        if depth is None or shift == 0:
            return depth
        moved = np.zeros_like(depth)
        moved[:, shift:] = depth[:, :-shift]
        return moved


def apply_fault(scene: Scene, fault: Fault) -> FaultyScene:
    """The scene with a fault.

    Object faults act about the centre of the mesh's bounding box. For "moved" the label is
    displaced; the caller measures it in some of the frames only.
    """
    if fault.name == "alignment":
        return FaultyScene(scene, depth_shift_px=round(fault.size))
    if fault.name == "camera":
        return FaultyScene(scene, poses=_with_camera_off(scene, fault))
    if fault.name == "scale":
        return _with_mesh_scaled(scene, fault)
    change = _world_change(scene, fault)
    label = scene.labels.of(fault.object)
    assert label is not None
    return FaultyScene(scene, labels=scene.labels.with_label(_displaced(scene, label, change)))


def has_no_effect(scene: Scene, kind: FaultKind, fault: Fault) -> bool:
    """Whether a rotation is a symmetry of the object, so that it is no fault."""
    if kind.name not in ("tilt", "turn"):
        return False
    symmetry = scene.objects.model_of(fault.object).symmetry.symmetry()
    T_world_obj = scene.T_world_obj(fault.object)
    assert T_world_obj is not None
    axis = fault.sideways if kind.name == "tilt" else np.array(fault.up)
    return symmetry.is_spherical or any(
        abs(float(T_world_obj.R @ np.array(a) @ axis)) > _PARALLEL for a, _ in symmetry.continuous
    )


def _world_change(scene: Scene, fault: Fault) -> SE3:
    """Motion of the object in the world."""
    if fault.name in ("sideways", "along", "moved"):
        direction = np.array(fault.along) if fault.name == "along" else fault.sideways
        return SE3(np.eye(3), fault.size / 1000 * direction)
    axis = fault.sideways if fault.name == "tilt" else np.array(fault.up)
    R = so3_exp(np.deg2rad(fault.size) * axis)
    return turn_about(object_centre(scene, fault.object), R)


def _displaced(scene: Scene, label: Label, change: SE3) -> Label:
    """The label with its world pose and its annotated poses displaced."""

    def in_camera(frame: int, T_cam_obj: list[float]) -> list[float]:
        T_world_cam = scene.T_world_cam(frame)
        if T_world_cam is None:
            return T_cam_obj
        moved = T_world_cam.inverse() @ change @ T_world_cam @ pose_from_list(T_cam_obj)
        return moved.flat()

    assert label.T_world_obj is not None
    return msgspec.structs.replace(
        label,
        T_world_obj=(change @ pose_from_list(label.T_world_obj)).flat(),
        T_cam_obj=in_camera(label.frame, label.T_cam_obj),
        views={key: in_camera(int(key), T) for key, T in label.views.items()},
    )


def _with_camera_off(scene: Scene, fault: Fault) -> CameraPoses:
    """The camera poses with one camera displaced along its x axis."""
    assert scene.poses is not None
    shift = SE3(np.eye(3), np.array([fault.size / 1000, 0, 0]))
    return msgspec.structs.replace(
        scene.poses,
        frames=[
            msgspec.structs.replace(p, T_world_cam=(pose_from_list(p.T_world_cam) @ shift).flat())
            if p.frame == fault.frame and p.T_world_cam is not None
            else p
            for p in scene.poses.frames
        ],
    )


def _with_mesh_scaled(scene: Scene, fault: Fault) -> FaultyScene:
    """The object gets a model of its own, scaled about the centre of its bounding box."""
    item = scene.objects.object(fault.object)
    factor = 1 + fault.size / 100
    model = scene.objects.model(item.model)
    scaled = msgspec.structs.replace(
        model,
        id=f"{model.id}.scaled",
        size_m=[factor * s for s in model.size_m],
        diameter_m=factor * model.diameter_m,
    )
    mesh = scene.mesh(item.model).copy()
    centre = np.asarray(mesh.bounds).mean(axis=0)
    mesh.vertices = centre + factor * (np.asarray(mesh.vertices) - centre)
    objects = ObjectTable(
        models=[*scene.objects.models, scaled],
        objects=[
            msgspec.structs.replace(o, model=scaled.id) if o.id == item.id else o
            for o in scene.objects.objects
        ],
    )
    return FaultyScene(scene, objects=objects, meshes={scaled.id: mesh})
