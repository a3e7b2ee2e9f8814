"""Labelled scenes to render again: frames with their cameras, and objects with their poses.

They are read from toolkit scenes, BOP folders and GraspNet-1Billion; images are not read. Poses
stay as filed: those of toolkit scenes hold in the world, those of the others in each image.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import msgspec

from sensors.physics.graspnet import GraspNetScenes
from std_toolkit.errors import ToolkitError, listed, located
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.importers import bop_objects
from std_toolkit.importers.bop_documents import BopScene, CameraRow, read_bop_scene, sensors_of
from std_toolkit.importers.foreign_files import mesh_suffix, model_of_mesh, natural_key
from std_toolkit.importers.frame_files import picture_size
from std_toolkit.io.documents import digest_file, digest_of, read_document
from std_toolkit.log import logger
from std_toolkit.rendering.placements import frame_placements
from std_toolkit.scene.document import safe_name
from std_toolkit.scene.model import CameraPoses, FramePose, Label, Labels, Model, Object
from std_toolkit.scene.scene import Scene, require_metres

if TYPE_CHECKING:
    import trimesh

Kind = Literal["toolkit", "bop", "graspnet"]

# Images of both cameras of GraspNet-1Billion.
_GRASPNET_SIZE = (1280, 720)
_COLOR_FOLDERS = ("rgb", "gray")
_NAMED = 5


@dataclass(frozen=True, eq=False)
class LabelledFrame:
    """A frame.

    Attributes:
        id, name: in the scene.
        camera: of its colour image.
        T_world_cam: None if it is not known.
        T_cam_obj: of the labelled objects by id, as filed.
    """

    id: int
    name: str
    camera: Camera
    T_world_cam: SE3 | None
    T_cam_obj: dict[int, SE3]


@dataclass(frozen=True, eq=False)
class LabelledScene:
    """A scene with labels.

    Attributes:
        name: safe name.
        frames: those in which an object has a pose, all of one camera.
        objects: those with a label, by ascending id.
        models: of the objects, by their id.
        meshes: of the models, metres.
        files: mesh files to copy as they are, by id of the model.
        labels, poses: as filed, of these objects and frames; `poses` is None without cameras.
        static: whether the objects rest in the world of the cameras.
        digest: of all of it.
    """

    name: str
    frames: list[LabelledFrame]
    objects: list[Object]
    models: dict[str, Model]
    meshes: dict[str, trimesh.Trimesh]
    files: dict[str, Path]
    labels: Labels
    poses: CameraPoses | None
    static: bool
    digest: str


@dataclass(frozen=True)
class SceneFolder:
    """Where a labelled scene lies.

    Attributes:
        kind: of its files.
        folder: of the scene; of GraspNet-1Billion, of the data set.
        name: unique among the scenes.
        number: of a scene of GraspNet-1Billion.
    """

    kind: Kind
    folder: Path
    name: str
    number: int = 0

    def read(self, frames: int) -> LabelledScene:
        """Read the scene.

        Args:
            frames: largest number of frames, evenly spaced.

        Raises:
            ToolkitError: a document or a mesh cannot be used, no object has a pose in any frame, or
                the frames have several cameras.
        """
        return {"toolkit": _toolkit, "bop": _bop, "graspnet": _graspnet}[self.kind](self, frames)


def find_labelled(top: Path) -> list[SceneFolder]:
    """Find the labelled scenes of a folder, in natural order.

    Args:
        top: a toolkit scene or a folder of some; a scene of BOP, a split or a data set; or the
            folder of GraspNet-1Billion.

    Raises:
        ToolkitError: there is none.
    """
    if not top.is_dir():
        raise ToolkitError("no such folder", path=top, field="--scenes-from")
    depths = ("", "*/", "*/*/")
    for kind, pattern in (("toolkit", "scene.json"), ("bop", "scene_camera*.json")):
        found = sorted(
            {p.parent for depth in depths for p in top.glob(depth + pattern)},
            key=lambda p: natural_key(str(p)),
        )
        if found:
            names = [p.name if p == top or _alone(p, found) else _path_name(p, top) for p in found]
            return [SceneFolder(kind, p, safe_name(n)) for p, n in zip(found, names, strict=True)]  # type: ignore[arg-type]
    if (top / "scenes").is_dir() and (numbers := GraspNetScenes(top).scenes()):
        return [SceneFolder("graspnet", top, f"scene_{n:04d}", n) for n in numbers]
    raise ToolkitError(
        "no labelled scene here",
        path=top,
        field="--scenes-from",
        hint="give a toolkit scene (scene.json), a BOP folder (scene_camera.json) or the folder of "
        "GraspNet-1Billion (scenes/ and models/)",
    )


def _alone(path: Path, others: Sequence[Path]) -> bool:
    return sum(p.name == path.name for p in others) == 1


def _path_name(path: Path, top: Path) -> str:
    return "_".join(path.relative_to(top).parts)


def _toolkit(where: SceneFolder, most: int) -> LabelledScene:
    scene = Scene.open(where.folder)
    require_metres(scene)
    frames = []
    for f in scene.frames:
        placed = frame_placements(scene, f.id)
        frames.append(LabelledFrame(f.id, f.name, scene.camera(f), scene.T_world_cam(f.id), placed))
    objects = [o for o in scene.objects.objects if scene.labels.of(o.id) is not None]
    left = [o.name for o in scene.objects.objects if scene.labels.of(o.id) is None]
    _tell_left_out(where, "without a label", left)
    models = {o.model: scene.objects.model(o.model) for o in objects}
    # Labels that hold in the world give static objects; those of single frames do not.
    world = {o.id for o in objects if scene.T_world_obj(o.id) is not None}
    static = all(f.T_world_cam is not None or not f.T_cam_obj for f in frames) and len(
        world
    ) == len(objects)
    return _scene(
        where,
        frames,
        most,
        objects=objects,
        models=models,
        meshes={m: scene.mesh(m) for m in models},
        files={m: scene.mesh_path(row) for m, row in models.items()},
        labels=scene.labels.labels,
        poses=scene.poses.frames if scene.poses is not None else [],
        static=static,
    )


def _bop(where: SceneFolder, most: int) -> LabelledScene:
    sensors = sensors_of(where.folder)
    if len(sensors) > 1 and "" not in sensors:
        raise ToolkitError(
            f"the scene has {len(sensors)} sensors", path=where.folder, value=", ".join(sensors)
        )
    scene = read_bop_scene(where.folder, "" if "" in sensors else sensors[0])
    top = where.folder.parent.parent
    numbers = sorted({row.obj_id for rows in scene.gt.values() for row in rows})
    models, _ = bop_objects.read_models(top, top / "models", numbers, None)
    ids = {number: m.model.id for number, m in models.items()}
    # Without camera poses: labels of every image, as filed.
    found = bop_objects.find_instances(scene, {}, ids, "diffuse")
    labels = found.labels or Labels()
    frames = [
        LabelledFrame(
            i, f"{i:06d}", _bop_camera(scene, i, row), _bop_pose(row), _in_frame(labels.labels, i)
        )
        for i, row in sorted(scene.cameras.items())
    ]
    return _scene(
        where,
        frames,
        most,
        objects=list(found.objects),
        models={m.model.id: m.model for m in models.values()},
        meshes={m.model.id: m.mesh for m in models.values()},
        files={},
        labels=labels.labels,
        poses=_registered(frames),
        static=False,
    )


def _bop_camera(scene: BopScene, im_id: int, row: CameraRow) -> Camera:
    """The camera, with the size of the image or that of camera.json of the data set."""
    pictures = (scene.picture(kind, im_id) for kind in _COLOR_FOLDERS)
    path = next(filter(None, pictures), None)
    stated = scene.folder.parent.parent / "camera.json"
    if path is not None:
        size = picture_size(path)
    elif stated.is_file():
        told = read_document(stated, _BopSize)
        size = told.width, told.height
    else:
        raise ToolkitError(
            "neither an image nor camera.json of the data set tells the size of the images",
            path=scene.folder,
            value=im_id,
        )
    with located(scene.folder / "scene_camera.json", f"{im_id}.cam_K"):
        return Camera(*size, *row.intrinsics)


class _BopSize(msgspec.Struct, frozen=True):
    width: int
    height: int


def _bop_pose(row: CameraRow) -> SE3 | None:
    T_cam_world = row.T_cam_world
    return None if T_cam_world is None else T_cam_world.inverse()


def _graspnet(where: SceneFolder, most: int) -> LabelledScene:
    data = GraspNetScenes(where.folder)
    images = data.images(where.number)
    images = [images[i] for i in _even(len(images), most)]
    fx, fy, cx, cy = data.intrinsics(where.number)
    frames, views = [], {}
    for image in images:
        path = data.picture(where.number, image=image)
        size = picture_size(path) if path.is_file() else _GRASPNET_SIZE
        with located(path, "camK.npy"):
            camera = Camera(*size, fx, fy, cx, cy)
        poses = dict(data.in_camera(where.number, image=image))
        views[image] = poses
        T_world_cam = data.camera_pose(where.number, image=image)
        # Instance ids are those of the masks of the data set.
        found = {number + 1: T for number, T in poses.items()}
        frames.append(LabelledFrame(image, f"{image:04d}", camera, T_world_cam, found))
    numbers = sorted({n for poses in views.values() for n in poses})
    files = {n: data.mesh_path(n) for n in numbers}
    meshes = {f"graspnet-{n:03d}": load_mesh(files[n]) for n in numbers}
    labels = []
    for n in numbers:
        seen = {i: poses[n].flat() for i, poses in views.items() if n in poses}
        first = min(seen)
        rest = {str(i): T for i, T in seen.items() if i != first}
        labels.append(
            Label(object=n + 1, frame=first, T_cam_obj=seen[first], method=where.kind, views=rest)
        )
    return _scene(
        where,
        frames,
        most,
        objects=[
            Object(id=n + 1, name=f"graspnet-{n:03d}", model=f"graspnet-{n:03d}", material="raw")
            for n in numbers
        ],
        models={
            m: model_of_mesh(mesh, model_id=m, category="other", suffix=mesh_suffix(mesh))
            for m, mesh in meshes.items()
        },
        meshes=meshes,
        files={},
        labels=labels,
        poses=_registered(frames),
        static=False,
    )


def _in_frame(labels: Sequence[Label], frame: int) -> dict[int, SE3]:
    found = {}
    for label in labels:
        T = label.T_cam_obj if label.frame == frame else label.views.get(str(frame))
        if T is not None:
            found[label.object] = SE3.from_matrix(T)
    return found


def _registered(frames: Sequence[LabelledFrame]) -> list[FramePose]:
    return [
        FramePose(frame=f.id, status="registered", T_world_cam=f.T_world_cam.flat())
        for f in frames
        if f.T_world_cam is not None
    ]


def _scene(
    where: SceneFolder,
    frames: list[LabelledFrame],
    most: int,
    *,
    objects: list[Object],
    models: dict[str, Model],
    meshes: dict[str, trimesh.Trimesh],
    files: dict[str, Path],
    labels: Sequence[Label],
    poses: Sequence[FramePose],
    static: bool,
) -> LabelledScene:
    """The scene of the frames that show a labelled object, at most `most` of them."""
    usable = [f for f in frames if f.T_cam_obj]
    if not usable:
        raise ToolkitError(
            "no object has a pose in any frame",
            path=where.folder,
            hint="label the objects, then `std-curate propagate`",
        )
    _tell_left_out(where, "of frames without a pose", [f.name for f in frames if not f.T_cam_obj])
    chosen = [usable[i] for i in _even(len(usable), most)]
    if len({f.camera for f in chosen}) > 1:
        raise ToolkitError(
            "the frames have several cameras, and a simulated scene has one",
            path=where.folder,
            value=len({f.camera for f in chosen}),
            hint="import the frames of each camera as a scene of its own",
        )
    kept = {f.id for f in chosen}
    known = [o for o in objects if any(o.id in f.T_cam_obj for f in chosen)]
    ids = {o.id for o in known}
    rows = [p for p in poses if p.frame in kept]
    cut = [_within(label, kept, chosen) for label in labels if label.object in ids]
    used = {o.model for o in known}
    digest = digest_of(
        [(f.id, f.name, repr(f.camera)) for f in chosen],
        [{str(i): T.flat() for i, T in f.T_cam_obj.items()} for f in chosen],
        {m: digest_file(files[m]) if m in files else _digest(meshes[m]) for m in sorted(used)},
        versioned=False,
    )
    return LabelledScene(
        where.name,
        chosen,
        sorted(known, key=lambda o: o.id),
        {m: row for m, row in models.items() if m in used},
        meshes,
        files,
        Labels(labels=sorted(cut, key=lambda x: x.object)),
        CameraPoses(frames=rows, source=where.kind) if rows else None,
        static,
        digest,
    )


def _within(label: Label, kept: set[int], frames: Sequence[LabelledFrame]) -> Label:
    """The label without annotations in frames that are left out."""
    views = {i: T for i, T in label.views.items() if int(i) in kept}
    if label.frame in kept:
        return msgspec.structs.replace(label, views=views)
    first = next(f for f in frames if label.object in f.T_cam_obj)
    T = views.pop(str(first.id), None) or first.T_cam_obj[label.object].flat()
    return msgspec.structs.replace(label, frame=first.id, T_cam_obj=T, views=views)


def _digest(mesh: trimesh.Trimesh) -> str:
    return digest_of(mesh.vertices.tobytes().hex(), mesh.faces.tobytes().hex(), versioned=False)


def _even(count: int, most: int) -> list[int]:
    """Indices of at most `most` of `count` things, evenly spaced."""
    if count <= most:
        return list(range(count))
    return [round(i * (count - 1) / max(1, most - 1)) for i in range(most)]


def _tell_left_out(where: SceneFolder, why: str, names: Iterable[str]) -> None:
    every = list(names)
    if every:
        logger.warning("%s: left out, %s: %s", where.folder, why, listed(every, _NAMED))
