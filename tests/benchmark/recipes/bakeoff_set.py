"""A recording whose truth is known, and methods that are better, worse or equal by construction."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmark.methods.protocol import Restored, View
from benchmark.methods.registry import MethodOptions
from std_toolkit.geometry import SE3
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import write_depth_png16, write_png
from std_toolkit.scene import CameraModel, Model, Object, ObjectTable, Scene, SceneInfo
from tests.scene_on_disk import CAMERA, camera_poses, write_frames

WALL, GLASS, BOX = 1.0, 0.8, 0.9
STEP_M = 0.18  # of the camera from frame to frame: more than 10 degrees of the wall's distance


def write_recording(
    root: Path, *, frames: int = 9, step: float = STEP_M, glass: bool = True, vendor: bool = False
) -> Scene:
    """A wall, glass plates in a row, which the sensor does not see, and opaque ones below.

    The camera moves to the right. Only the plates have true depth; the sensor is off by up to 2 mm.
    """
    rng = np.random.default_rng(7)
    width = CAMERA.width
    u = np.arange(width)
    truth, sensors, masks = [], [], []
    for i in range(frames):
        mask = np.zeros((CAMERA.height, width), np.uint8)
        for number, z, rows in ((1, GLASS, slice(10, 30)), (2, BOX, slice(40, 60))):
            x = (u - CAMERA.cx) * z / CAMERA.fx + step * i
            mask[rows, x % 0.36 < 0.18] = number
        true = np.select([mask == 1, mask == 2], [GLASS, BOX], WALL).astype(np.float32)
        sensor = true + rng.uniform(-0.002, 0.002, true.shape).astype(np.float32)
        sensor[mask == 1] = 0
        truth.append(np.where(mask > 0, true, 0).astype(np.float32))
        sensors.append(sensor)
        masks.append(mask)
    images = [rng.integers(0, 256, (*m.shape, 3), dtype=np.uint8) for m in masks]
    table = write_frames(root, images, sensors)
    models = [
        Model(id=m, mesh=f"models/{m}.ply", size_m=[0.1, 0.1, 0.1], diameter_m=0.2)
        for m in ("plate", "box")
    ]
    objects = [
        Object(id=1, name="plate", model="plate", material="transparent" if glass else "diffuse"),
        Object(id=2, name="box", model="box", material="diffuse"),
    ]
    info = SceneInfo(
        name="r", cameras={"color": CameraModel.of(CAMERA)}, depth_scale=0.001, source="import:test"
    )
    scene = Scene.create(root, info, table, ObjectTable(models=models, objects=objects))
    poses = [SE3.exp([step * i, 0, 0, 0, 0, 0]) for i in range(frames)]
    scene.save_poses(camera_poses(poses))
    for frame, true, mask in zip(table.frames, truth, masks, strict=True):
        write_exr(root / "reference" / "depth" / f"{frame.name}.exr", {"Y": true})
        write_png(root / "reference" / "mask" / f"{frame.name}.png", mask)
        if vendor:
            whole = np.where(true > 0, true, np.float32(WALL))
            write_depth_png16(root / "depth_enhanced" / f"{frame.name}.png", whole, scale=0.001)
    return scene


def words_of(*methods: str) -> list[str]:
    names = [m if "=" in m else f"{__file__}:{m}" for m in methods]
    fast = ["--no-at-hand", "--no-speed"]
    return [*fast, *(["--method", *names] if names else [])]


def own(name: str) -> str:
    return f"bakeoff_set.py.{name}"


class Good:
    """Fills holes with the glass's depth, off by 5 mm."""

    input_size: tuple[int, int] | None = None
    needs_mask = False
    filled = GLASS + 0.005

    def __init__(self, options: MethodOptions) -> None:
        self.settings = options.settings

    def restore(self, views: Sequence[View]) -> list[Restored]:
        return [Restored(np.where(v.depth > 0, v.depth, np.float32(self.filled))) for v in views]


class Near(Good):
    """Off by 5 mm to the other side: another method of the same error."""

    filled = GLASS - 0.005


class Poor(Good):
    filled = GLASS + 0.05


class Harmful(Good):
    """Exact on glass; all else is moved by 5 %."""

    filled = GLASS

    def restore(self, views: Sequence[View]) -> list[Restored]:
        done = super().restore(views)
        return [
            Restored(np.where(v.depth > 0, np.float32(1.05) * v.depth, r.depth))
            for v, r in zip(views, done, strict=True)
        ]


class Random(Good):
    """Fills holes with 20 mm of noise of its own, which differs from frame to frame."""

    seed = 1

    def restore(self, views: Sequence[View]) -> list[Restored]:
        found = []
        for view in views:
            own = np.random.default_rng([self.seed, *view.color[0, 0].tolist()])
            filled = GLASS + own.normal(0, 0.02)
            found.append(Restored(np.where(view.depth > 0, view.depth, np.float32(filled))))
        return found


class OtherRandom(Random):
    seed = 2


class Broken(Good):
    """Fails at every frame."""

    def restore(self, views: Sequence[View]) -> list[Restored]:  # noqa: ARG002
        raise ValueError("no memory left")
