"""Scenes of BOP data sets: images, poses in millimetres, models."""

from pathlib import Path

from std_toolkit.errors import ToolkitError, located
from std_toolkit.geometry import SE3, Camera
from std_toolkit.importers import bop_objects
from std_toolkit.importers.bop_documents import (
    BopScene,
    CameraRow,
    count_rough,
    read_bop_scene,
    sensors_of,
)
from std_toolkit.importers.bop_packed import packed_split, unpack_data_set
from std_toolkit.importers.frame_files import picture_size
from std_toolkit.importers.importer import Recording, SourceFile, SourceFrame
from std_toolkit.importers.options import ImportRequest
from std_toolkit.scene.model import CameraPoses, FramePose, Material
from std_toolkit.scene.sidecar import ExportedFrame, Sidecar, find_sidecar

_COLOR_FOLDERS = ("rgb", "gray")
# BOP does not record materials; most of its data sets are opaque.
_DEFAULT_MATERIAL: Material = "diffuse"


class BopImporter:
    """Reads one scene folder (`test/000001`), or a data set with a single scene; the forms of
    `bop_packed` are laid out in the workspace before."""

    def recognises(self, source: Path) -> bool:
        if packed_split(source) is not None:
            return True
        return source.is_dir() and bool(_scene_folders(source))

    def read(self, request: ImportRequest) -> Recording:
        """See `Importer`.

        Raises:
            ToolkitError: a document breaks the format, or images or models are missing.
        """
        packed = packed_split(request.source)
        if packed is None:
            folder = _scene_folder(request.source)
        else:
            assert request.workspace is not None, "packed images are written to files"
            folder = _unpacked(*packed, request.workspace)
        scene = read_bop_scene(folder, _sensor(folder, request.camera))
        found = find_sidecar(folder, "bop")
        sidecar = None if found is None else found[0]
        cameras, camera_of = _cameras(scene, sidecar)
        depth_scale = _common_depth_scale(scene)
        exported = {} if sidecar is None else {f.id: f for f in sidecar.frames}
        frames = tuple(
            _frame(scene, im_id, camera_of[im_id], exported.get(im_id))
            for im_id in sorted(scene.cameras)
        )
        top = request.models.parent if request.models is not None else folder.parent.parent
        models, centres = bop_objects.read_models(
            top,
            request.models or top / "models",
            sorted({row.obj_id for rows in scene.gt.values() for row in rows}),
            sidecar,
        )
        T_world_cam = {
            im_id: pose.inverse()
            for im_id, row in scene.cameras.items()
            if (pose := row.T_cam_world) is not None
        }
        instances: bop_objects.Instances
        if sidecar is not None:
            instances = bop_objects.instances_from_sidecar(scene, sidecar, T_world_cam, centres)
        else:
            instances = bop_objects.find_instances(
                scene,
                T_world_cam,
                {number: m.model.id for number, m in models.items()},
                request.material or _DEFAULT_MATERIAL,
            )
        notes = list(instances.notes)
        if sidecar is None and instances.objects and request.material is None:
            notes.append("BOP has no materials: objects are imported as diffuse (see --material)")
        filed = [row.filed_pose for rows in scene.gt.values() for row in rows]
        rough, largest = count_rough(filed)
        if rough:
            notes.append(
                f"{rough} of {len(filed)} rotations are not exactly orthonormal (by up to "
                f"{largest:.1e}): imported as the nearest rotation"
            )
        return Recording(
            source="import:bop",
            cameras=cameras,
            frames=frames,
            depth_scale=depth_scale,
            depth_correction=request.depth_correction,
            models=tuple(models.values()),
            objects=instances.objects,
            poses=_poses(scene, T_world_cam, sidecar),
            labels=instances.labels,
            notes=notes,
        )


def _scene_folders(source: Path) -> list[Path]:
    if sensors_of(source):
        return [source]
    return sorted({p.parent for p in source.glob("*/*/scene_camera*.json")})


def _sensor(folder: Path, wanted: str | None) -> str:
    """The sensor of a scene with several: the one that --camera names."""
    names = sensors_of(folder)
    if wanted is not None and wanted not in names:
        raise ToolkitError(
            "no such sensor in this scene", path=folder, field="--camera", value=wanted,
            hint=f"it has {', '.join(filter(None, names)) or 'one without a name'}",
        )  # fmt: skip
    if wanted is None and len(names) > 1:
        if "" in names:
            return ""
        raise ToolkitError(
            f"the scene has {len(names)} sensors", path=folder,
            hint=f"choose one with --camera: {', '.join(names)}",
        )  # fmt: skip
    return wanted if wanted is not None else names[0]


