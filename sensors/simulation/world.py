"""A drawn scene at rest, as the renderer and the writers take it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from sensors.assets import Asset
from sensors.lighting.environment import EnvironmentMap
from sensors.lighting.floor import FloorDraw
from sensors.materials.textures import to_linear
from sensors.output import SimulatedObject, SimulatedScene
from sensors.physics import PhysicalObject, convex_parts, settle
from sensors.render import SceneObject, SimScene, SurfaceMesh
from sensors.simulation.draw import ObjectDraw, SceneDraw, generator
from sensors.simulation.options import SimulationOptions
from sensors.simulation.surface import own_surface
from sensors.viewpoints import (
    TrajectoryOptions,
    ViewpointOptions,
    random_viewpoints,
    smooth_trajectory,
)
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.images import read_color

# Half the side of the floor: every ray of every viewpoint ends on it, none goes past into the sky.
FLOOR_HALF_M = 15.0


@dataclass(frozen=True, eq=False)
class World:
    """A scene at rest.

    Attributes:
        draw: what was drawn from the seed.
        record: objects with their poses, as the writers take them.
        scene: the same with floor and light, as the renderer takes it.
        T_world_cam: of the colour camera in every frame.
    """

    draw: SceneDraw
    record: SimulatedScene
    scene: SimScene
    T_world_cam: tuple[SE3, ...]


def build_world(
    name: str,
    draw: SceneDraw,
    assets: list[Asset],
    environment: EnvironmentMap,
    options: SimulationOptions,
    *,
    sensor: str,
    poses: Sequence[SE3] | None = None,
    parts_cache: Path | None = None,
    parameters: dict[str, Any] | None = None,
) -> World:
    """Let the objects of a draw fall, and put floor, light and cameras around them.

    Args:
        name: of the scene.
        draw: what is in it.
        assets: of its objects, in their order.
        environment: its light.
        options: of the data set.
        sensor: name of the sensor, for the record.
        poses: T_world_obj of objects that lie still already; None lets them fall.
        parts_cache: folder that keeps convex parts over runs.
        parameters: further entries of the scene's record.

    Raises:
        ToolkitError: the objects do not come to rest, or a floor image cannot be read.
    """
    drops = 0
    if poses is None:
        falling = [
            PhysicalObject(asset, thing.diagonal_m, convex_parts(asset, parts_cache))
            for asset, thing in zip(assets, draw.objects, strict=True)
        ]
        settled = settle(falling, int(generator(draw.seed, "drop").integers(2**31)))
        poses, drops = settled.poses, settled.attempts
    rows = list(zip(draw.objects, assets, poses, strict=True))
    record = SimulatedScene(
        name=name,
        seed=draw.seed,
        sensor=sensor,
        frames=options.views,
        objects=[
            SimulatedObject(
                instance_id=thing.instance,
                asset_id=asset.id,
                category=thing.category,
                class_id=asset.class_id,
                material_class=thing.material.material_class,
                scale_m=thing.diagonal_m,
                T_world_obj=pose,
                mesh=asset.mesh,
                symmetry=asset.symmetry,
            )
            for thing, asset, pose in rows
        ],
        parameters={
            "options": msgspec.to_builtins(options),
            "draw": msgspec.to_builtins(draw),
            "drops": drops,
            **(parameters or {}),
        },
    )
    scene = SimScene(
        (_floor(draw.floor), *(_object(*row) for row in rows)),
        environment,
        draw.light[0].rotation_rad,
    )
    return World(draw, record, scene, tuple(camera_poses(draw.seed, options)))


def camera_poses(seed: int, options: SimulationOptions) -> list[SE3]:
    """T_world_cam of every frame."""
    number = int(generator(seed, "views").integers(2**31))
    if options.order == "random":
        views = random_viewpoints(number, ViewpointOptions(count=options.views))
        return [view.T_world_cam for view in views]
    return smooth_trajectory(
        number,
        TrajectoryOptions(kind=options.order, frames=options.views, sweep_deg=options.sweep_deg),
    )


def _object(thing: ObjectDraw, asset: Asset, pose: SE3) -> SceneObject:
    mesh, texture = own_surface(asset, thing.diagonal_m)
    patterned = thing.material.texture is not None
    if texture is not None and asset.texture is None and patterned:
        # A palette has no room for the material's pattern: the mean colour stands for it.
        mean = to_linear(np.asarray(texture)).reshape(-1, 3).mean(axis=0)
        mesh, texture = SurfaceMesh(mesh.vertices, mesh.faces), None
        color = (float(mean[0]), float(mean[1]), float(mean[2]))
        return SceneObject(thing.instance, mesh, pose, thing.material, color=color)
    return SceneObject(thing.instance, mesh, pose, thing.material, texture=texture)


def _floor(drawn: FloorDraw) -> SceneObject:
    h = FLOOR_HALF_M
    corners = np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]])
    mesh = SurfaceMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    texture = None if drawn.image is None else read_color(drawn.image)
    return SceneObject(
        0,
        mesh,
        SE3.identity(),
        drawn.material,
        texture=texture,
        texture_tile_m=drawn.image_tile_m,
    )
