"""Objects on a table at known poses, as a depth camera sees them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmark.training.options import TableOptions
from std_toolkit.geometry import SE3, Camera

Array = NDArray[np.float64]
DepthKind = Literal["exact", "sensor"]
Surface = Literal["diffuse", "transparent", "specular"]
SURFACES: tuple[Surface, ...] = ("diffuse", "transparent", "specular")
_SURFACE_SHARES = (0.5, 0.25, 0.25)
# Streams of random numbers of a scene: one more draw in one changes no other.
_OBJECTS, _DROP, _VIEWS, _NOISE = range(4)


@dataclass(frozen=True, eq=False)
class TableObject:
    """An object of a scene.

    Attributes:
        name: of its shape and size: equal names, equal meshes.
        vertices: (V, 3) metres, object frame.
        faces: (F, 3).
        T_world_obj: where it lies; the table is z = 0, z up.
        surface: what a depth camera makes of it.
    """

    name: str
    vertices: Array
    faces: NDArray[np.int64]
    T_world_obj: SE3
    surface: Surface = "diffuse"


def draw_table(
    seed: int, options: TableOptions, *, parts_cache: Path | None = None
) -> list[TableObject]:
    """Drop objects on a table; the same seed gives the same scene.

    Args:
        seed: of the scene.
        options: what is drawn.
        parts_cache: folder that keeps convex parts over runs.

    Raises:
        ToolkitError: no such assets, or the objects do not come to rest.
    """
    from sensors.assets import SourceOptions, draw_diagonal, open_source
    from sensors.physics import PhysicalObject, SettleOptions, convex_parts, settle

    source = open_source(
        options.assets, SourceOptions(root=options.assets_root, split=options.split)
    )
    rng = np.random.default_rng([seed, _OBJECTS])
    categories = source.categories()
    count = int(rng.integers(options.objects[0], options.objects[1] + 1))
    falling, surfaces = [], []
    for _ in range(count):
        asset = source.sample(rng, categories[int(rng.integers(len(categories)))])
        diagonal = draw_diagonal(rng, asset)
        if asset.diagonal_m is None:
            diagonal *= rng.uniform(*options.sizes)
        # Whole millimetres: labels of shapes that come again can be kept.
        diagonal = max(0.02, round(diagonal, 3))
        surfaces.append(SURFACES[int(rng.choice(len(SURFACES), p=_SURFACE_SHARES))])
        falling.append(PhysicalObject(asset, diagonal, convex_parts(asset, parts_cache)))
    drop = int(np.random.default_rng([seed, _DROP]).integers(2**31))
    settled = settle(falling, drop, SettleOptions(half_width_m=options.half_width_m))
    found = []
    for obj, surface, pose in zip(falling, surfaces, settled.poses, strict=True):
        mesh = obj.asset.scaled(obj.diagonal_m)
        name = f"{obj.asset.id}-{round(1000 * obj.diagonal_m):03d}mm"
        faces = np.asarray(mesh.faces, np.int64)
        found.append(TableObject(name, np.asarray(mesh.vertices), faces, pose, surface))
    return found


def draw_cameras(seed: int, count: int) -> list[SE3]:
    """T_world_cam of the views of a scene, all around the table."""
    from sensors.viewpoints.views import ViewpointOptions, random_viewpoints

    number = int(np.random.default_rng([seed, _VIEWS]).integers(2**31))
    return [v.T_world_cam for v in random_viewpoints(number, ViewpointOptions(count=count))]


@dataclass(frozen=True, eq=False)
class Look:
    """What a camera sees of a table.

    Attributes:
        depth: (h, w) float32 metres, 0 where nothing was measured.
        index: (h, w) int16 number of the object that is truly seen, -1 table.
    """

    depth: NDArray[np.float32]
    index: NDArray[np.int16]


def look_at_table(
    objects: Sequence[TableObject],
    camera: Camera,
    T_world_cam: SE3,
    kind: DepthKind,
    seed: tuple[int, int] = (0, 0),
) -> Look:
    """Depth of objects and table.

    Args:
        objects: of the scene.
        camera, T_world_cam: who looks.
        kind: `exact`, or `sensor` as an active stereo camera errs: noise, holes, glass that is
            looked through and metal that is misread.
        seed: of scene and view, for the noise.
    """
    exact, index = _rendered(objects, camera, T_world_cam)
    if kind == "exact":
        return Look(exact, index)
    from sensors.synthetic.camera_frames import sensor_depth

    opaque = [o for o in objects if o.surface != "transparent"]
    behind = _rendered(opaque, camera, T_world_cam)[0] if len(opaque) < len(objects) else exact
    material = np.zeros(index.shape, np.uint8)
    for number, obj in enumerate(objects):
        material[index == number] = 1 + SURFACES.index(obj.surface)
    rng = np.random.default_rng([*seed, _NOISE])
    return Look(sensor_depth(exact, behind, material, fx=camera.fx, bias=1.0, rng=rng), index)


def _rendered(
    objects: Sequence[TableObject], camera: Camera, T_world_cam: SE3
) -> tuple[NDArray[np.float32], NDArray[np.int16]]:
    from std_toolkit.rendering.maps import compose
    from std_toolkit.rendering.mesh import RenderMesh
    from std_toolkit.rendering.raycast import RaycastRenderer
    from std_toolkit.rendering.renderer import PlacedMesh

    T_cam_world = T_world_cam.inverse()
    table = table_depth(camera, T_world_cam)
    if not objects:
        return table, np.full(table.shape, -1, np.int16)
    placed = [
        PlacedMesh(
            number + 1, RenderMesh.from_arrays(o.vertices, o.faces), T_cam_world @ o.T_world_obj
        )
        for number, o in enumerate(objects)
    ]
    composition = compose(RaycastRenderer(), camera, placed)
    depth, index = composition.depth, composition.index
    hidden = (depth <= 0) | ((table > 0) & (table < depth))
    return np.where(hidden, table, depth), np.where(hidden, -1, index).astype(np.int16)


def table_depth(camera: Camera, T_world_cam: SE3) -> NDArray[np.float32]:
    """(h, w) z-depth of the plane z = 0 of the world, 0 where a ray does not meet it."""
    rays = camera.rays()
    downwards = -(rays @ T_world_cam.R[2])
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = T_world_cam.t[2] / downwards
    return np.where((downwards > 0) & np.isfinite(depth), depth, 0).astype(np.float32)
