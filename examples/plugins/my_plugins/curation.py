"""Plug-ins of `std-curate`, `std-scan` and `std-restore live`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from std_toolkit import SE3, Camera, ImportRequest
from std_toolkit.cameras import CameraRequest, LiveFrame
from std_toolkit.exporters.exporter import FrameRow, Target, exported_frame
from std_toolkit.importers.importer import Recording, SourceFile, SourceFrame
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.images import image_size
from std_toolkit.poses.scale_sources import ScaleContext
from std_toolkit.rendering.ground_truth import read_frame_truth
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.renderer import Raster
from std_toolkit.scanning.surface.depth_maps import depth_maps
from std_toolkit.scene.model import Frame
from std_toolkit.scene.scale_model import ScaleEstimate


class Pairs:
    """`std-curate import SRC`: SRC/rgb and SRC/depth (mm) of equal names, fx fy cx cy in K.txt."""

    def recognises(self, source: Path) -> bool:
        return (source / "K.txt").is_file()

    def read(self, request: ImportRequest) -> Recording:
        images = sorted((request.source / "rgb").glob("*.png"))
        fx, fy, cx, cy = map(float, (request.source / "K.txt").read_text().split())
        camera = Camera(*image_size(images[0]), fx, fy, cx, cy)
        frames = []
        for i, image in enumerate(images):
            color = SourceFile(source=image, target=f"color/{image.stem}", kind="color")
            depth = SourceFile(
                source=request.source / "depth" / image.name, target=f"depth/{image.stem}",
                kind="depth", depth_scale=0.001,
            )  # fmt: skip
            frames.append(SourceFrame(id=i, name=image.stem, color=color, depth=depth))
        return Recording(
            source="pairs", cameras={"color": camera}, frames=tuple(frames), depth_scale=0.001
        )


PAIRS = Pairs()


@dataclass(frozen=True)
class PoseLines:
    """`std-curate export --format pose-lines --set unit=mm`: a text file of positions a frame.

    The fields are the settings of the exporter.
    """

    unit: Literal["m", "mm"] = "m"

    def check(self, target: Target) -> None:
        """Any scene fits."""

    def folder(self, target: Target) -> str:
        return "poses"

    def label_camera(self, target: Target, camera: Camera) -> Camera:
        return camera

    def quaternion(self, target: Target) -> None:
        return None

    def write_models(self, target: Target) -> tuple[list[Any], list[str]]:
        return [], []

    def write_frame(self, target: Target, frame: Frame) -> FrameRow:
        truth = read_frame_truth(target.scene, frame.id)
        positions = {o.object: SE3.from_matrix(o.T_cam_obj).t for o in truth.objects}
        factor = {"m": 1, "mm": 1000}[self.unit]
        lines = [
            f"{key} {' '.join(f'{factor * x:.6f}' for x in t)}" for key, t in positions.items()
        ]
        name = f"poses/{frame.name}.txt"
        write_bytes_atomic(target.root / name, "\n".join([*lines, ""]).encode())
        ids = {key: key for key in positions}
        row = exported_frame(target, frame, truth, stem=frame.name, mask_ids=ids)
        return FrameRow(frame=row, truth=truth, outputs=[name])

    def finish(self, target: Target, rows: list[FrameRow], models: list[Any]) -> list[str]:
        return []


POSE_LINES = PoseLines()


class NearRenderer(RaycastRenderer):
    """`std-curate render --renderer near`: the built-in ray caster, nothing beyond 2 m."""

    name = "near"

    def draw(self, *scene: Any, **window: Any) -> Raster:
        raster = super().draw(*scene, **window)
        far = raster.depth > 2.0
        raster.depth[far], raster.face[far] = 0, -1
        return raster


class Tape:
    """`std-curate poses --scale tape`: metres from the first to the last camera, in tape.txt."""

    name = "tape"

    def available(self, context: ScaleContext) -> bool:
        return (context.scene.root / "tape.txt").is_file()

    def estimate(self, context: ScaleContext) -> ScaleEstimate:
        metres = float((context.scene.root / "tape.txt").read_text())
        first, *_, last = (T_cam_world.inverse().t for T_cam_world in context.poses.values())
        factor = metres / float(np.linalg.norm(first - last))
        return ScaleEstimate(
            source=self.name, factor=factor, spread=0, standard_error=0, count=1, deviation=0.002
        )


def careful_depth(views: Any, hull: Any, *, neighbours: int, **others: Any) -> Any:
    """`std-scan --depth careful`: the built-in depth maps from two more photos each."""
    return depth_maps(views, hull, neighbours=neighbours + 2, **others)


class WallCamera:
    """`std-restore live --camera wall`: a grey wall at one metre."""

    def __init__(self, request: CameraRequest) -> None:
        self.name, self.request = "a wall", request
        width, height = request.size
        self.camera = Camera(width, height, width, width, width / 2 - 0.5, height / 2 - 0.5)

    def frames(self) -> Iterator[LiveFrame]:
        width, height = self.request.size
        color, depth = np.full((height, width, 3), 128, np.uint8), np.ones((height, width), "f4")
        for i in range(1000):
            if self.request.stop():
                return
            yield LiveFrame(color, depth, i / self.request.fps)

    def close(self) -> None:
        """Nothing is open."""
