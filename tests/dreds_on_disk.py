"""Small sets in the layouts of DREDS, STD and ClearGrasp, written in milliseconds.

Spheres over a table, drawn exactly: depth, mask and NOCS agree with each other, with the poses in
the meta files and with the cameras that the layouts imply. What the public files do, these do:
three equal channels in depth, id/255 in EXR masks, B = 1 - z in NOCS, -0.001 where the simulated
sensor measured nothing, NaN in ClearGrasp's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import write_color, write_png

RAW, DIFFUSE, TRANSPARENT, SPECULAR = 0, 1, 2, 3
TABLE_M = 0.8
COLOR_SIZE = (128, 72)
LABEL_SIZE = (64, 36)


@dataclass(frozen=True)
class Ball:
    """A sphere: `centre` in metres in the camera frame of frame 0."""

    mask_id: int
    class_id: int
    material: int
    category: str
    model: str
    centre: tuple[float, float, float]
    radius: float = 0.05

    @property
    def diagonal(self) -> float:
        return 2 * self.radius * 3**0.5


BALLS = (
    Ball(1, 1, TRANSPARENT, "02876657", "bottle_a", (-0.15, 0.0, 0.6)),
    Ball(2, 6, SPECULAR, "03797390", "mug_b", (0.0, 0.05, 0.62)),
    Ball(3, 3, DIFFUSE, "02942699", "camera_c", (0.14, -0.05, 0.58)),
    Ball(4, 0, RAW, "00000000", "thing_d", (0.05, -0.1, 0.64), 0.04),
)


@dataclass(frozen=True, eq=False)
class Drawn:
    """What was written for a frame.

    Attributes:
        color: (H, W, 3) uint8.
        raw: float32 metres, 0 = no measurement, at the size of the raw file.
        true: float32 metres, 0 = no ground truth, label size.
        mask: uint8, 255 = background, label size.
        nocs: float32, x y z in 0..1, 0 in the background, label size.
        camera: of the labels.
    """

    color: NDArray[np.uint8]
    raw: NDArray[np.float32]
    true: NDArray[np.float32]
    mask: NDArray[np.uint8]
    nocs: NDArray[np.float32]
    camera: Camera


def dreds_camera(size: tuple[int, int] = LABEL_SIZE) -> Camera:
    """The camera that the released code assumes for DREDS."""
    return Camera(640, 360, 446.31, 446.31, 319.5, 179.5).resized(*size)


def std_camera(size: tuple[int, int] = LABEL_SIZE) -> Camera:
    """The camera that the released code assumes for STD."""
    return Camera(1280, 720, 918.295, 917.544, 639.5, 359.5).resized(*size)


def write_dreds_scene(
    folder: Path,
    *,
    frames: int = 2,
    balls: Sequence[Ball] = BALLS,
    color_size: tuple[int, int] = COLOR_SIZE,
    label_size: tuple[int, int] = LABEL_SIZE,
    truth: str = "_depth_120.exr",
    half: bool = False,
    short_meta: bool = False,
    camera: Camera | None = None,
    seed: int = 0,
) -> list[Drawn]:
    """A scene folder of DREDS; returns its frames "0000", "0001", ...

    Args:
        truth: suffix of the ground truth: "_depth_0.exr" in CatNovel.
        half: EXR files hold half floats.
        short_meta: three fields a line and no NOCS pictures, as in CatNovel.
        camera: of the labels, if not the one that the released code assumes.
    """
    kind = np.float16 if half else np.float32
    made = []
    for i in range(frames):
        drawn = draw(i, balls, camera or dreds_camera(label_size), color_size, label_size, seed)
        made.append(drawn)
        base = f"{i:04d}"
        write_color(folder / f"{base}_color.png", drawn.color)
        for side in ("l", "r"):
            write_png(folder / f"{base}_ir_{side}.png", np.ascontiguousarray(drawn.color[..., 0]))
        raw = np.where(drawn.raw > 0, drawn.raw, np.float32(-0.001))
        write_equal(folder / f"{base}_simDepthImage.exr", raw.astype(kind))
        write_equal(folder / f"{base}{truth}", drawn.true.astype(kind))
        write_equal(folder / f"{base}_mask.exr", (drawn.mask / np.float32(255)).astype(kind))
        _write_meta(folder / f"{base}_meta.txt", i, balls, short_meta)
        if not short_meta:
            write_png(folder / f"{base}_coord.png", coord_picture(drawn))
    return made


def write_std_scene(
    folder: Path,
    *,
    frames: int = 2,
    balls: Sequence[Ball] = BALLS[:3],
    color_size: tuple[int, int] = COLOR_SIZE,
    label_size: tuple[int, int] = LABEL_SIZE,
    short_meta: bool = False,
    seed: int = 0,
) -> list[Drawn]:
    """A scene folder of STD: ground truth on the objects only, raw depth of the colour's size."""
    made = []
    for i in range(frames):
        drawn = draw(i, balls, std_camera(label_size), color_size, color_size, seed)
        true = np.where(drawn.mask != 255, drawn.true, np.float32(0))
        drawn = Drawn(drawn.color, drawn.raw, true, drawn.mask, drawn.nocs, drawn.camera)
        made.append(drawn)
        base = f"{i:04d}"
        write_color(folder / f"{base}_color.png", drawn.color)
        write_equal(folder / f"{base}_depth_415.exr", drawn.raw)
        write_equal(folder / f"{base}_gt_depth.exr", drawn.true)
        write_png(folder / f"{base}_mask.png", drawn.mask)
        _write_meta(folder / f"{base}_meta.txt", i, balls, short_meta)
        if not short_meta:
            write_png(folder / f"{base}_coord.png", coord_picture(drawn))
    return made


