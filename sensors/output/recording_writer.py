"""A simulated scene in the form of a camera recording, with its ground truth.

The layout is that of the quick synthetic recordings (`sensors.synthetic`), so that the same import,
annotation and scoring apply: color/, depth/ (16 bit), models/, intrinsics.json, truth.json.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np

from sensors.output.scene_record import ReceivedFrames, scene_record
from sensors.output.simulated_frame import SimulatedFrame, SimulatedScene
from sensors.output.toolkit_scene import frame_name, label_color, metric_objects
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera
from std_toolkit.geometry.se3 import SE3
from std_toolkit.importers.foreign_files import write_mesh
from std_toolkit.io import atomic, documents, images
from std_toolkit.scene.model import CameraModel, Material, SymmetryModel

DEPTH_SCALE = 0.001

_LARGEST_VALUE = 65535


class TrueObject(msgspec.Struct, frozen=True, kw_only=True):
    """An object of the recording; `mesh` is relative to the recording's folder."""

    name: str
    category: str
    class_id: int
    material: Material
    mesh: str
    symmetry: SymmetryModel
    T_world_obj: list[float]


class Truth(msgspec.Struct, frozen=True, kw_only=True):
    """truth.json: ground truth of the recording. World frame: z up, table top at z = 0."""

    camera: CameraModel
    depth_scale: float
    depth_bias: float
    frames: list[str]
    T_world_cam: list[list[float]]
    objects: list[TrueObject]

    def camera_pose(self, index: int) -> SE3:
        return SE3.from_matrix(self.T_world_cam[index])

    def object_pose(self, name: str) -> SE3:
        return SE3.from_matrix(next(o.T_world_obj for o in self.objects if o.name == name))


def read_truth(recording: Path) -> Truth:
    """Ground truth of a recording made by `make_recording`."""
    return documents.read_document(recording / "truth.json", Truth)


class RecordingWriter:
    """Writes the frames of one recording; see `simulated_recording`."""

    def __init__(self, folder: Path, received: ReceivedFrames, depth_scale: float) -> None:
        self._folder = folder
        self._received = received
        self._depth_scale = depth_scale

    def add(self, frame: SimulatedFrame) -> None:
        """Write colour and depth of a frame. Frames may come in any order.

        Depth beyond the range of 16 bits is dropped, as in a camera.

        Raises:
            ToolkitError: the frame does not belong to the scene, or the disk is full.
        """
        self._received.accept(frame)
        write_images(self._folder, frame, depth_scale=self._depth_scale)

    def finish(self) -> None:
        """Write models, intrinsics and truth after every frame was added.

        Raises:
            ToolkitError: frames are missing.
        """
        self._received.require_all()
        scene, folder = self._received.scene, self._folder
        poses = [self._received.poses[i][0] for i in range(scene.frames)]
        documents.write_document(folder / "simulation.json", scene_record(self._received))
        write_truth(
            folder, scene, self._received.cameras.label, poses, depth_scale=self._depth_scale
        )


def write_images(folder: Path, frame: SimulatedFrame, *, depth_scale: float) -> None:
    """Write colour, then depth: if the depth of a frame exists, its colour does too.

    Raises:
        ToolkitError: the disk is full.
    """
    name, depth = frame_name(frame.index), frame.depth_aligned
    within = depth <= _LARGEST_VALUE * depth_scale
    images.write_color(folder / f"color/{name}.png", label_color(frame))
    images.write_depth_png16(
        folder / f"depth/{name}.png", np.where(within, depth, 0), scale=depth_scale
    )


def write_truth(
    folder: Path,
    scene: SimulatedScene,
    camera: Camera,
    T_world_cam: Sequence[SE3],
    *,
    depth_scale: float,
) -> Truth:
    """Write models, intrinsics and finally truth.json.

    Args:
        folder: of the recording.
        scene: the recorded scene.
        camera: of the written images.
        T_world_cam: of every frame.
        depth_scale: metres per unit of the depth images.
    """
    objects = []
    for obj in metric_objects(scene):
        mesh = f"models/{obj.name}{Path(obj.model.mesh).suffix}"
        write_mesh(folder / mesh, obj.mesh)
        objects.append(
            TrueObject(
                name=obj.name,
                category=obj.item.category,
                class_id=obj.item.class_id,
                material=obj.item.material_class,
                mesh=mesh,
                symmetry=obj.model.symmetry,
                T_world_obj=obj.item.T_world_obj.flat(),
            )
        )
    intrinsics = {"width": camera.width, "height": camera.height, "K": camera.K.tolist()}
    if camera.is_distorted:
        intrinsics["distortion"] = list(camera.distortion)
    documents.write_document(folder / "intrinsics.json", intrinsics)
    truth = Truth(
        camera=CameraModel.of(camera),
        depth_scale=depth_scale,
        # Sensor errors are simulated; there is no known factor.
        depth_bias=1.0,
        frames=[frame_name(i) for i in range(len(T_world_cam))],
        T_world_cam=[pose.flat() for pose in T_world_cam],
        objects=objects,
    )
    documents.write_document(folder / "truth.json", truth)
    return truth


@contextmanager
def simulated_recording(
    out: Path, scene: SimulatedScene, *, depth_scale: float = DEPTH_SCALE
) -> Iterator[RecordingWriter]:
    """A writer of a recording, which appears at `out` when the block ends without an error.

    Args:
        out: new folder.
        scene: properties shared by all frames; the poses should follow a smooth path.
        depth_scale: metres per unit of the depth images.

    Raises:
        ToolkitError: `out` exists, or not every frame was written.
    """
    if not 0 < depth_scale <= 1:
        raise ToolkitError("must lie above 0 and at most 1", field="depth_scale", value=depth_scale)
    with atomic.new_folder(out) as folder:
        writer = RecordingWriter(folder, ReceivedFrames(scene), depth_scale)
        yield writer
        writer.finish()
