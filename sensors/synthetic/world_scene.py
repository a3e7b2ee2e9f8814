"""Scenes of many kinds of objects with right labels, by seed: `world_scene(seed, kinds)`.

    from sensors.synthetic.kinds import JUDGING, SETTING
    from sensors.synthetic.world_scene import draw_world, world_scene

    scene = world_scene(7, JUDGING, frames=8)  # a Scene; labels.json is right
    drawn = draw_world(7, JUDGING, frames=8)   # what it is; drawn.scene() is the same
    for thing in drawn.things(): thing.name, thing.kind.name, thing.look, thing.scale

A scene has one to seven labelled objects on a printed table, up to two more without a label, and a
camera on an arc. A seed also draws the sensor, whether each object differs from its mesh, and
whether camera poses have the errors of structure from motion. Each of them can be chosen.

Scenes are kept in ~/.cache/std-toolkit/world (or $XDG_CACHE_HOME, or `folder`), under a name that
depends on what was drawn and on the source of this package. They are not to be changed: copy one
first.
"""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal, get_args

import msgspec
import numpy as np
import trimesh

from sensors.synthetic.kinds import JUDGING, MATERIAL_OF, Kind, Look, kind_named
from sensors.synthetic.recording import (
    UPRIGHT,
    Placed,
    RecordingOptions,
    make_recording,
)
from sensors.synthetic.shapes import Shape
from sensors.synthetic.solids import deformed
from sensors.synthetic.truth import scene_from_truth
from std_toolkit.arrays import Array
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.geometry.symmetry import Symmetry
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.jobs import JobOptions
from std_toolkit.scene import Scene
from std_toolkit.scene.model import pose_from_list

Generator = np.random.Generator
Sensor = Literal["colour", "stereo", "clean"]

# Root mean square of the length of the error of a camera's position and of its rotation vector.
CAMERA_NOISE_M, CAMERA_NOISE_RAD = 0.001, float(np.deg2rad(0.1))
# Bias of a D435 that was not calibrated again: up to 2 % at these distances.
STEREO_BIAS = (0.99, 1.02)
LARGEST_SHAPE_ERROR = 0.03
SMALLEST_SHAPE_ERROR = 0.01
_SHARE_OF_LOOKS: dict[Look, float] = {"bare": 0.25, "printed": 0.27, "glass": 0.24, "steel": 0.24}
_MOST_LABELLED, _MOST_CLUTTER = 7, 2
_GAP_M = 0.008


@dataclass(frozen=True)
class Thing:
    """One object of a scene before it is placed.

    Attributes:
        name: in the scene, such as "mug_2".
        kind, look: what it is.
        mesh: that of the label, centred, metres.
        scale: (3,) size of the object in units of the mesh's, per axis of the mesh.
        bulge: see `solids.deformed`.
        marks: number of marks printed on the object.
        labelled: False for clutter.
    """

    name: str
    kind: Kind
    look: Look
    mesh: trimesh.Trimesh
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    bulge: float = 0.0
    marks: int = 0
    labelled: bool = True

    @property
    def is_exact(self) -> bool:
        """Whether the mesh is that of the object."""
        return self.scale == (1.0, 1.0, 1.0) and self.bulge == 0.0

    def shape(self) -> Shape:
        """What the images show."""
        seen = self.mesh
        if not self.is_exact:
            seen = deformed(self.mesh, np.asarray(self.scale), self.bulge)
        symmetry = Symmetry() if self.look == "printed" else self.kind.symmetry
        material = MATERIAL_OF[self.look]
        return Shape(self.name, self.kind.name, material, seen, symmetry, self.marks)