def write_cleargrasp_real(
    folder: Path,
    *,
    frames: int = 2,
    size: tuple[int, int] = COLOR_SIZE,
    intrinsics: bool = True,
    seed: int = 0,
) -> list[Drawn]:
    """A folder such as `real-val/d435`: half floats, NaN where the twins were not measured."""
    camera = Camera(1280, 720, 921, 921, 642, 359).resized(*size)
    made = []
    for i in range(frames):
        drawn = draw(i, BALLS[:2], camera, size, size, seed)
        mask = np.where(drawn.mask == 255, 255, 1).astype(np.uint8)
        hole = np.arange(drawn.true.size).reshape(drawn.true.shape) % 37 == 0
        true = _halved(np.where(hole, 0, drawn.true))
        drawn = Drawn(drawn.color, _halved(drawn.raw), true, mask, drawn.nocs, camera)
        made.append(drawn)
        base = f"{i:09d}"
        write_color(folder / f"{base}-transparent-rgb-img.jpg", drawn.color)
        write_color(folder / f"{base}-opaque-rgb-img.jpg", drawn.color)
        write_equal(folder / f"{base}-transparent-depth-img.exr", drawn.raw.astype(np.float16))
        opaque = np.where(drawn.true > 0, drawn.true, np.float32(np.nan))
        write_equal(folder / f"{base}-opaque-depth-img.exr", opaque.astype(np.float16))
        write_png(folder / f"{base}-mask.png", np.where(mask == 1, 255, 0).astype(np.uint8))
    if intrinsics:
        (folder / "camera_intrinsics.yaml").write_text(
            f"camera_name: 'D435'\nxres: {size[0]}\nyres: {size[1]}\nfx: {camera.fx}\n"
            f"fy: {camera.fy}\ncx: {camera.cx}\ncy: {camera.cy}\n"
        )
    return made


def write_cleargrasp_synthetic(
    folder: Path, *, frames: int = 2, size: tuple[int, int] = LABEL_SIZE, seed: int = 0
) -> list[Drawn]:
    """A folder such as `synthetic-val/cup-with-waves-val`, which has no raw depth."""
    fov_x = 1.2112585306167603
    f = size[0] / 2 / np.tan(fov_x / 2)
    camera = Camera(*size, f, f, size[0] / 2 - 0.5, size[1] / 2 - 0.5)
    made = []
    for i in range(frames):
        drawn = draw(i, BALLS[:2], camera, size, size, seed)
        mask = np.where(drawn.mask == 255, 255, 1).astype(np.uint8)
        raw = np.where(mask == 1, np.float32(0), drawn.true)
        made.append(Drawn(drawn.color, raw, drawn.true, mask, drawn.nocs, camera))
        base = f"{i:09d}"
        write_color(folder / "rgb-imgs" / f"{base}-rgb.jpg", drawn.color)
        write_equal(folder / "depth-imgs-rectified" / f"{base}-depth-rectified.exr", drawn.true)
        picture = np.where(mask == 1, 255, 0).astype(np.uint8)
        write_png(folder / "segmentation-masks" / f"{base}-segmentation-mask.png", picture)
        document = folder / "json-files" / f"{base}-masks.json"
        document.parent.mkdir(exist_ok=True)
        document.write_text(f'{{"camera": {{"field_of_view": {{"x_axis_rads": {fov_x}}}}}}}')
    return made


