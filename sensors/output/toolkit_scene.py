"""Simulated scenes as toolkit scenes, with exact camera poses, labels and ground truth.

Colour is resized to the label maps; the scene's camera is that of the label maps. The frames' depth
is the sensor's depth aligned to colour. The exact depth of everything, table and floor included, is
in `reference/depth`; that of the objects is in `gt` with their other maps. The stereo pair is in
`infrared/left` and `infrared/right`; its cameras and poses are in the record.

Simulated objects become models of the scene, with names and at their real size.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import msgspec
import numpy as np

from sensors.output.scene_record import ReceivedFrames, SceneRecord, scene_record
from sensors.output.simulated_frame import Image8, SimulatedFrame, SimulatedObject, SimulatedScene
from std_toolkit.geometry import SE3, Symmetry
from std_toolkit.importers.foreign_files import mesh_suffix, model_of_mesh, write_mesh
from std_toolkit.io import atomic, documents, exr, images
from std_toolkit.jobs.artefact import Artefact
from std_toolkit.rendering import ground_truth, maps, placements, raycast
from std_toolkit.rendering.ground_truth import FrameTruth, ObjectTruth, info_path, map_paths
from std_toolkit.rendering.mesh import RenderMesh
from std_toolkit.scene import model as scene_model
from std_toolkit.scene.document import safe_name
from std_toolkit.scene.scene import Scene

if TYPE_CHECKING:
    import trimesh


SOURCE = "simulated"

_WRITTEN_ONCE = ("color", "depth", "infrared", "models", "reference")


class ToolkitSceneWriter:
    """Writes the frames of one scene; see `toolkit_scene`."""

    def __init__(
        self, folder: Path, received: ReceivedFrames, kept: KeptLabels | None = None
    ) -> None:
        self._folder = folder
        self._received = received
        self._kept = kept
        self._objects = metric_objects(received.scene) if kept is None else kept.objects
        self._names = {} if kept is None else kept.names
        self._renderer = raycast.RaycastRenderer()
        self._prepared = {
            o.item.instance_id: RenderMesh.from_arrays(o.mesh.vertices, o.mesh.faces)
            for o in self._objects
        }
        self._rows: dict[int, list[ObjectTruth]] = {}

    def add(self, frame: SimulatedFrame) -> None:
        """Write the images and maps of a frame. Frames may come in any order.

        Raises:
            ToolkitError: the frame does not belong to the scene, or the disk is full.
        """
        self._received.accept(frame)
        folder, name = self._folder, self._name(frame.index)
        images.write_color(folder / f"color/{name}.png", label_color(frame))
        exr.write_exr(folder / f"depth/{name}.exr", {"Y": frame.depth_aligned}, compression="zip")
        exr.write_exr(
            folder / f"reference/depth/{name}.exr", {"Y": frame.depth_exact}, compression="zip"
        )
        images.write_png(folder / f"infrared/left/{name}.png", frame.infrared_left)
        if frame.infrared_right is not None:
            images.write_png(folder / f"infrared/right/{name}.png", frame.infrared_right)
        rows = self._truth_rows(frame)
        if not rows:  # only labelled objects have ground truth
            return
        seen = frame.mask > 0
        paths = map_paths(folder, frame.index)
        ground_truth.write_depth(paths["depth"], np.where(seen, frame.depth_exact, 0))
        ground_truth.write_mask(paths["mask"], frame.mask)
        ground_truth.write_nocs(paths["nocs"], frame.nocs, frame.mask)
        ground_truth.write_normals(paths["normals"], frame.normals, frame.mask)
        self._rows[frame.index] = rows

    def finish(self) -> None:
        """Write the documents after every frame was added.

        Raises:
            ToolkitError: frames are missing.
        """
        self._received.require_all()
        scene, folder = self._received.scene, self._folder
        for obj in self._objects:
            if obj.file is None:
                write_mesh(folder / obj.model.mesh, obj.mesh)
            else:
                atomic.write_bytes_atomic(folder / obj.model.mesh, obj.file.read_bytes())
        info = scene_model.SceneInfo(
            name=scene.name,
            cameras={"color": scene_model.CameraModel.of(self._received.cameras.label)},
            source=f"{SOURCE}:{scene.sensor}",
        )
        names = [(i, self._name(i)) for i in scene.frame_indices]
        frames = scene_model.Frames(
            frames=[
                scene_model.Frame(
                    id=i, name=name, color=f"color/{name}.png", depth=f"depth/{name}.exr"
                )
                for i, name in names
            ]
        )
        written = Scene.create(folder, info, frames, _object_table(self._objects))
        if self._kept is None:
            written.save_poses(self._poses())
            labels = [self._label(obj) for obj in self._objects]
            written.save_labels(scene_model.Labels(labels=labels))
        else:
            if self._kept.poses is not None:
                written.save_poses(self._kept.poses)
            written.save_labels(self._kept.labels)
        for frame, rows in sorted(self._rows.items()):
            self._write_info(written, frame, rows)
        # Not the documents, nor the maps in gt: later steps of the scene write these.
        written_once = [p for name in _WRITTEN_ONCE for p in sorted((folder / name).rglob("*.*"))]
        outputs = documents.digest_files(folder, written_once)
        documents.write_document(record_path(folder), scene_record(self._received, outputs))

    def _name(self, index: int) -> str:
        return self._names.get(index) or frame_name(index)

    def _T_world_cam(self, frame: int) -> SE3:
        return self._received.poses[frame][0]

    def _poses(self) -> scene_model.CameraPoses:
        return scene_model.CameraPoses(
            frames=[
                scene_model.FramePose(
                    frame=i, status="registered", T_world_cam=self._T_world_cam(i).flat()
                )
                for i in self._received.scene.frame_indices
            ],
            source=SOURCE,
            notes=["exact poses of the simulation, in metres"],
        )

    def _truth_rows(self, frame: SimulatedFrame) -> list[ObjectTruth]:
        T_cam_world = frame.T_world_cam.inverse()
        camera = frame.label_camera
        rows = []
        for obj in self._objects:
            key = obj.item.instance_id
            if self._kept is None:
                T_cam_obj = T_cam_world @ obj.item.T_world_obj
            elif key in self._kept.T_cam_obj[frame.index]:
                T_cam_obj = self._kept.T_cam_obj[frame.index][key]
            else:  # not labelled in this frame
                continue
            alone = maps.object_silhouette(
                self._renderer, camera, self._prepared[key], T_cam_obj, canvas=3
            )
            visible = frame.mask == key
            px_visible = int(np.count_nonzero(visible))
            box, visible_box = alone.box, maps.mask_box(visible)
            inside = alone.image_mask(camera) & (frame.depth_aligned > 0)
            rows.append(
                ObjectTruth(
                    object=key,
                    T_cam_obj=T_cam_obj.flat(),
                    px_all=alone.px_all,
                    px_valid=int(np.count_nonzero(inside)),
                    px_visible=px_visible,
                    visible_fraction=min(1.0, px_visible / alone.px_all) if alone.px_all else 0.0,
                    bbox_amodal=None if box is None else list(box),
                    bbox_visible=None if visible_box is None else list(visible_box),
                )
            )
        return rows

    def _label(self, obj: MetricObject) -> scene_model.Label:
        """The exact pose."""
        T_world_obj = obj.item.T_world_obj
        return scene_model.Label(
            object=obj.item.instance_id,
            frame=0,
            T_cam_obj=(self._T_world_cam(0).inverse() @ T_world_obj).flat(),
            T_world_obj=T_world_obj.flat(),
            method=SOURCE,
        )

    def _write_info(self, scene: Scene, frame: int, rows: list[ObjectTruth]) -> None:
        paths = map_paths(scene.root, frame)
        artefact = Artefact(scene.root, SOURCE, placements.frame_inputs(scene, frame))
        documents.write_document(
            info_path(scene.root, frame),
            FrameTruth(
                **msgspec.structs.asdict(artefact.record(paths.values())),
                frame=frame,
                policy="models",
                delta_m=None,
                # Renderer of the maps for other cameras, such as half-size labels.
                renderer=self._renderer.name,
                smooth_normals=True,
                objects=rows,
            ),
        )


@dataclass(frozen=True, eq=False)
class KeptLabels:
    """What a scene that was rendered again keeps of its source; see `simulation.twins`.

    Attributes:
        objects: in metres, with the models of the source.
        names: of the frames, by index.
        labels: of the objects, as filed.
        T_cam_obj: by frame index and instance id; objects not labelled in a frame are missing.
        poses: of the cameras, as filed; None if the source has none.
    """

    objects: list[MetricObject]
    names: Mapping[int, str]
    labels: scene_model.Labels
    T_cam_obj: Mapping[int, Mapping[int, SE3]]
    poses: scene_model.CameraPoses | None = None


@contextmanager
def toolkit_scene(
    out: Path, scene: SimulatedScene, *, kept: KeptLabels | None = None
) -> Iterator[ToolkitSceneWriter]:
    """A writer of a scene, which appears at `out` when the block ends without an error.

    Args:
        out: folder of the scene.
        scene: properties shared by all frames.
        kept: labels, poses and names to write instead of those that follow from the scene.

    Raises:
        ToolkitError: `out` exists, or not every frame was written.
    """
    with atomic.new_folder(out) as folder:
        writer = ToolkitSceneWriter(folder, ReceivedFrames(scene), kept)
        yield writer
        writer.finish()


def frame_name(index: int) -> str:
    """Name of a frame's files."""
    return f"{index:06d}"