@dataclass(frozen=True)
class World:
    """What a scene is; see `draw_world`."""

    seed: int
    kinds: tuple[str, ...]
    frames: int
    width: int
    height: int
    sensor: Sensor
    camera_noise: bool
    shape_errors: bool

    def things(self) -> list[Thing]:
        """The objects, those without a label last."""
        rng = np.random.default_rng([self.seed, 1])
        labelled = int(rng.integers(1, _MOST_LABELLED + 1))
        count = labelled + int(rng.integers(0, _MOST_CLUTTER + 1))
        kinds = [kind_named(name) for name in self.kinds]
        return [
            _draw_thing(kinds, np.random.default_rng([self.seed, 2, i]), i, i < labelled, self)
            for i in range(count)
        ]

    def objects(self) -> list[Placed]:
        """The objects in their places; see `recording.Layout`."""
        return list(_placed(self))

    def options(self) -> RecordingOptions:
        """Of the recording. The camera sees all objects."""
        rng = np.random.default_rng([self.seed, 3])
        placed = self.objects()
        points = [p.pose @ p.shape.mesh.vertices for p in placed]
        reach = max(float(np.linalg.norm(p[:, :2], axis=1).max()) for p in points)
        height = max(float(p[:, 2].max()) for p in points)
        return RecordingOptions(
            frames=self.frames,
            arc_degrees=float(rng.uniform(60, 150)),
            width=self.width,
            height=self.height,
            radius_m=max(0.45, 1.7 * reach, 0.35 + 1.4 * height) * float(rng.uniform(1.0, 1.3)),
            elevation_degrees=float(rng.uniform(27, 58)),
            depth_bias=float(rng.uniform(*STEREO_BIAS)) if self.sensor == "stereo" else 1.0,
            depth="clean" if self.sensor == "clean" else "stereo",
            seed=self.seed,
        )

    def scene(self, folder: Path | None = None) -> Scene:
        """The scene with right labels, made at the first call.

        Args:
            folder: that keeps scenes; default: in the user's cache.
        """
        folder = world_cache() if folder is None else folder
        key = hashlib.sha256(f"{_source()} {self}".encode()).hexdigest()[:12]
        root = folder / f"{self.seed:05d}_{key}"
        if not root.is_dir():
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=folder, prefix=".making_") as temporary:
                made = Path(temporary) / "scene"
                self._write(Path(temporary) / root.name, made)
                with suppress(OSError):  # another process was earlier
                    made.rename(root)
        return Scene.open(root)

    def _write(self, recording: Path, root: Path) -> None:
        quiet = JobOptions(engine="serial", progress=False)
        make_recording(recording, self.options(), layout=self, jobs=quiet)
        scene = scene_from_truth(recording, root)
        shutil.copyfile(recording / "truth.json", root / "truth.json")
        if self.sensor == "colour":
            frames = [msgspec.structs.replace(f, depth=None) for f in scene.frame_table.frames]
            table = msgspec.structs.replace(scene.frame_table, frames=frames)
            write_bytes_atomic(root / "frames.json", msgspec.json.encode(table))
            shutil.rmtree(root / "depth")
        if self.camera_noise:
            shake_cameras(scene, np.random.default_rng([self.seed, 4]))


def draw_world(
    seed: int,
    kinds: Sequence[Kind] = JUDGING,
    *,
    frames: int = 8,
    width: int = 640,
    height: int = 480,
    sensor: Sensor | None = None,
    camera_noise: bool | None = None,
    shape_errors: bool | None = None,
) -> World:
    """Draw a scene; the same arguments give the same scene.

    Args:
        seed: of everything that is not given.
        kinds: of the objects.
        frames: number of frames.
        width, height: of the images.
        sensor: "colour" has no depth, "stereo" that of a D435 with a bias and holes, "clean" that
            of all surfaces but glass without a bias. None draws one.
        camera_noise: whether camera poses of the scene have errors; the images have none.
        shape_errors: whether every second object differs from its mesh, by 1 to 3 % along each
            axis or by a bulge.
    """
    rng = np.random.default_rng([seed, 0])
    drawn: Sensor = get_args(Sensor)[rng.choice(3, p=(0.3, 0.5, 0.2))]
    noisy, other = bool(rng.random() < 0.5), bool(rng.random() < 0.6)
    return World(
        seed=seed,
        kinds=tuple(sorted(kind.name for kind in kinds)),
        frames=frames,
        width=width,
        height=height,
        sensor=drawn if sensor is None else sensor,
        camera_noise=noisy if camera_noise is None else camera_noise,
        shape_errors=other if shape_errors is None else shape_errors,
    )


def world_scene(
    seed: int,
    kinds: Sequence[Kind] = JUDGING,
    *,
    frames: int = 8,
    sensor: Sensor | None = None,
    camera_noise: bool | None = None,
    shape_errors: bool | None = None,
    folder: Path | None = None,
) -> Scene:
    """A scene with right labels; see `draw_world` and `World.scene`."""
    return draw_world(
        seed,
        kinds,
        frames=frames,
        sensor=sensor,
        camera_noise=camera_noise,
        shape_errors=shape_errors,
    ).scene(folder)