def draw(
    index: int,
    balls: Sequence[Ball],
    camera: Camera,
    color_size: tuple[int, int],
    raw_size: tuple[int, int],
    seed: int = 0,
) -> Drawn:
    """Frame `index`: the balls move by 5 mm from frame to frame; holes in raw depth on glass."""
    rng = np.random.default_rng([seed, index])
    true, mask, nocs = _surfaces(index, balls, camera)
    raw, raw_mask, _ = _surfaces(index, balls, camera.resized(*raw_size))
    raw = (raw + rng.normal(0, 0.001, raw.shape)).astype(np.float32)
    glass = np.isin(raw_mask, [b.mask_id for b in balls if b.material == TRANSPARENT])
    raw[rng.random(raw.shape) < np.where(glass, 0.6, 0.02)] = 0
    color = rng.integers(0, 256, (color_size[1], color_size[0], 3), dtype=np.uint8)
    return Drawn(color, raw, true, mask, nocs, camera)


def pose(ball: Ball, index: int) -> SE3:
    """T_cam_obj of a ball in frame `index`."""
    turn = SE3.exp([0, 0, 0, 0.3 * ball.mask_id, 0.2, 0.1 * index])
    return SE3(turn.R, np.add(ball.centre, (0.005 * index, 0, 0)))


def coord_picture(drawn: Drawn) -> NDArray[np.uint8]:
    """NOCS as the layouts store it: 8 bit, B = 1 - z, black background."""
    picture = drawn.nocs.copy()
    picture[..., 2] = 1 - picture[..., 2]
    picture[drawn.mask == 255] = 0
    return np.rint(picture * 255).astype(np.uint8)


def write_equal(path: Path, values: NDArray[np.floating]) -> None:
    """An EXR of three equal channels."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_exr(path, dict.fromkeys("RGB", values), compression="zip")


def _surfaces(
    index: int, balls: Sequence[Ball], camera: Camera
) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.float32]]:
    rays = camera.rays()
    depth = np.full(rays.shape[:2], TABLE_M)
    mask = np.full(rays.shape[:2], 255, np.uint8)
    nocs = np.zeros(rays.shape)
    for ball in balls:
        T_cam_obj = pose(ball, index)
        # |z ray - centre| = radius
        a, b = (rays**2).sum(axis=-1), rays @ T_cam_obj.t
        root = b**2 - a * (T_cam_obj.t @ T_cam_obj.t - ball.radius**2)
        z = (b - np.sqrt(np.maximum(root, 0))) / a
        hit = (root > 0) & (z < depth)
        depth[hit] = z[hit]
        mask[hit] = ball.mask_id
        points = (rays[hit] * z[hit][:, None] - T_cam_obj.t) @ T_cam_obj.R
        nocs[hit] = points / ball.diagonal + 0.5
    return depth.astype(np.float32), mask, nocs.astype(np.float32)


def _write_meta(path: Path, index: int, balls: Sequence[Ball], short: bool) -> None:
    lines = []
    for ball in balls:
        T_cam_obj = pose(ball, index)
        q = SE3(T_cam_obj.R.T, np.zeros(3)).quat()
        numbers = " ".join(f"{x:.9f}" for x in (*q, *T_cam_obj.t))
        if short:
            lines.append(f"{ball.mask_id} {ball.class_id} {ball.material} \n")
        else:
            lines.append(
                f"{ball.mask_id} {ball.class_id} {ball.category} {ball.model} "
                f"{ball.diagonal:.9f} {ball.material} {numbers} \n"
            )
    path.write_text("".join(lines), encoding="ascii")


def _halved(values: NDArray[np.floating]) -> NDArray[np.float32]:
    return values.astype(np.float16).astype(np.float32)