def label_color(frame: SimulatedFrame) -> Image8:
    """Colour at the size of the label maps, resampled by area averaging."""
    size = frame.label_camera.size
    if size == frame.color_camera.size:
        return frame.color
    return cv2.resize(frame.color, size, interpolation=cv2.INTER_AREA)  # type: ignore[return-value]


def record_path(scene: Path) -> Path:
    """Path of the record of a simulated toolkit scene."""
    return scene / ".std" / "simulation.json"


def read_simulation(scene: Path) -> SceneRecord:
    """The record that a toolkit scene was simulated from.

    Raises:
        ToolkitError: the scene was not simulated, or its record is damaged.
    """
    return documents.read_document(record_path(scene), SceneRecord)


def _object_table(entries: list[MetricObject]) -> scene_model.ObjectTable:
    return scene_model.ObjectTable(
        models=[t.model for t in entries],
        objects=[
            scene_model.Object(
                id=t.item.instance_id,
                name=t.name,
                model=t.model.id,
                material=t.item.material_class,
            )
            for t in entries
        ],
    )


@dataclass(frozen=True, eq=False)
class MetricObject:
    """An object in metres, as stored in a scene or a recording.

    Attributes:
        name: unique in the scene: its category and its instance id.
        model: row of the model table.
        mesh: vertices in metres, in the object frame of the simulated poses.
        file: of the mesh, to copy as it is; None writes the mesh.
    """

    item: SimulatedObject
    name: str
    model: scene_model.Model
    mesh: trimesh.Trimesh
    file: Path | None = None