def shake_cameras(scene: Scene, rng: Generator) -> None:
    """Write camera poses with errors, their covariances, and labels right in the world."""
    sigma = np.repeat([CAMERA_NOISE_M, CAMERA_NOISE_RAD], 3) / np.sqrt(3)
    covariance = [float(x) for x in np.diag(sigma**2).ravel()]
    assert scene.poses is not None
    frames = []
    for pose in scene.poses.frames:
        assert pose.T_world_cam is not None
        wrong = pose_from_list(pose.T_world_cam) @ SE3.exp(rng.normal(0, sigma))
        frames.append(
            msgspec.structs.replace(pose, T_world_cam=wrong.flat(), covariance=covariance)
        )
    scene.save_poses(msgspec.structs.replace(scene.poses, frames=frames))
    cameras = {f.frame: pose_from_list(f.T_world_cam) for f in frames if f.T_world_cam}
    labels = []
    for label in scene.labels.labels:
        assert label.T_world_obj is not None
        T_cam_obj = cameras[label.frame].inverse() @ pose_from_list(label.T_world_obj)
        labels.append(msgspec.structs.replace(label, T_cam_obj=T_cam_obj.flat()))
    scene.save_labels(msgspec.structs.replace(scene.labels, labels=labels))


def world_cache() -> Path:
    """Default folder that keeps scenes."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "std-toolkit" / "world"


def _draw_thing(
    kinds: Sequence[Kind], rng: Generator, index: int, labelled: bool, world: World
) -> Thing:
    looks = [x for x in _SHARE_OF_LOOKS if any(x in k.looks for k in kinds)]
    share = np.array([_SHARE_OF_LOOKS[x] for x in looks])
    look = looks[rng.choice(len(looks), p=share / share.sum())]
    able = [k for k in kinds if look in k.looks]
    kind = able[rng.integers(len(able))]
    mesh = kind.mesh(rng)
    # A bare mesh may be that of a plain or of a printed object.
    marks = int(rng.uniform(150, 320)) if look == "printed" else int(rng.choice([0, 0, 30, 200]))
    scale, bulge = (1.0, 1.0, 1.0), 0.0
    if world.shape_errors and rng.random() < 0.5:
        size = rng.uniform(SMALLEST_SHAPE_ERROR, LARGEST_SHAPE_ERROR, 4) * rng.choice([-1, 1], 4)
        if rng.random() < 0.3:
            bulge = float(size[3])
        else:
            if kind.symmetry.continuous or len(kind.symmetry.discrete) > 3:
                size[2] = size[0]  # stays round
            if kind.symmetry.is_spherical:
                size[:] = size[0]
            scale = (float(1 + size[0]), float(1 + size[1]), float(1 + size[2]))
    return Thing(f"{kind.name}_{index + 1}", kind, look, mesh, scale, bulge, marks, labelled)


@cache
def _placed(world: World) -> tuple[Placed, ...]:
    rng = np.random.default_rng([world.seed, 5])
    things = world.things()
    shapes = [t.shape() for t in things]
    turns = [_resting(t.kind, rng) for t in things]
    standing = [s.mesh.vertices @ R.T for s, R in zip(shapes, turns, strict=True)]
    radii = [float(np.linalg.norm(v[:, :2], axis=1).max()) for v in standing]
    places = _spread(radii, rng)
    return tuple(
        Placed(
            shape,
            SE3(R, np.array([*xy, -v[:, 2].min()])),
            mesh=thing.mesh,
            printed=thing.look == "printed",
            labelled=thing.labelled,
        )
        for thing, shape, R, xy, v in zip(things, shapes, turns, places, standing, strict=True)
    )


def _resting(kind: Kind, rng: Generator) -> Array:
    """Rotation of an object that stands, or lies on one of four sides."""
    turn = so3_exp([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    side = so3_exp([0.0, np.pi / 2 * rng.integers(4), 0.0])
    lies = kind.lies and rng.random() < 0.3
    return turn @ (side if lies else UPRIGHT)


def _spread(radii: Sequence[float], rng: Generator) -> list[Array]:
    """Places (x, y) of circles that keep apart, as close together as clutter."""
    placed: dict[int, Array] = {}
    for i in sorted(range(len(radii)), key=lambda k: -radii[k]):
        reach = 0.03
        while True:
            at = rng.uniform(-reach, reach, 2)
            if all(
                np.linalg.norm(at - xy) > radii[i] + radii[k] + _GAP_M for k, xy in placed.items()
            ):
                break
            reach *= 1.004
        placed[i] = at
    centre = np.mean(list(placed.values()), axis=0)
    return [placed[i] - centre for i in range(len(radii))]


@cache
def _source() -> str:
    """Digest of the source that makes the scenes."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
