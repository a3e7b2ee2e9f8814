"""The STD layout, as the public DREDS and STD loaders read it.

Loaders pair files by position in sorted lists per suffix, so every frame has every file; they
take channel 0 of depth EXRs, 255 as the mask's background, and flip the third NOCS channel.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.exporters.exporter import FrameRow, Target, exported_frame, write_faults
from std_toolkit.exporters.frame_maps import (
    color_camera,
    frame_maps,
    read_color,
    read_sensor_depth,
)
from std_toolkit.exporters.label_quality import write_card
from std_toolkit.exporters.mesh_export import obj_files, transformed, write_files
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.mesh import mesh_bounds, nocs_frame
from std_toolkit.io import atomic, exr, images
from std_toolkit.log import logger
from std_toolkit.rendering.ground_truth import FrameTruth
from std_toolkit.scene.model import MATERIAL_IDS, Frame
from std_toolkit.scene.sidecar import ExportedModel

BACKGROUND = 255
# The public loaders pad the meta lines of a frame to this many.
MOST_OBJECTS = 30
_FULL_SIZE = (1280, 720)
QUATERNIONS = {
    "dreds": "wxyz of the inverse rotation (camera to object), as the DREDS generator writes it",
    "plain": "wxyz of the rotation object to camera",
}


class StdExporter:
    """`OUT/<scene>/NNNN_*`, meshes in `OUT/cad_model/<category>/<model>/`."""

    def check(self, target: Target) -> None:
        """Check the limits of the loaders.

        Raises:
            ToolkitError: too many objects, a scene named like the model folder, or a label size
                with another aspect ratio than the image of a camera.
        """
        if self.folder(target) == "cad_model":
            raise ToolkitError(
                "the STD layout uses this name for the folder of its models",
                path=target.scene.root / "scene.json",
                field="name",
                value="cad_model",
            )
        if len(target.object_ids) > MOST_OBJECTS:
            raise ToolkitError(
                f"the STD layout supports at most {MOST_OBJECTS} objects",
                path=target.scene.root,
                value=len(target.object_ids),
            )
        for frame in {f.camera: f for f in target.scene.frames}.values():
            self.label_camera(target, target.scene.camera(frame))

    def folder(self, target: Target) -> str:
        return target.options.scene_name or target.scene.info.name

    def label_camera(self, target: Target, camera: Camera) -> Camera:
        """Half the size of a 1280x720 colour image, as in STD; otherwise its full size."""
        size = target.options.label_size
        if size is None:
            size = (640, 360) if camera.size == _FULL_SIZE else camera.size
        if abs(size[0] * camera.height - size[1] * camera.width) > max(size):
            raise ToolkitError(
                f"labels of {size[0]}x{size[1]} distort a {camera.width}x{camera.height} image",
                field="--label-size",
                hint="keep the aspect ratio",
            )
        return camera if size == camera.size else camera.resized(*size)

    def quaternion(self, target: Target) -> str | None:
        return QUATERNIONS[target.options.quaternion]

    def write_models(self, target: Target) -> tuple[list[ExportedModel], list[str]]:
        """`model.obj` with unit diagonal, centred; `bbox.txt`: row 0 maxima, row 1 minima."""
        rows, files = [], []
        for model_id in target.model_ids:
            model = target.scene.objects.model(model_id)
            mesh = target.scene.mesh(model_id)
            centre, diagonal = nocs_frame(mesh)
            unit = transformed(mesh, centre=centre, factor=1 / diagonal)
            relative = f"cad_model/{model.category}/{model.id}"
            folder = target.root / relative
            paths = write_files(folder, obj_files(unit, "model.obj"))
            low, high = mesh_bounds(unit)
            text = "\n".join(" ".join(f"{x:.9f}" for x in row) for row in (high, low)) + "\n"
            atomic.write_bytes_atomic(folder / "bbox.txt", text.encode())
            files += [p.relative_to(target.root).as_posix() for p in paths]
            files.append(f"{relative}/bbox.txt")
            rows.append(
                ExportedModel(
                    model=model_id,
                    layout_id=f"{model.category}/{model.id}",
                    path=f"{relative}/model.obj",
                    metres_per_unit=diagonal,
                    centre_m=[float(x) for x in centre],
                    diagonal_m=diagonal,
                )
            )
        return rows, files

    def write_frame(self, target: Target, frame: Frame) -> FrameRow:
        """The seven files of a frame."""
        scene = target.scene
        camera = color_camera(scene, frame)
        labels = self.label_camera(target, camera)
        maps = frame_maps(scene, frame, labels, target.left_out(frame.id))
        stem = f"{frame.id:04d}"
        folder = target.root / self.folder(target)
        prefix = f"{self.folder(target)}/{stem}"
        mask_ids = {i: target.rank(i) for i in target.object_ids}

        images.write_png(folder / f"{stem}_color.png", read_color(scene, frame))
        sensor = read_sensor_depth(scene, frame)
        if sensor is None:
            sensor = np.zeros((camera.height, camera.width), np.float32)
        write_depth_exr(folder / f"{stem}_depth_415.exr", sensor)
        write_depth_exr(folder / f"{stem}_gt_depth.exr", maps.depth)
        images.write_png(folder / f"{stem}_coord.png", nocs_image(maps.nocs, maps.mask))
        images.write_png(folder / f"{stem}_mask.png", dense_mask(maps.mask, mask_ids))
        meta = self._meta(target, maps.truth, mask_ids)
        atomic.write_bytes_atomic(folder / f"{stem}_meta.txt", meta.encode())
        suffixes = (
            "color.png", "depth_415.exr", "gt_depth.exr", "coord.png", "mask.png", "meta.txt",
        )  # fmt: skip
        return FrameRow(
            frame=exported_frame(target, frame, maps.truth, stem=stem, mask_ids=mask_ids),
            truth=maps.truth,
            outputs=[f"{prefix}_{s}" for s in suffixes],
        )

    def finish(
        self,
        target: Target,
        rows: list[FrameRow],
        models: list[ExportedModel],  # noqa: ARG002 - part of the protocol
    ) -> list[str]:
        """Write what the check found; the layout has no documents over all frames."""
        without = [f.name for f in target.scene.frames if f.depth is None]
        if without:
            logger.warning(
                "%s: %d of %d frames have no sensor depth; the layout needs a file, so theirs have "
                "0 (not measured) in every pixel",
                target.scene.root, len(without), len(target.scene.frames),
            )  # fmt: skip
        return [*write_faults(target, self.folder(target), rows), *write_card(target, rows)]

    def _meta(self, target: Target, truth: FrameTruth, mask_ids: dict[int, int]) -> str:
        lines = []
        for row in truth.objects:
            obj = target.scene.objects.object(row.object)
            model = target.scene.objects.model(obj.model)
            centre, diagonal = nocs_frame(target.scene.mesh(model.id))
            pose = row.pose
            R = pose.R if target.options.quaternion == "plain" else pose.R.T
            q = SE3(R, np.zeros(3)).quat()
            t = pose @ centre
            numbers = " ".join(f"{x:.9f}" for x in (*q, *t))
            lines.append(
                f"{mask_ids[row.object]} {model.class_id} {model.category} {model.id} "
                f"{diagonal:.9f} {MATERIAL_IDS[obj.material]} {numbers} \n"
            )
        return "".join(lines)


def write_depth_exr(path: Path, depth: NDArray[np.float32]) -> None:
    """Depth in metres as three equal float32 channels, the format of the layout."""
    values = np.ascontiguousarray(depth, dtype=np.float32)
    exr.write_exr(path, {"R": values, "G": values, "B": values}, compression="zip")


def nocs_image(nocs: NDArray[np.float32], mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """8-bit NOCS picture: R = x, G = y, B = 1 - z, black background."""
    flipped = nocs.copy()
    flipped[..., 2] = 1 - flipped[..., 2]
    picture = np.rint(np.clip(flipped, 0, 1) * 255).astype(np.uint8)
    picture[mask == 0] = 0
    return picture


def dense_mask(mask: NDArray[np.uint8], mask_ids: dict[int, int]) -> NDArray[np.uint8]:
    """Mask of the layout's ids 1..N, background 255."""
    table = np.full(256, BACKGROUND, np.uint8)
    for object_id, mask_id in mask_ids.items():
        table[object_id] = mask_id
    return table[mask]


STD = StdExporter()
