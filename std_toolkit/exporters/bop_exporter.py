"""The BOP layout (bop_toolkit's docs/bop_datasets_format.md and its code).

All lengths are in millimetres. Poses map model to camera (m2c) and world to camera (w2c). The
origin of a model is the centre of its bounding box. Masks, boxes and counts come from ground truth
with pixel centres at integers, consistent with K and the back-projection of depth. The renderer of
bop_toolkit puts pixel centres at +0.5 with the same K.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array, Mask
from std_toolkit.exporters import bop_metadata, exporter, mesh_export
from std_toolkit.exporters.frame_maps import (
    color_camera,
    frame_maps,
    read_color,
    read_sensor_depth,
)
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.mesh import mesh_bounds, mesh_diameter, nocs_frame
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.images import read_png, write_png
from std_toolkit.rendering.choose import choose_renderer, get_renderer
from std_toolkit.rendering.ground_truth import ObjectTruth
from std_toolkit.rendering.maps import mask_box, object_silhouette
from std_toolkit.scene import Frame, Scene, SymmetryModel
from std_toolkit.scene.sidecar import ExportedModel

MM = 1000.0
# EXR depth in 16 bits: 0.1 mm while it fits (6.5 m), else 1 mm.
_FINE_MM, _COARSE_MM = 0.1, 1.0
_LARGEST = 65535
_EVAL_EDGE = 0.1


@dataclass(frozen=True)
class DepthUnits:
    """Depth as 16-bit units, and the size of one unit in mm."""

    values: NDArray[np.uint16]
    scale_mm: float


class BopExporter:
    """`OUT/<split>/000001/`, `OUT/models/`, and the documents of a data set."""

    def check(self, target: exporter.Target) -> None:
        """Accept every scene: the layout has no limits."""

    def folder(self, target: exporter.Target) -> str:
        return f"{target.options.split}/{target.options.scene_number:06d}"

    def label_camera(self, target: exporter.Target, camera: Camera) -> Camera:  # noqa: ARG002
        return camera

    def quaternion(self, target: exporter.Target) -> str | None:  # noqa: ARG002
        return None

    def write_models(self, target: exporter.Target) -> tuple[list[ExportedModel], list[str]]:
        """models/, models_eval/ and their models_info.json."""
        rows: list[ExportedModel] = []
        files: list[str] = []
        info: dict[str, Any] = {}
        for model_id in target.model_ids:
            number = target.model_number(model_id)
            name = f"obj_{number:06d}.ply"
            mesh = target.scene.mesh(model_id)
            centre, diagonal = nocs_frame(mesh)
            mm = mesh_export.transformed(mesh, centre=centre, factor=MM)
            even = mesh_export.evenly_split(mm, largest_edge=_EVAL_EDGE * mesh_diameter(mm))
            for folder, shape in (("models", mm), ("models_eval", even)):
                paths = mesh_export.write_files(
                    target.root / folder, mesh_export.ply_files(shape, name)
                )
                files += [p.relative_to(target.root).as_posix() for p in paths]
            symmetry = target.scene.objects.model(model_id).symmetry
            info[str(number)] = model_info(mm, symmetry, centre)
            rows.append(
                ExportedModel(
                    model=model_id,
                    layout_id=str(number),
                    path=f"models/{name}",
                    metres_per_unit=1 / MM,
                    centre_m=[float(x) for x in centre],
                    diagonal_m=diagonal,
                )
            )
        for folder in ("models", "models_eval"):
            write_bytes_atomic(
                target.root / folder / "models_info.json", bop_metadata.record_lines(info)
            )
            files.append(f"{folder}/models_info.json")
        return rows, files

    def write_frame(self, target: exporter.Target, frame: Frame) -> exporter.FrameRow:
        """Colour, depth, both masks of every object, and the frame's rows of the documents."""
        scene = target.scene
        camera = color_camera(scene, frame)
        maps = frame_maps(scene, frame, camera)
        stem = f"{frame.id:06d}"
        folder = target.root / self.folder(target)
        outputs = [f"rgb/{stem}.png"]
        write_png(folder / outputs[0], read_color(scene, frame))
        depth = depth_units(scene, frame)
        if depth is not None:
            outputs.append(f"depth/{stem}.png")
            write_png(folder / outputs[-1], depth.values)

        renderer = get_renderer(choose_renderer(maps.truth.renderer, cameras=[camera]))
        gt, gt_info, coco = [], [], []
        for index, row in enumerate(maps.truth.objects):
            model = scene.objects.model_of(row.object)
            mesh = scene.mesh(model.id)
            number = target.model_number(model.id)
            amodal = object_silhouette(renderer, camera, mesh, row.pose, canvas=1).image_mask(
                camera
            )
            visible = maps.mask == row.object
            for kind, mask in (("mask", amodal), ("mask_visib", visible)):
                # Also for invisible objects: the suffix is the index in scene_gt.
                outputs.append(f"{kind}/{stem}_{index:06d}.png")
                write_png(folder / outputs[-1], np.where(mask, np.uint8(255), np.uint8(0)))
            centre, _ = nocs_frame(mesh)
            gt.append(
                {
                    "cam_R_m2c": _flat(row.pose.R),
                    "cam_t_m2c": _flat(MM * (row.pose @ centre)),
                    "obj_id": number,
                }
            )
            gt_info.append(gt_info_row(row, target.object_fault(frame.id, row.object)))
            coco.append(_coco_row(number, row, amodal, visible))
        return exporter.FrameRow(
            frame=exporter.exported_frame(
                target,
                frame,
                maps.truth,
                stem=stem,
                mask_ids={r.object: i for i, r in enumerate(maps.truth.objects)},
            ),
            truth=maps.truth,
            outputs=[f"{self.folder(target)}/{name}" for name in outputs],
            extra={
                "camera": camera_row(scene, frame, camera, depth),
                "gt": gt,
                "gt_info": gt_info,
                "coco": [c for c in coco if c is not None],
                "size": list(camera.size),
            },
        )

    def finish(
        self, target: exporter.Target, rows: list[exporter.FrameRow], models: list[ExportedModel]
    ) -> list[str]:
        """The documents of the scene and of the data set."""
        folder = self.folder(target)
        by_id = {str(r.frame.id): r for r in rows}
        first = rows[0]
        camera = color_camera(target.scene, target.frames[0])
        documents: dict[str, bytes] = {
            f"{folder}/scene_camera.json": bop_metadata.record_lines(
                {k: r.extra["camera"] for k, r in by_id.items()}
            ),
            f"{folder}/scene_gt.json": bop_metadata.record_lines(
                {k: r.extra["gt"] for k, r in by_id.items()}
            ),
            f"{folder}/scene_gt_info.json": bop_metadata.record_lines(
                {k: r.extra["gt_info"] for k, r in by_id.items()}
            ),
            f"{folder}/scene_gt_coco.json": bop_metadata.coco_document(target, rows, models),
            f"{folder}/scene_gt_coco_modal.json": bop_metadata.coco_document(
                target, rows, models, modal=True
            ),
            "camera.json": bop_metadata.record_lines(
                {
                    "cx": camera.cx,
                    "cy": camera.cy,
                    "depth_scale": first.extra["camera"]["depth_scale"],
                    "fx": camera.fx,
                    "fy": camera.fy,
                    "height": camera.height,
                    "width": camera.width,
                }
            ),
            "test_targets_bop19.json": bop_metadata.record_lines(
                bop_metadata.targets_19(target, rows)
            ),
            "test_targets_bop24.json": bop_metadata.record_lines(
                bop_metadata.targets_24(target, rows)
            ),
            "dataset_info.json": bop_metadata.dataset_info(target, rows, models),
            "dataset_info.md": bop_metadata.dataset_text(target, rows, models),
        }
        for name, content in documents.items():
            write_bytes_atomic(target.root / name, content)
        return list(documents)


