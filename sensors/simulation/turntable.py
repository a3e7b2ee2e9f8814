"""Photos of a mesh that stands on the printed board, with their ground truth.

The world is the frame of the board: z up, the table at z = 0. On a turntable, board and object turn
before a camera at rest; in their frame, camera and surroundings turn around them.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path

import cv2
import msgspec
import numpy as np
import trimesh

from sensors.lighting.environment import read_environment
from sensors.lighting.environment_sources import studio_map
from sensors.materials.material_draw import draw_material
from sensors.render.color_image import ColorResponse, denoise, develop
from sensors.render.sim_renderer import SIM_RENDERERS, LoadedScene, RenderOptions
from sensors.render.sim_scene import SceneObject, SimScene, SurfaceMesh, TruthCaster
from sensors.simulation import turntable_objects
from sensors.simulation.options import TurntableOptions
from sensors.viewpoints.views import look_at
from std_toolkit.arrays import Floats
from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.importers.foreign_files import write_mesh
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.documents import digest_file, read_document, write_document
from std_toolkit.io.images import write_color, write_png
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.jobs.artefact import begin
from std_toolkit.poses.board_sheet import make_board_sheet
from std_toolkit.scene.model import CameraModel

_TABLE_HALF_M = 1.2
_PLATTER_M = 0.24

# Part of the image's height that the object may cover, and the nearest distance of the camera.
_COVERED, _NEAREST_M = 0.72, 0.33

# Blurred copies of an image, standard deviations in pixels; between them is interpolated.
_BLURS = (0.0, 0.6, 1.2, 2.4, 4.8, 9.6)

# A hand's deviation from the circle, and of the point that it looks at.
_SWAY_M, _DRIFT_M, _ROLL_RAD = 0.008, 0.006, 0.03

_BEGUN = "turntable.json"


class TurntableTruth(msgspec.Struct, frozen=True, kw_only=True):
    """truth/cameras.json. World: the frame of the board, z up, the table at z = 0, metres.

    Attributes:
        camera: intrinsics of all photos; no distortion.
        photos: file names.
        T_world_cam: 16 numbers row-major for each photo.
        T_world_obj: pose of truth/mesh.ply.
    """

    camera: CameraModel
    photos: list[str]
    T_world_cam: list[list[float]]
    T_world_obj: list[float]

    def pose(self, index: int) -> SE3:
        """T_world_cam of a photo."""
        return SE3.from_matrix(self.T_world_cam[index])


def read_turntable_truth(folder: Path) -> TurntableTruth:
    """Ground truth of a folder that `make_turntable` wrote."""
    return read_document(folder / "truth/cameras.json", TurntableTruth)


def make_turntable(options: TurntableOptions) -> tuple[int, float]:
    """Photograph a mesh; see `TurntableOptions`.

    Photos that exist are kept: a run that was killed continues.

    Returns:
        Number of photos made and the seconds that they took.

    Raises:
        ToolkitError: an unusable mesh or map, a folder with other options, or no renderer.
    """
    table = write_truth(options)
    missing = [i for i in range(options.views) if not table.photo(i).exists()]
    start = time.monotonic()
    if missing:
        table.load()
        run_jobs(
            partial(_photograph, table),
            missing,
            name="photos",
            key=lambda i: table.photo(i).name,
            options=JobOptions(engine="serial"),
        ).raise_if_failed()
    return len(missing), time.monotonic() - start


def write_truth(options: TurntableOptions) -> Turntable:
    """Write all but photos and masks: board.json and the truth on cameras and mesh.

    Raises:
        ToolkitError: see `make_turntable`.
    """
    _begin(options)
    return Turntable(options)


def _photograph(table: Turntable, index: int) -> None:
    table.photograph(index)


class Turntable:
    """Object, board, cameras and light of one folder."""

    def __init__(self, options: TurntableOptions) -> None:
        self._o = options
        mesh = load_mesh(options.mesh, unit=options.mesh_unit)
        self.T_world_obj = turntable_objects.standing_pose(mesh, options)
        self.sheet = make_board_sheet(options.paper)
        focal = options.width / 2 / np.tan(np.deg2rad(options.fov_deg) / 2)
        self.camera = Camera(
            fx=float(focal),
            fy=float(focal),
            cx=(options.width - 1) / 2,
            cy=(options.height - 1) / 2,
            width=options.width,
            height=options.height,
        )
        corners = self.T_world_obj @ mesh.vertices
        self._top = float(corners[:, 2].max())
        self._radius = float(np.linalg.norm(corners - [0, 0, self._top / 2], axis=1).max())
        self.poses, self._turns = self._cameras()
        self._mesh = mesh
        self._environment = (
            studio_map(options.seed + 1)
            if options.environment is None
            else read_environment(options.environment)
        )
        self._write_truth()

    def photo(self, index: int) -> Path:
        return self._o.out / f"photos/{index:03d}.jpg"

    def subject(self) -> SceneObject:
        """The object on the board, with its material and texture."""
        return turntable_objects.mesh_object(
            self._mesh, turntable_objects.turntable_material(self._o), self.T_world_obj
        )

    def load(self) -> None:
        """Prepare renderer and scene."""
        floor = self._table()
        self._floor = floor
        scene = SimScene(
            (floor, *turntable_objects.sheet_objects(self.sheet), self.subject()), self._environment
        )
        self._caster = TruthCaster(scene)
        self._scene: LoadedScene = SIM_RENDERERS.get("mitsuba")().load(scene)
        self._exposure: float | None = None

    def photograph(self, index: int) -> None:
        """Render, develop and write one photo with its mask."""
        o, pose = self._o, self.poses[index]
        if o.motion == "turntable":
            self._scene.change(self._environment, self._turns[index], self._floor)
        light = self._scene.color(
            self.camera,
            pose,
            ambient=1.0,
            options=RenderOptions(samples=o.samples, chunk=0, max_depth=12),
            seed=(o.seed * 10_007 + index) % 2**32,
        )
        maps = self._caster.maps(self.camera, pose)
        radiance = denoise(light)
        middle = pose.inverse() @ np.array([0, 0, self._top / 2])
        radiance = _defocus(
            radiance, maps.depth, float(middle[2]), self.camera.fx * o.aperture_mm / 1000
        )
        image, _ = develop(
            radiance,
            rng=np.random.default_rng([o.seed, index]) if o.noise > 0 else None,
            exposure=self._fixed_exposure(),
            response=ColorResponse(gain=o.noise),
        )
        mask = np.where(maps.mask == turntable_objects.OBJECT_ID, 255, 0).astype(np.uint8)
        write_png(o.out / f"truth/masks/{index:03d}.png", mask)
        # Last: a photo that exists is complete.
        write_color(self.photo(index), image)

    def _fixed_exposure(self) -> float:
        """The exposure of all photos, that of the first as a phone with a locked exposure has."""
        if self._exposure is None:
            small = Camera(
                fx=self.camera.fx / 8,
                fy=self.camera.fy / 8,
                cx=(self.camera.width // 8 - 1) / 2,
                cy=(self.camera.height // 8 - 1) / 2,
                width=self.camera.width // 8,
                height=self.camera.height // 8,
            )
            levels = []
            for pose in self.poses[:: max(1, len(self.poses) // 4)]:
                light = self._scene.color(
                    small, pose, ambient=1.0, options=RenderOptions(samples=8, chunk=0), seed=1
                )
                levels.append(develop(light.radiance)[1])
            self._exposure = float(np.median(levels))
        return self._exposure

    def _cameras(self) -> tuple[list[SE3], list[float]]:
        """T_world_cam of the photos, and the turn of the surroundings in each."""
        o = self._o
        rng = np.random.default_rng([o.seed, 77])
        size = self._radius / (_COVERED * o.height / 2) * self.camera.fy
        distance = max(_NEAREST_M, size)
        poses, turns = [], []
        lower = (o.views + 1) // 2
        hand = 1.0 if o.motion == "walk" else 0.0
        for index in range(o.views):
            ring, count = (0, lower) if index < lower else (1, o.views - lower)
            azimuth = 2 * np.pi * ((index - ring * lower) + 0.5 * ring) / max(count, 1)
            elevation = np.deg2rad(o.elevations_deg[ring])
            sway, drift = rng.normal(size=3) * _SWAY_M, rng.normal(size=3) * _DRIFT_M
            target = np.array([0, 0, 0.45 * self._top]) + hand * drift
            away = np.array(
                [
                    np.cos(elevation) * np.cos(azimuth),
                    np.cos(elevation) * np.sin(azimuth),
                    np.sin(elevation),
                ]
            )
            pose = look_at(target + distance * away + hand * sway, target)
            roll = hand * float(rng.normal()) * _ROLL_RAD
            poses.append(pose @ SE3(so3_exp(np.array([0.0, 0.0, roll])), np.zeros(3)))
            turns.append(float(azimuth) if o.motion == "turntable" else 0.0)
        return poses, turns

    def _table(self) -> SceneObject:
        o = self._o
        rng = np.random.default_rng([o.seed, 5])
        wood = draw_material(rng, "diffuse", name="wood_oak")
        half = _TABLE_HALF_M
        if o.motion == "turntable":
            angle = np.linspace(0, 2 * np.pi, 97)[:-1]
            rim = _PLATTER_M * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
            vertices = np.vstack([np.zeros(3), rim])
            around = np.arange(1, 97)
            faces = np.stack([0 * around, around, np.roll(around, -1)], axis=1)
        else:
            vertices = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
            faces = np.array([[0, 1, 2], [0, 2, 3]])
        return SceneObject(
            0,
            SurfaceMesh(vertices, faces),
            SE3(np.eye(3), np.array([0, 0, -2 * turntable_objects.GAP_M])),
            wood,
        )

    def _write_truth(self) -> None:
        out = self._o.out
        text = json.dumps(self.sheet.document(), indent=1)
        write_bytes_atomic(out / "board.json", text.encode() + b"\n")
        bare = trimesh.Trimesh(self._mesh.vertices, self._mesh.faces, process=False)
        write_mesh(out / "truth/mesh.ply", bare)
        write_document(
            out / "truth/cameras.json",
            TurntableTruth(
                camera=CameraModel.of(self.camera),
                photos=[self.photo(i).name for i in range(self._o.views)],
                T_world_cam=[p.flat() for p in self.poses],
                T_world_obj=self.T_world_obj.flat(),
            ),
        )


def _defocus(radiance: Floats, depth: Floats, focus_m: float, opening_px: float) -> Floats:
    """Blur by the circle of confusion at every pixel's depth.

    Args:
        opening_px: diameter of the lens opening times the focal length in pixels, m px.
    """
    if opening_px <= 0:
        return radiance
    z = np.where(depth > 0, depth, 10.0)
    # A disc of diameter c has the standard deviation c / 4 along an axis.
    sigma = opening_px * np.abs(1 / z - 1 / focus_m) / 4
    sigma = np.asarray(cv2.GaussianBlur(sigma, (0, 0), 1.5), np.float64)
    copies = [radiance, *(np.asarray(cv2.GaussianBlur(radiance, (0, 0), s)) for s in _BLURS[1:])]
    level = np.interp(sigma, _BLURS, np.arange(len(_BLURS)))
    out = np.zeros(radiance.shape, np.float32)
    for k in range(len(_BLURS)):
        weight = np.clip(1 - np.abs(level - k), 0, 1)
        out += copies[k] * weight[..., None].astype(np.float32)
    return out


def _begin(options: TurntableOptions) -> None:
    """Refuse a folder that was begun with other options."""
    values = {k: v for k, v in asdict(options).items() if k != "out"}
    # Files by name and content, for folders move.
    wanted = msgspec.to_builtins(values, enc_hook=lambda file: f"{file.name} {digest_file(file)}")
    begin(
        options.out / _BEGUN,
        json.loads(json.dumps(wanted)),
        what="these photos were",
        hint="choose another folder, or remove this one",
    )
