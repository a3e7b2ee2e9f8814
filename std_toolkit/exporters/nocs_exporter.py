"""The layout of the NOCS data sets (Real275), as their public loader reads it.

The folder contains `NNNN_color.png`, `NNNN_depth.png` (16-bit
millimetres), `NNNN_mask.png` (ids, 255 = background, at most 19 objects), `NNNN_coord.png` (z
flipped) and `NNNN_meta.txt` with `id class model` lines; line i describes id i; a model's `.txt`
holds its three extents, whose norm is its scale.
"""

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.exporters import exporter, mesh_export, std_exporter
from std_toolkit.exporters.frame_maps import (
    color_camera,
    frame_maps,
    read_color,
    read_sensor_depth,
)
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.mesh import mesh_extents, nocs_frame
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.images import write_png
from std_toolkit.scene.model import Frame
from std_toolkit.scene.sidecar import ExportedModel

NOCS_CLASS_IDS = {"bottle": 1, "bowl": 2, "camera": 3, "can": 4, "laptop": 5, "mug": 6}
MOST_OBJECTS = 18
_UNITS_PER_METRE = 1000
_LARGEST = 65535


class NocsExporter:
    """`OUT/real/<split>/scene_N/NNNN_*`, meshes in `OUT/obj_models/real_<split>/`."""

    def check(self, target: exporter.Target) -> None:
        """Check that the scene has no more objects than the loader supports."""
        if len(target.object_ids) > MOST_OBJECTS:
            raise ToolkitError(
                f"the NOCS layout supports at most {MOST_OBJECTS} objects",
                path=target.scene.root,
                value=len(target.object_ids),
            )

    def folder(self, target: exporter.Target) -> str:
        return f"real/{target.options.split}/scene_{target.options.scene_number}"

    def label_camera(self, target: exporter.Target, camera: Camera) -> Camera:  # noqa: ARG002
        return camera

    def quaternion(self, target: exporter.Target) -> str | None:  # noqa: ARG002
        return None

    def write_models(self, target: exporter.Target) -> tuple[list[ExportedModel], list[str]]:
        """`<model>.obj` in metres, centred, and `<model>.txt` with its extents."""
        rows, files = [], []
        relative = f"obj_models/real_{target.options.split}"
        for model_id in target.model_ids:
            mesh = target.scene.mesh(model_id)
            centre, diagonal = nocs_frame(mesh)
            centred = mesh_export.transformed(mesh, centre=centre, factor=1.0)
            paths = mesh_export.write_files(
                target.root / relative, mesh_export.obj_files(centred, f"{model_id}.obj")
            )
            extents = " ".join(f"{x:.9f}" for x in mesh_extents(centred))
            write_bytes_atomic(target.root / relative / f"{model_id}.txt", f"{extents}\n".encode())
            files += [p.relative_to(target.root).as_posix() for p in paths]
            files.append(f"{relative}/{model_id}.txt")
            rows.append(
                ExportedModel(
                    model=model_id,
                    layout_id=model_id,
                    path=f"{relative}/{model_id}.obj",
                    metres_per_unit=1.0,
                    centre_m=[float(x) for x in centre],
                    diagonal_m=diagonal,
                )
            )
        return rows, files

    def write_frame(self, target: exporter.Target, frame: Frame) -> exporter.FrameRow:
        """The five files of a frame."""
        scene = target.scene
        camera = color_camera(scene, frame)
        maps = frame_maps(scene, frame, camera)
        stem = f"{frame.id:04d}"
        folder = target.root / self.folder(target)
        mask_ids = {i: target.rank(i) for i in target.object_ids}
        write_png(folder / f"{stem}_color.png", read_color(scene, frame))
        sensor = read_sensor_depth(scene, frame)
        if sensor is None:
            sensor = np.zeros((camera.height, camera.width), np.float32)
        units = np.rint(sensor.astype(np.float64) * _UNITS_PER_METRE)
        # No sensor of this kind measures beyond 65 m.
        units[units > _LARGEST] = 0
        write_png(folder / f"{stem}_depth.png", units.astype(np.uint16))
        write_png(folder / f"{stem}_mask.png", std_exporter.dense_mask(maps.mask, mask_ids))
        write_png(folder / f"{stem}_coord.png", std_exporter.nocs_image(maps.nocs, maps.mask))
        write_bytes_atomic(folder / f"{stem}_meta.txt", self._meta(target).encode())
        suffixes = ("color.png", "depth.png", "mask.png", "coord.png", "meta.txt")
        return exporter.FrameRow(
            frame=exporter.exported_frame(target, frame, maps.truth, stem=stem, mask_ids=mask_ids),
            truth=maps.truth,
            outputs=[f"{self.folder(target)}/{stem}_{s}" for s in suffixes],
        )

    def finish(
        self,
        target: exporter.Target,
        rows: list[exporter.FrameRow],
        models: list[ExportedModel],  # noqa: ARG002 - part of the protocol
    ) -> list[str]:
        """Write the faults that the check found; the layout has no documents over all frames."""
        return exporter.write_faults(target, self.folder(target), rows)

    def _meta(self, target: exporter.Target) -> str:
        lines = []
        for object_id in target.object_ids:
            model = target.scene.objects.model_of(object_id)
            class_id = NOCS_CLASS_IDS.get(model.category, 0)
            lines.append(f"{target.rank(object_id)} {class_id} {model.id}\n")
        return "".join(lines)


NOCS = NocsExporter()
