"""A simulated scene as a camera would leave it, and its truth beside it.

The form is that of the quick synthetic recordings (`sensors.synthetic`), so that the same import,
annotation and scoring work on it: color/, depth/ (16 bit), models/, intrinsics.json, truth.json.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sensors.output.frame import SimulatedFrame, SimulatedScene
from sensors.output.intake import Intake
from sensors.output.models import metric_objects
from sensors.output.record import scene_record
from sensors.output.toolkit_scene import frame_name, label_color
from std_toolkit.errors import ToolkitError
from std_toolkit.importers.foreign_files import write_mesh
from std_toolkit.io.atomic import new_folder
from std_toolkit.io.documents import write_document
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.scene.model import CameraModel

if TYPE_CHECKING:
    from sensors.synthetic.recording import Truth
    from std_toolkit.geometry.camera import Camera
    from std_toolkit.geometry.se3 import SE3

DEPTH_SCALE = 0.001
_LARGEST_VALUE = 65535


class RecordingWriter:
    """Writes the frames of one recording; see `simulated_recording`."""

    def __init__(self, folder: Path, intake: Intake, depth_scale: float) -> None:
        self._folder = folder
        self._intake = intake
        self._depth_scale = depth_scale

    def add(self, frame: SimulatedFrame) -> None:
        """Write colour and depth of a frame. Frames may come in any order.

        Readings beyond what 16 bits hold are lost, as in a camera.

        Raises:
            ToolkitError: the frame does not belong to the scene, objects were left out of it, or
                the disk is full.
        """
        self._intake.accept(frame)
        if frame.hidden:
            raise ToolkitError(
                "in a recording every object is in every frame",
                field=f"frame {frame.index}: hidden",
                value=frame.hidden,
            )
        write_images(self._folder, frame, depth_scale=self._depth_scale)

    def finish(self) -> None:
        """Write models, intrinsics and truth, when every frame was added.

        Raises:
            ToolkitError: frames are missing.
        """
        self._intake.require_all()
        scene, folder = self._intake.scene, self._folder
        poses = [self._intake.poses[i][0] for i in range(scene.frames)]
        write_document(folder / "simulation.json", scene_record(self._intake))
        write_truth(folder, scene, self._intake.label_camera, poses, depth_scale=self._depth_scale)


def write_images(folder: Path, frame: SimulatedFrame, *, depth_scale: float) -> None:
    """Colour, then depth: where the depth of a frame is, its colour is, too.

    Raises:
        ToolkitError: the disk is full.
    """
    name, depth = frame_name(frame.index), frame.depth_aligned
    within = depth <= _LARGEST_VALUE * depth_scale
    write_color(folder / f"color/{name}.png", label_color(frame))
    write_depth_png16(folder / f"depth/{name}.png", np.where(within, depth, 0), scale=depth_scale)


def write_truth(
    folder: Path,
    scene: SimulatedScene,
    camera: Camera,
    T_world_cam: Sequence[SE3],
    *,
    depth_scale: float,
) -> Truth:
    """Models, intrinsics and, last of all, truth.json.

    Args:
        folder: of the recording.
        scene: what was recorded.
        camera: of the written images.
        T_world_cam: of every frame.
        depth_scale: metres per unit of the depth images.
    """
    # Brings Open3D; nothing else here needs it.
    from sensors.synthetic.recording import TrueObject, Truth

    objects = []
    for thing in metric_objects(scene):
        mesh = f"models/{thing.name}{Path(thing.model.mesh).suffix}"
        write_mesh(folder / mesh, thing.mesh)
        objects.append(
            TrueObject(
                name=thing.name,
                category=thing.item.category,
                class_id=thing.item.class_id,
                material=thing.item.material_class,
                mesh=mesh,
                symmetry=thing.model.symmetry,
                T_world_obj=thing.item.T_world_obj.flat(),
            )
        )
    intrinsics = {"width": camera.width, "height": camera.height, "K": camera.K.tolist()}
    if camera.is_distorted:
        intrinsics["distortion"] = list(camera.distortion)
    write_document(folder / "intrinsics.json", intrinsics)
    truth = Truth(
        camera=CameraModel.of(camera),
        depth_scale=depth_scale,
        # What the sensor gets wrong is simulated, not a known factor.
        depth_bias=1.0,
        frames=[frame_name(i) for i in range(len(T_world_cam))],
        T_world_cam=[pose.flat() for pose in T_world_cam],
        objects=objects,
    )
    write_document(folder / "truth.json", truth)
    return truth


@contextmanager
def simulated_recording(
    out: Path, scene: SimulatedScene, *, depth_scale: float = DEPTH_SCALE
) -> Iterator[RecordingWriter]:
    """A writer of a recording, which appears at `out` when the block ends without an error.

    Args:
        out: new folder.
        scene: what all frames share; their poses should follow a smooth way.
        depth_scale: metres per unit of the depth images.

    Raises:
        ToolkitError: something is at `out` already, or not every frame was written.
    """
    if not 0 < depth_scale <= 1:
        raise ToolkitError("must lie above 0 and at most 1", field="depth_scale", value=depth_scale)
    with new_folder(out) as folder:
        writer = RecordingWriter(folder, Intake(scene), depth_scale)
        yield writer
        writer.finish()