def model_info(mesh_mm: Any, symmetry: SymmetryModel, centre: Array) -> dict[str, Any]:
    """A model's entry in models_info.json: millimetres, symmetries in the centred frame."""
    low, high = mesh_bounds(mesh_mm)
    size = high - low
    entry: dict[str, Any] = {"diameter": round(mesh_diameter(mesh_mm), 6)}
    for axis, lowest, extent in zip("xyz", low, size, strict=True):
        entry[f"min_{axis}"] = round(float(lowest), 6)
        entry[f"size_{axis}"] = round(float(extent), 6)
    if symmetry.discrete:
        entry["symmetries_discrete"] = [_centred(T, centre) for T in symmetry.discrete]
    if symmetry.continuous:
        entry["symmetries_continuous"] = [
            {"axis": list(c.axis), "offset": _flat(MM * (np.asarray(c.offset) - centre))}
            for c in symmetry.continuous
        ]
    return dict(sorted(entry.items()))


def gt_info_row(row: ObjectTruth, fault: str | None = None) -> dict[str, Any]:
    """An entry of scene_gt_info.json. Boxes are (x, y, max - min, max - min), no +1; all -1 for an
    object that is not visible. `label_fault` is an addition to BOP, absent without a check."""
    visible = row.px_visible > 0
    flag = {} if fault is None else {"label_fault": fault}
    return {
        **flag,
        "bbox_obj": _box(row.bbox_amodal) if visible else [-1] * 4,
        "bbox_visib": _box(row.bbox_visible) if visible else [-1] * 4,
        "px_count_all": row.px_all,
        "px_count_valid": row.px_valid,
        "px_count_visib": row.px_visible,
        "visib_fract": row.visible_fraction,
    }


