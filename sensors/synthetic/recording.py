"""Writes a synthetic recording in the form of a camera recording, with its ground truth.

The camera moves along a hand-held arc around the table.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
import trimesh
from numpy.typing import NDArray

from sensors.output.recording_writer import TrueObject, Truth
from sensors.synthetic.camera_frames import render_frame, sensor_depth
from sensors.synthetic.raycast_world import World
from sensors.synthetic.shapes import Image, Shape, default_shapes, textured_mesh
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.io import atomic, documents, images
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.scene import model
from std_toolkit.scene.model import ContinuousSymmetry as AxisSymmetry

DEPTH_SCALE = 0.001

# Mesh frame y up, world z up.
UPRIGHT = so3_exp([np.pi / 2, 0.0, 0.0])

# Point that the camera looks at: slightly above the centre of the table.
TARGET_M = np.array([0.0, 0.0, 0.05])


@dataclass(frozen=True, kw_only=True)
class RecordingOptions:
    """What to record.

    Attributes:
        frames: number of frames.
        arc_degrees: angle of the camera's path around the table.
        width, height: image size; the horizontal field of view is 56 degrees.
        radius_m: distance of the camera from the centre of the table.
        elevation_degrees: middle of the camera's height above the table.
        depth_bias: factor on the sensor's depth.
        depth: "stereo" fails on metal; "clean" has the surface of metal. Both see through glass.
        samples: rays per pixel and axis for colour.
        seed: of object poses, textures, path and noise.
    """

    frames: int = 120
    arc_degrees: float = 120.0
    width: int = 640
    height: int = 480
    radius_m: float = 0.62
    elevation_degrees: float = 42.0
    depth_bias: float = 1.015
    depth: Literal["stereo", "clean"] = "stereo"
    samples: int = 2
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("frames", "width", "height", "samples"):
            if getattr(self, name) < 1:
                raise ToolkitError("must be at least 1", field=name, value=getattr(self, name))

    def camera(self) -> Camera:
        f = 0.94 * self.width
        # An off-centre principal point, so that errors in its handling are detected.
        return Camera(self.width, self.height, f, f, self.width / 2 + 3.3, self.height / 2 - 2.7)

    def path(self) -> list[SE3]:
        """T_world_cam of the frames."""
        return arc(
            self.frames,
            degrees=self.arc_degrees,
            radius_m=self.radius_m,
            seed=self.seed,
            elevation_degrees=self.elevation_degrees,
        )


@dataclass(frozen=True)
class Placed:
    """An object on the table.

    Attributes:
        shape: what the images show.
        pose: T_world_obj.
        mesh: what the label's user has, in the frame of the shape; None: the shape's mesh.
        printed: whether that mesh has the object's texture.
        labelled: False for clutter, of which neither mesh nor pose is told.
    """

    shape: Shape
    pose: SE3
    mesh: trimesh.Trimesh | None = None
    printed: bool = False
    labelled: bool = True

    @property
    def mesh_file(self) -> str:
        # One file each: GLB has the texture inside.
        return f"models/{self.shape.name}.{'glb' if self.printed else 'ply'}"


class Layout(Hashable, Protocol):
    """Description of the objects on the table, from which each process makes them once."""

    def objects(self) -> Sequence[Placed]:
        """The objects; every call gives the same."""


@dataclass(frozen=True)
class DefaultLayout:
    """The six objects of the default recording, placed by a seed."""

    seed: int

    def objects(self) -> list[Placed]:
        """See `Layout.objects`."""
        shapes = default_shapes()
        return [Placed(s, T) for s, T in zip(shapes, _places(shapes, self.seed), strict=True)]


def make_recording(
    out: Path,
    options: RecordingOptions | None = None,
    *,
    layout: Layout | None = None,
    jobs: JobOptions | None = None,
) -> Truth:
    """Write color/, depth/ (16-bit PNG, mm), models/, intrinsics.json and truth.json to `out`.

    Existing frames are kept; a recording with truth.json is complete.
    """
    options = options or RecordingOptions()
    layout = layout or DefaultLayout(options.seed)
    placed, world = _world(layout, options.seed)
    truth = _truth(options, [p for p in placed if p.labelled])
    for item, texture in zip(placed, world.textures, strict=True):
        if item.labelled:
            _write_mesh(out / item.mesh_file, item, texture)
    work = run_jobs(
        partial(_write_frame, out, options, layout),
        list(range(options.frames)),
        name="record",
        options=jobs,
    )
    work.raise_if_failed()
    camera = options.camera()
    documents.write_document(
        out / "intrinsics.json",
        {"width": camera.width, "height": camera.height, "K": camera.K.tolist()},
    )
    documents.write_document(out / "truth.json", truth)
    return truth


def textured_meshes(options: RecordingOptions) -> dict[str, trimesh.Trimesh]:
    """Meshes of the opaque objects of a recording with their textures, by name, as scans have them.

    The meshes that `make_recording` writes have no texture. Mirrors and glass show none.
    """
    _, world = _world(DefaultLayout(options.seed), options.seed)
    return {
        shape.name: textured_mesh(shape.mesh, texture)
        for shape, texture in zip(world.shapes, world.textures, strict=True)
        if shape.material in model.DIFFUSE_MATERIALS
    }


def _truth(options: RecordingOptions, placed: list[Placed]) -> Truth:
    return Truth(
        camera=model.CameraModel.of(options.camera()),
        depth_scale=DEPTH_SCALE,
        depth_bias=options.depth_bias,
        frames=[f"{i:06d}" for i in range(options.frames)],
        T_world_cam=[T.flat() for T in options.path()],
        objects=[
            TrueObject(
                name=p.shape.name,
                category=p.shape.category,
                class_id=model.CATEGORY_CLASS_IDS.get(p.shape.category, 0),
                material=p.shape.material,
                mesh=p.mesh_file,
                symmetry=model.SymmetryModel(
                    discrete=[list(T) for T in p.shape.symmetry.discrete],
                    continuous=[
                        AxisSymmetry(axis=list(a), offset=list(o))
                        for a, o in p.shape.symmetry.continuous
                    ],
                ),
                T_world_obj=p.pose.flat(),
            )
            for p in placed
        ],
    )


def _places(shapes: list[Shape], seed: int) -> list[SE3]:
    """Upright poses on the table, as close together as clutter, without overlap."""
    rng = np.random.default_rng(seed + 1)
    placed: list[tuple[float, float, float]] = []
    poses = []
    for shape in shapes:
        radius = float(np.linalg.norm(shape.mesh.vertices[:, [0, 2]], axis=1).max())
        reach = 0.10
        while True:
            x, y = rng.uniform(-reach, reach, 2)
            if all(np.hypot(x - a, y - b) > radius + r + 0.008 for a, b, r in placed):
                break
            reach *= 1.01
        placed.append((x, y, radius))
        turn = so3_exp([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
        poses.append(SE3(turn @ UPRIGHT, np.array([x, y, shape.mesh.extents[1] / 2])))
    return poses


@cache
def _world(layout: Layout, seed: int) -> tuple[list[Placed], World]:
    # Textures and acceleration structures are made once per worker process.
    placed = list(layout.objects())
    return placed, World([p.shape for p in placed], [p.pose for p in placed], seed=seed)


def _write_frame(out: Path, options: RecordingOptions, layout: Layout, index: int) -> None:
    depth_path = out / f"depth/{index:06d}.png"
    if depth_path.exists():
        return
    _, world = _world(layout, options.seed)
    camera = options.camera()
    pose = options.path()[index]
    rng = np.random.default_rng([options.seed, index])
    maps = render_frame(world, camera, pose, rng=rng, samples=options.samples)
    materials = np.array([0, *(max(1, model.MATERIAL_IDS[s.material]) for s in world.shapes)])
    clean = options.depth == "clean"
    depth = sensor_depth(
        maps.behind if clean else maps.depth,
        maps.behind,
        np.zeros_like(maps.ids) if clean else materials[maps.ids],
        fx=camera.fx,
        bias=options.depth_bias,
        rng=rng,
    )
    # Colour first: the depth file marks a frame as complete.
    images.write_color(out / f"color/{index:06d}.png", maps.color)
    images.write_depth_png16(depth_path, np.where(depth < 10, depth, 0), scale=DEPTH_SCALE)


def _write_mesh(path: Path, item: Placed, texture: Image) -> None:
    mesh = item.shape.mesh if item.mesh is None else item.mesh
    with atomic.atomic_path(path) as temporary:
        (textured_mesh(mesh, texture) if item.printed else mesh).export(temporary)


def look_at(eye: NDArray[np.float64], target: NDArray[np.float64], *, roll: float = 0.0) -> SE3:
    """T_world_cam of a camera at `eye` that looks at `target`; world z up, OpenCV camera."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    return SE3(np.stack([c * right + s * down, c * down - s * right, forward], axis=1), eye)


def arc(
    frames: int,
    *,
    degrees: float,
    radius_m: float,
    seed: int,
    start_degrees: float = -60.0,
    elevation_degrees: float = 42.0,
) -> list[SE3]:
    """T_world_cam along an arc, with the slow drift and the tremor of a hand."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0, 1, frames)
    azimuth = np.radians(start_degrees + degrees * s)
    phase = rng.uniform(0, 2 * np.pi, 4)
    elevation = np.radians(elevation_degrees + 7 * np.sin(2 * np.pi * s + phase[0]))
    radius = radius_m * (1 + 0.06 * np.sin(3 * np.pi * s + phase[1]))
    poses = []
    for i in range(frames):
        horizontal = radius[i] * np.cos(elevation[i])
        outward = [horizontal * np.cos(azimuth[i]), horizontal * np.sin(azimuth[i])]
        eye = TARGET_M + np.array([*outward, radius[i] * np.sin(elevation[i])])
        target = TARGET_M + 0.02 * np.sin([5 * s[i] + phase[2], 4 * s[i] + phase[3], 0.0])
        tremor = rng.normal(0, 0.0015, 3)
        poses.append(look_at(eye + tremor, target, roll=0.05 * np.sin(6 * s[i] + phase[0])))
    return poses