def _scene_folder(source: Path) -> Path:
    if not source.is_dir():
        raise ToolkitError("no such folder", path=source)
    found = _scene_folders(source)
    if len(found) == 1:
        return found[0]
    shown = ", ".join(str(p.relative_to(source)) for p in found[:5])
    raise ToolkitError(
        "no BOP scene here (scene_camera.json)" if not found else "several BOP scenes here",
        path=source,
        hint=f"give one of them: {shown}" if found else "give a folder such as test/000001",
    )


def _unpacked(split: Path, scene: int | None, workspace: Path) -> Path:
    """The scene folder of a packed split."""
    top = workspace / "bop"
    found = sorted(unpack_data_set(split, top, scene=scene).iterdir())
    if len(found) > 1:
        numbers = ", ".join(f.name for f in found[:5])
        raise ToolkitError(
            "several BOP scenes here",
            path=split,
            value=f"{numbers}{' ...' if len(found) > 5 else ''}",
            hint=f"name one, such as {split / found[0].name}",
        )
    return found[0]


def _color_path(scene: BopScene, im_id: int) -> Path:
    found = (scene.picture(kind, im_id) for kind in _COLOR_FOLDERS)
    path = next(filter(None, found), None)
    if path is None:
        missing = scene.pictures("rgb") / f"{im_id:06d}.png"
        raise ToolkitError("image file not found", path=missing)
    return path


def _cameras(scene: BopScene, sidecar: Sidecar | None) -> tuple[dict[str, Camera], dict[int, str]]:
    """Distinct cameras by id, and the camera id of every image."""
    named = {} if sidecar is None else {f.id: f.camera for f in sidecar.frames}
    by_values: dict[tuple[str | float, ...], str] = {}
    cameras: dict[str, Camera] = {}
    camera_of: dict[int, str] = {}
    for im_id, row in sorted(scene.cameras.items()):
        size = picture_size(_color_path(scene, im_id))
        # Two cameras of the sidecar remain separate, even with equal parameters.
        values = (named.get(im_id, ""), *size, *row.intrinsics)
        if values not in by_values:
            key = named.get(im_id) or ("color" if not by_values else f"color_{len(by_values)}")
            by_values[values] = key
            cameras[key] = _camera(scene.folder, im_id, size, row)
        camera_of[im_id] = by_values[values]
    return cameras, camera_of


def _camera(folder: Path, im_id: int, size: tuple[int, int], row: CameraRow) -> Camera:
    with located(folder / "scene_camera.json", f"{im_id}.cam_K"):
        return Camera(*size, *row.intrinsics)


def _common_depth_scale(scene: BopScene) -> float | None:
    """Metres per unit of the first depth image; other units are converted by the writer."""
    for im_id, row in sorted(scene.cameras.items()):
        if scene.picture("depth", im_id) is not None:
            return row.depth_scale_m
    return None


def _frame(scene: BopScene, im_id: int, camera: str, row: ExportedFrame | None) -> SourceFrame:
    name = f"{im_id:06d}" if row is None else row.name
    depth = scene.picture("depth", im_id)
    return SourceFrame(
        id=im_id,
        name=name,
        color=SourceFile(source=_color_path(scene, im_id), target=f"color/{name}", kind="color"),
        depth=None
        if depth is None
        else SourceFile(
            source=depth,
            target=f"depth/{name}",
            kind="depth",
            depth_scale=scene.cameras[im_id].depth_scale_m,
        ),
        camera=camera,
        timestamp=None if row is None else row.timestamp,
    )


def _poses(
    scene: BopScene, T_world_cam: dict[int, SE3], sidecar: Sidecar | None
) -> CameraPoses | None:
    if not T_world_cam:
        return None
    known = (
        {}
        if sidecar is None or sidecar.poses is None
        else {p.frame: p for p in sidecar.poses.frames}
    )
    frames = []
    for im_id in sorted(scene.cameras):
        pose, old = T_world_cam.get(im_id), known.get(im_id)
        frames.append(
            FramePose(
                frame=im_id,
                status="unregistered" if pose is None else "registered",
                T_world_cam=None if pose is None else pose.flat(),
                reprojection_px=old.reprojection_px if old else None,
                points=old.points if old else 0,
                covariance=old.covariance if old else None,
            )
        )
    before = sidecar.poses if sidecar is not None else None
    return CameraPoses(
        frames=frames,
        scale=before.scale if before else None,
        gates=before.gates if before else [],
        source=before.source if before else "import:bop",
        notes=before.notes if before else [],
    )


BOP = BopImporter()