def camera_row(
    scene: Scene, frame: Frame, camera: Camera, depth: DepthUnits | None
) -> dict[str, Any]:
    """An entry of scene_camera.json; world to camera only if the frame has a pose."""
    entry: dict[str, Any] = {
        "cam_K": _flat(camera.K),
        "depth_scale": 1.0 if depth is None else depth.scale_mm,
    }
    T_world_cam = scene.T_world_cam(frame.id)
    if T_world_cam is not None:
        T_cam_world: SE3 = T_world_cam.inverse()
        entry["cam_R_w2c"] = _flat(T_cam_world.R)
        entry["cam_t_w2c"] = _flat(MM * T_cam_world.t)
    return dict(sorted(entry.items()))


def depth_units(scene: Scene, frame: Frame) -> DepthUnits | None:
    """Depth in 16-bit units. 16-bit images keep their values: the correction factor of the sensor
    goes into the scale, which avoids rounding twice."""
    if frame.depth is None:
        return None
    path = scene.root / frame.depth
    camera = scene.camera(frame)
    if path.suffix.lower() == ".png" and not camera.is_distorted and scene.info.depth_scale:
        scene.read_depth(frame)  # refuses 8-bit images, pictures and depth in another unit
        values = read_png(path, size=camera.size)
        scale = scene.info.depth_scale * scene.info.depth_correction * MM
        return DepthUnits(values.astype(np.uint16), float(f"{scale:.12g}"))
    depth = read_sensor_depth(scene, frame)
    assert depth is not None  # the frame has one
    mm = depth.astype(np.float64) * MM
    scale = _FINE_MM if mm.max(initial=0) <= _LARGEST * _FINE_MM else _COARSE_MM
    units = np.rint(mm / scale)
    units[units > _LARGEST] = 0
    return DepthUnits(units.astype(np.uint16), scale)


def _coco_row(number: int, row: ObjectTruth, amodal: Mask, visible: Mask) -> dict[str, Any] | None:
    box = mask_box(amodal)
    if row.px_visible == 0 or box is None:
        return None
    x0, y0, x1, y1 = box
    return {
        "area": row.px_visible,
        "bbox": [x0, y0, x1 - x0 + 1, y1 - y0 + 1],
        "category_id": number,
        "height": visible.shape[0],
        "ignore": row.visible_fraction < 0.1,
        "iscrowd": 0,
        "segmentation": run_lengths(visible),
        "width": visible.shape[1],
    }


def run_lengths(mask: Mask) -> dict[str, list[int]]:
    """COCO's uncompressed run lengths: column by column, zeros first."""
    flat = mask.ravel(order="F")
    changes = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    ends = np.concatenate([[0], changes, [flat.size]])
    counts = [int(n) for n in np.diff(ends)]
    if flat.size and flat[0]:
        counts.insert(0, 0)
    return {"counts": counts, "size": [int(n) for n in mask.shape]}


def _centred(T: list[float], centre: Array) -> list[float]:
    """A symmetry of the scene's mesh frame (m) in the centred frame (mm)."""
    S = SE3.from_matrix(T)
    moved = SE3(S.R, MM * (S @ centre - centre))
    return moved.flat()


def _box(box: list[int] | None) -> list[int]:
    if box is None:
        return [-1] * 4
    return [box[0], box[1], box[2] - box[0], box[3] - box[1]]


def _flat(values: NDArray[np.floating]) -> list[float]:
    return [float(x) for x in np.asarray(values, dtype=np.float64).ravel()]


BOP = BopExporter()
