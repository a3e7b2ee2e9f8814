"""A drawn scene at rest, in the form of the renderer and the writers.

An asset's own look becomes one texture and one pair of coordinates per vertex.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sensors.assets import Asset
from sensors.lighting.environment import EnvironmentMap
from sensors.lighting.light_draw import FloorDraw, SettingDraw
from sensors.materials.textures import to_linear
from sensors.output.simulated_frame import SimulatedObject, SimulatedScene
from sensors.physics import PhysicalObject, convex_parts, settle
from sensors.physics.settle import SettleOptions
from sensors.render.sim_scene import SceneObject, SimScene, SurfaceMesh
from sensors.simulation.options import SimulationOptions
from sensors.simulation.scene_draw import ObjectDraw, SceneDraw, generator
from sensors.viewpoints.camera_path import TrajectoryOptions, smooth_trajectory
from sensors.viewpoints.views import ViewpointOptions, random_viewpoints
from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.io.images import read_color

# Half the side of the floor: every downward ray of every viewpoint hits it.
FLOOR_HALF_M = 15.0

TABLE_THICK_M, WALL_HEIGHT_M = 0.03, 2.2

# Share of the views from the side, where there are table edges or walls.
LOW_SHARE = 0.35

# Texels per colour of a palette: several, so that filtering does not mix neighbours; and the most
# colours in a row.
_SWATCH, _PALETTE_WIDTH = 4, 1024


@dataclass(frozen=True, eq=False)
class Look:
    """Light and floor of a view.

    Attributes:
        environment: environment light.
        rotation_rad: of it about the world's z axis.
        floor: the object 0 of the scene.
    """

    environment: EnvironmentMap
    rotation_rad: float
    floor: SceneObject


@dataclass(frozen=True, eq=False)
class World:
    """A scene at rest.

    Attributes:
        draw: the random choices from the seed.
        record: objects with their poses, for the writers.
        scene: the same with the floor and the light of the first view, for the renderer.
        T_world_cam: of the colour camera in every frame.
        looks: floor and light of every view.
    """

    draw: SceneDraw
    record: SimulatedScene
    scene: SimScene
    T_world_cam: tuple[SE3, ...]
    looks: tuple[Look, ...]


def build_world(
    name: str,
    draw: SceneDraw,
    assets: list[Asset],
    maps: Sequence[EnvironmentMap],
    options: SimulationOptions,
    *,
    sensor: str,
    poses: Sequence[SE3] | None = None,
    parts_cache: Path | None = None,
    parameters: dict[str, Any] | None = None,
    baseline_m: float | None = None,
) -> World:
    """Drop the objects of a draw, and add floor, light and cameras.

    Args:
        name: of the scene.
        draw: contents of the scene.
        assets: of its objects, in their order.
        maps: environment map of each view.
        options: of the data set.
        sensor: name of the sensor, for the record.
        poses: T_world_obj of objects already at rest; None drops them.
        parts_cache: folder that caches convex parts across runs.
        parameters: further entries of the scene's record.
        baseline_m: of the sensor's infrared cameras, for the record.

    Raises:
        ToolkitError: the objects do not come to rest, or a floor image cannot be read.
    """
    drops = 0
    if poses is None:
        falling = [
            PhysicalObject(
                asset,
                obj.diagonal_m,
                convex_parts(asset, parts_cache, coarse=options.collision == "coarse"),
            )
            for asset, obj in zip(assets, draw.objects, strict=True)
        ]
        start = int(generator(draw.seed, "drop", options).integers(2**31))
        settled = settle(
            falling, start, SettleOptions(spread_m=draw.spread_m, upright=draw.upright)
        )
        poses, drops = settled.poses, settled.attempts
    rows = list(zip(draw.objects, assets, poses, strict=True))
    record = SimulatedScene(
        name=name,
        seed=draw.seed,
        sensor=sensor,
        baseline_m=baseline_m,
        frames=options.views,
        objects=[
            SimulatedObject(
                instance_id=obj.instance,
                asset_id=asset.id,
                category=obj.category,
                class_id=asset.class_id,
                material_class=obj.material.material_class,
                scale_m=obj.diagonal_m,
                T_world_obj=pose,
                mesh=asset.mesh,
                symmetry=asset.symmetry,
            )
            for obj, asset, pose in rows
        ],
        parameters={
            "options": msgspec.to_builtins(options),
            "draw": msgspec.to_builtins(draw),
            "drops": drops,
            **(parameters or {}),
        },
    )
    liquids = [_liquid(*row) for row in rows]
    _, around = _surroundings(draw)
    looks = looks_of(draw, maps)
    scene = SimScene(
        (looks[0].floor, *around, *(_object(*row) for row in rows)),
        looks[0].environment,
        looks[0].rotation_rad,
        tuple(liquid for liquid in liquids if liquid is not None),
    )
    poses_of_views = tuple(camera_poses(draw.seed, options, draw.setting))
    return World(draw, record, scene, poses_of_views, looks)


def looks_of(draw: SceneDraw, maps: Sequence[EnvironmentMap]) -> tuple[Look, ...]:
    """Light and floor of every view.

    Args:
        draw: contents of the scene.
        maps: environment map of each view.

    Raises:
        ToolkitError: a floor image cannot be read.
    """
    ground, _ = _surroundings(draw)
    floors = {id(floor): _floor(floor, ground) for floor in draw.floors}
    return tuple(
        Look(m, light.rotation_rad, floors[id(floor)])
        for m, light, floor in zip(maps, draw.light, draw.floors, strict=True)
    )


def camera_poses(
    seed: int, options: SimulationOptions, setting: SettingDraw | None = None
) -> list[SE3]:
    """T_world_cam of every frame; from the side too where there is something to see."""
    number = int(generator(seed, "views", options).integers(2**31))
    if options.order == "random":
        low = LOW_SHARE if setting is not None and setting.kind != "plane" else 0.0
        views = random_viewpoints(number, ViewpointOptions(count=options.views, low_share=low))
        return [view.T_world_cam for view in views]
    return smooth_trajectory(
        number,
        TrajectoryOptions(kind=options.order, frames=options.views, sweep_deg=options.sweep_deg),
    )


def _object(obj: ObjectDraw, asset: Asset, pose: SE3) -> SceneObject:
    mesh, texture = own_surface(asset, obj.diagonal_m)
    patterned = obj.material.texture is not None
    if texture is not None and asset.texture is None and patterned:
        # A palette cannot hold the material's pattern: its mean colour is used.
        mean = to_linear(np.asarray(texture)).reshape(-1, 3).mean(axis=0)
        mesh, texture = SurfaceMesh(mesh.vertices, mesh.faces), None
        color = (float(mean[0]), float(mean[1]), float(mean[2]))
        return SceneObject(obj.instance, mesh, pose, obj.material, color=color)
    whole = SceneObject(obj.instance, mesh, pose, obj.material, texture=texture)
    if not obj.parts or asset.face_parts is None:
        return whole
    numbers = np.zeros(len(mesh.faces), np.int64)
    for number, name in enumerate(obj.parts, start=1):
        numbers[asset.face_parts == name] = number
    return replace(whole, face_parts=numbers, part_materials=tuple(obj.parts.values()))


def _liquid(obj: ObjectDraw, asset: Asset, pose: SE3) -> SceneObject | None:
    """The liquid in an object at rest, with a level surface; None if it is empty."""
    if obj.liquid is None or asset.cavity is None:
        return None
    from manifold3d import Manifold, Mesh64

    inside = pose @ (np.asarray(asset.cavity.vertices) * obj.diagonal_m)
    low, high = inside[:, 2].min(), inside[:, 2].max()
    faces = np.asarray(asset.cavity.faces, np.uint64)
    level = float(low + obj.fill * (high - low))
    part = Manifold(Mesh64(np.ascontiguousarray(inside), faces)).trim_by_plane([0, 0, -1], -level)
    mesh = part.to_mesh64()
    if len(mesh.tri_verts) == 0:
        return None
    surface = SurfaceMesh(
        np.asarray(mesh.vert_properties[:, :3]), np.asarray(mesh.tri_verts, np.int64)
    )
    return SceneObject(obj.instance, surface, SE3.identity(), obj.liquid)


def _surroundings(draw: SceneDraw) -> tuple[SurfaceMesh, list[SceneObject]]:
    """The mesh of the floor or table top, and further surfaces."""
    setting, h = draw.setting, FLOOR_HALF_M
    ground = _rectangle([-h, -h, 0], [2 * h, 0, 0], [0, 2 * h, 0])
    if setting.kind == "plane":
        return ground, []
    turn = so3_exp([0, 0, setting.turn_rad])
    found: list[SceneObject] = []
    if setting.kind == "table":
        a, b = setting.half_m
        corners = np.array([[x, y] for y in (-b, b) for x in (-a, a)])
        top = np.concatenate(
            [np.column_stack([corners, np.full(4, z)]) for z in (0.0, -TABLE_THICK_M)]
        )
        sides = [[0, 4, 5, 1], [1, 5, 7, 3], [3, 7, 6, 2], [2, 6, 4, 0], [0, 1, 3, 2], [4, 6, 7, 5]]
        faces = [f for s in sides for f in ([s[0], s[1], s[2]], [s[0], s[2], s[3]])]
        ground = SurfaceMesh(top @ turn.T, np.array(faces))
    low = -setting.height_m
    if setting.ground is not None:
        below = _rectangle([-h, -h, low], [2 * h, 0, 0], [0, 2 * h, 0])
        found.append(_floor(setting.ground, below))
    assert setting.wall is not None
    for i, away in enumerate(setting.walls_m):
        side = turn @ so3_exp([0, 0, i * np.pi / 2])
        wall = _rectangle(
            side @ [away, -h, low], side @ [0.0, 2 * h, 0.0], [0.0, 0.0, WALL_HEIGHT_M]
        )
        found.append(_floor(setting.wall, wall))
    return ground, found


def _rectangle(corner: ArrayLike, across: ArrayLike, up: ArrayLike) -> SurfaceMesh:
    a, u, v = (np.asarray(x, np.float64) for x in (corner, across, up))
    return SurfaceMesh(np.array([a, a + u, a + u + v, a + v]), np.array([[0, 1, 2], [0, 2, 3]]))


def _floor(drawn: FloorDraw, mesh: SurfaceMesh) -> SceneObject:
    texture = None if drawn.image is None else read_color(drawn.image)
    return SceneObject(
        0,
        mesh,
        SE3.identity(),
        drawn.material,
        texture=texture,
        texture_tile_m=drawn.image_tile_m,
    )


def own_surface(asset: Asset, diagonal_m: float) -> tuple[SurfaceMesh, NDArray[np.uint8] | None]:
    """The asset at its size, and the texture image with its own colours.

    A texture is used unchanged; face colours become a palette, with each face's corners at the
    centre of its swatch. Vertices are duplicated where corners differ.

    Args:
        asset: in its canonical frame.
        diagonal_m: bounding-box diagonal of the object, metres.

    Returns:
        The mesh in metres, and (h, w, 3) uint8 sRGB or None where the asset has no colours.
    """
    vertices = asset.vertices * diagonal_m
    if asset.texture is not None and asset.corner_uv is not None:
        return _with_corners(vertices, asset.faces, asset.corner_uv), asset.texture
    if asset.face_colors is None:
        return SurfaceMesh(vertices, asset.faces), None
    return palette_surface(vertices, asset.faces, asset.face_colors)


def palette_surface(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], colors: NDArray[np.uint8]
) -> tuple[SurfaceMesh, NDArray[np.uint8]]:
    """A mesh whose faces have a colour each, and the texture image of the palette.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) vertex indices.
        colors: (F, 3) uint8 sRGB.
    """
    palette, of_face = np.unique(colors, axis=0, return_inverse=True)
    row, column = np.divmod(of_face.reshape(-1), _PALETTE_WIDTH)
    width = min(len(palette), _PALETTE_WIDTH)
    height = -(-len(palette) // width)
    # The last row is filled up from the first.
    swatches = np.resize(palette, (height, width, 3))
    image = np.repeat(np.repeat(swatches, _SWATCH, axis=0), _SWATCH, axis=1)
    corners = np.stack([(column + 0.5) / width, 1 - (row + 0.5) / height], axis=1)
    uv = np.repeat(corners[:, None], 3, axis=1)
    return _with_corners(vertices, faces, uv), np.ascontiguousarray(image)


def _with_corners(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], uv: NDArray[np.floating]
) -> SurfaceMesh:
    """A mesh with one pair of coordinates per vertex; vertices are duplicated as needed."""
    keys = np.concatenate([faces.reshape(-1, 1), uv.reshape(-1, 2)], axis=1)
    used, index = np.unique(keys, axis=0, return_inverse=True)
    return SurfaceMesh(
        vertices[used[:, 0].astype(np.int64)],
        index.reshape(-1, 3),
        np.ascontiguousarray(used[:, 1:]),
    )
