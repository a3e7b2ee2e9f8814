"""Simulated scenes in the layout of DREDS-CatKnown, as the public loaders read it.

OUT/DREDS-CatKnown/<split>/<scene>/NNNN_*   images and maps of the frames
OUT/cad_model/syn_<split>/<synset>/<asset>/ meshes of unit diagonal and their boxes
OUT/parameters/<split>/<scene>.json         full record of a scene: cameras, poses, seed

Loaders glob `<split>/*/*<suffix>` for every suffix, sort, and pair by position, so every frame has
every file; the records are outside the folders that loaders search. Details of the layout:

- colour and infrared pictures may be larger than the label maps; raw depth is a label map, aligned
  to colour, and -0.001 where nothing was measured;
- depth files have three equal channels (loaders read the first, or R);
- masks hold id/255 as float32 (loaders multiply by 255 and truncate, which half floats fail) with
  background 1, NOCS pictures have B = 1 - z;
- the quaternions of the meta lines are those of the inverse rotation, camera to object;
- `_depth_120` is the exact depth of everything, table and floor included.

DREDS-CatNovel, whose objects are of categories that no network was trained on, differs: its scenes
lie in OUT/DREDS-CatNovel/<scene>, the exact depth is `_depth_0`, there are neither NOCS pictures
nor meshes, and a meta line is the mask id, the class and the material. The records are in
OUT/parameters/novel.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sensors.output import simulated_frame
from sensors.output.scene_record import ReceivedFrames, SceneRecord, scene_record
from sensors.output.staging import staged_folder
from std_toolkit.errors import ToolkitError
from std_toolkit.exporters.mesh_export import obj_files, write_files
from std_toolkit.geometry.mesh import mesh_bounds
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io import atomic, documents, exr, images
from std_toolkit.scene.model import MATERIAL_IDS

Split = Literal["train", "val", "test"]
# Validation scenes use the training shapes.
_CAD_FOLDERS: dict[str, str] = {"train": "syn_train", "val": "syn_train", "test": "syn_test"}
SPLITS: tuple[Split, ...] = ("train", "val", "test")
DATA_SET = "DREDS-CatKnown"
NOVEL_SET = "DREDS-CatNovel"
NOVEL = "novel"
SUFFIXES = (
    "_color.png",
    "_ir_l.png",
    "_ir_r.png",
    "_simDepthImage.exr",
    "_depth_120.exr",
    "_mask.exr",
    "_coord.png",
    "_normal.exr",
    "_meta.txt",
)
SYNSETS = {
    0: "00000000",
    1: "02876657",
    2: "02880940",
    3: "02942699",
    4: "02946921",
    5: "02958343",
    6: "03797390",
    7: "02691156",
}
NO_MEASUREMENT = np.float32(-0.001)
BACKGROUND = 255
# Loaders pad the meta lines of a frame to 30, and frame numbers have four digits.
MOST_OBJECTS = 30
MOST_FRAMES = 10_000


class DredsWriter:
    """Writes the frames of one scene; see `dreds_scene`."""

    def __init__(self, folder: Path, received: ReceivedFrames, *, novel: bool = False) -> None:
        self._folder = folder
        self._received = received
        self._novel = novel

    def add(self, frame: simulated_frame.SimulatedFrame) -> None:
        """Write the files of a frame. Frames may come in any order.

        Raises:
            ToolkitError: the frame does not belong to the scene, or the disk is full.
        """
        self._received.accept(frame)
        if frame.color_camera.is_distorted:
            raise ToolkitError("the layout knows pinhole cameras only", field="color_camera")
        base = self._folder / f"{frame.index:04d}"

        def path(suffix: str) -> Path:
            return base.with_name(base.name + suffix)

        images.write_color(path("_color.png"), frame.color)
        images.write_png(path("_ir_l.png"), frame.infrared_left)
        if frame.infrared_right is not None:
            images.write_png(path("_ir_r.png"), frame.infrared_right)
        raw = np.where(frame.depth_aligned > 0, frame.depth_aligned, NO_MEASUREMENT)
        _write_equal(path("_simDepthImage.exr"), raw)
        _write_equal(path("_depth_0.exr" if self._novel else "_depth_120.exr"), frame.depth_exact)
        _write_equal(path("_mask.exr"), mask_values(frame.mask))
        if not self._novel:
            images.write_png(path("_coord.png"), nocs_picture(frame.nocs, frame.mask))
        _write_channels(path("_normal.exr"), frame.normals)
        meta = meta_text(self._received.scene, frame, short=self._novel)
        atomic.write_bytes_atomic(path("_meta.txt"), meta.encode("ascii"))


@contextmanager
def dreds_scene(
    out: Path, scene: simulated_frame.SimulatedScene, *, split: Split, novel: bool = False
) -> Iterator[DredsWriter]:
    """A writer of a scene, which appears in the data set when the block ends without an error.

    Until then no file of it is visible to a loader; its meshes and its record are written first.

    Args:
        out: top of the data set.
        scene: properties shared by all frames.
        split: part of the data set that it belongs to.
        novel: write DREDS-CatNovel, which is not split.

    Raises:
        ToolkitError: the scene exists, exceeds the limits of the layout, a mesh of the same
            name but another shape exists, or not every frame was written.
    """
    if split not in SPLITS:
        raise ToolkitError("unknown split", field="split", value=split, hint=f"one of {SPLITS}")
    for what, count, most in (
        ("objects", len(scene.objects), MOST_OBJECTS),
        ("frames", scene.frames, MOST_FRAMES),
    ):
        if count > most:
            raise ToolkitError(f"the DREDS layout holds at most {most} {what}", value=count)
    received = ReceivedFrames(scene)
    target = novel_folder(out, scene.name) if novel else scene_folder(out, split, scene.name)
    record = record_path(out, NOVEL if novel else split, scene.name)
    try:
        with staged_folder(out, target.relative_to(out).as_posix()) as folder:
            yield DredsWriter(folder, received, novel=novel)
            received.require_all()
            files = {target / p.name: p for p in sorted(folder.iterdir())}
            for item in () if novel else scene.objects:
                model = f"cad_model/{_CAD_FOLDERS[split]}/{_cad_name(item)}"
                _write_model(out, model, item)
                files |= {p: p for p in sorted((out / model).iterdir())}
            outputs = {
                there.relative_to(out).as_posix(): documents.digest_file(now)
                for there, now in files.items()
            }
            documents.write_document(record, scene_record(received, outputs))
    except BaseException:
        if not target.exists():
            record.unlink(missing_ok=True)
        raise


def scene_folder(out: Path, split: Split, name: str) -> Path:
    """Folder of the scene; it exists exactly when the scene is complete."""
    return out / DATA_SET / split / name


def novel_folder(out: Path, name: str) -> Path:
    """Folder of a scene of DREDS-CatNovel; it exists exactly when the scene is complete."""
    return out / NOVEL_SET / name


def record_path(out: Path, split: str, name: str) -> Path:
    """Path of the record of a scene; `split` is "novel" for those of DREDS-CatNovel."""
    return out / "parameters" / split / f"{name}.json"


def read_record(out: Path, split: Split, name: str) -> SceneRecord:
    """The record of a complete scene.

    Raises:
        ToolkitError: no such scene, or its record is missing or damaged.
    """
    folder = scene_folder(out, split, name)
    if not folder.is_dir():
        raise ToolkitError("no such scene", path=folder)
    return documents.read_document(record_path(out, split, name), SceneRecord)


def mask_values(mask: simulated_frame.Image8) -> simulated_frame.Map:
    """(H, W) float32 id/255, background 255/255."""
    ids = np.where(mask == 0, BACKGROUND, mask)
    return ids.astype(np.float32) / np.float32(255)


def nocs_picture(nocs: simulated_frame.Map, mask: simulated_frame.Image8) -> simulated_frame.Image8:
    """(H, W, 3) uint8: R = x, G = y, B = 1 - z, black background."""
    values = nocs.copy()
    values[..., 2] = 1 - values[..., 2]
    picture = np.rint(values * 255).astype(np.uint8)
    picture[mask == 0] = 0
    return picture


def meta_text(
    scene: simulated_frame.SimulatedScene,
    frame: simulated_frame.SimulatedFrame,
    *,
    short: bool = False,
) -> str:
    """A line of 13 fields, each followed by a space, for every object.

    In the short form there are three: mask id, class 0, material. In full: mask id, class, synset,
    instance, diagonal in metres, material, quaternion w x y z of the rotation from camera to
    object, origin of the object in the camera frame in metres.
    """
    T_cam_world = frame.T_world_cam.inverse()
    lines = []
    for item in scene.objects:
        if short:
            lines.append(f"{item.instance_id} 0 {MATERIAL_IDS[item.material_class]} \n")
            continue
        T_cam_obj = T_cam_world @ item.T_world_obj
        q = SE3(T_cam_obj.R.T, np.zeros(3)).quat()
        numbers = " ".join(f"{x:.9f}" for x in (*q, *T_cam_obj.t))
        lines.append(
            f"{item.instance_id} {item.class_id} {SYNSETS[item.class_id]} {item.asset_id} "
            f"{item.scale_m:.9f} {MATERIAL_IDS[item.material_class]} {numbers} \n"
        )
    return "".join(lines)


def _cad_name(item: simulated_frame.SimulatedObject) -> str:
    return f"{SYNSETS[item.class_id]}/{item.asset_id}"


def _write_model(out: Path, relative: str, item: simulated_frame.SimulatedObject) -> None:
    """Write `model.obj` and `bbox.txt` (row 0 maxima, row 1 minima), unless they exist."""
    files = obj_files(item.mesh, "model.obj")
    low, high = mesh_bounds(item.mesh)
    box = "\n".join(" ".join(f"{x:.9f}" for x in row) for row in (high, low)) + "\n"
    files["bbox.txt"] = box.encode("ascii")
    if not (out / relative).is_dir():
        try:
            with staged_folder(out, relative) as folder:
                write_files(folder, files)
        except ToolkitError:
            # Another process may have written the same model in the meantime.
            if not (out / relative).is_dir():
                raise
    path = out / relative / "model.obj"
    if not path.is_file() or path.read_bytes() != files["model.obj"]:
        raise ToolkitError(
            "another mesh of this name is here",
            path=path,
            hint="asset ids must be unique over all asset sources of a data set",
        )


def _write_equal(path: Path, values: simulated_frame.Map) -> None:
    _write_channels(path, np.repeat(values[..., None], 3, axis=2))


def _write_channels(path: Path, values: simulated_frame.Map) -> None:
    pixels: dict[str, NDArray[np.generic]] = {
        name: np.ascontiguousarray(values[..., i], np.float32) for i, name in enumerate("RGB")
    }
    exr.write_exr(path, pixels, compression="zip")