def metric_objects(scene: SimulatedScene) -> list[MetricObject]:
    """Every object with a model of its size; two sizes of one asset are two models."""
    uses = Counter(o.asset_id for o in scene.objects)
    found = []
    for item in scene.objects:
        model_id = item.asset_id
        if uses[item.asset_id] > 1:
            model_id = safe_name(f"{item.instance_id}_{item.asset_id}")
        mesh = item.mesh.copy()
        mesh.apply_scale(item.scale_m)
        model = model_of_mesh(
            mesh,
            model_id=model_id,
            category=item.category,
            symmetry=metric_symmetry(item.symmetry, item.scale_m),
            class_id=item.class_id,
            suffix=mesh_suffix(mesh),
        )
        found.append(
            MetricObject(item, safe_name(f"{item.category}_{item.instance_id}"), model, mesh)
        )
    return found


def metric_symmetry(symmetry: Symmetry, scale_m: float) -> scene_model.SymmetryModel:
    """Symmetries of the canonical mesh, scaled to metres."""
    discrete = [SE3.from_matrix(T) for T in symmetry.discrete]
    return scene_model.SymmetryModel(
        discrete=[SE3(T.R, scale_m * T.t).flat() for T in discrete],
        continuous=[
            scene_model.ContinuousSymmetry(
                axis=list(axis), offset=(scale_m * np.asarray(offset)).tolist()
            )
            for axis, offset in symmetry.continuous
        ],
    )
