"""Surface of the object from masked photos: hull, depth maps, fusion, outlines.

One or two sides: the object as it stood first, and turned over. Each side has depth maps of its
own photos. The surface is fused from both in the world of the first.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array, Floats
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.io.documents import digest_of
from std_toolkit.jobs.artefact import Artefact
from std_toolkit.scanning.masks.hull import hull_field, hull_fields, largest_component, surface_of
from std_toolkit.scanning.masks.masks import covered, volume_of_masks
from std_toolkit.scanning.options import LIMITS, ScanOptions
from std_toolkit.scanning.photos.posed_photos import PosedPhotos
from std_toolkit.scanning.photos.views import Grid, View, in_threads
from std_toolkit.scanning.surface.depth_maps import DepthEngine, DepthMap
from std_toolkit.scanning.surface.hollow import hollowed
from std_toolkit.scanning.surface.mesh_fit import fit_mesh
from std_toolkit.scanning.surface.plain_tops import levelled
from std_toolkit.scanning.surface.sensor_depth import ScanDepthSettings, depth_factor, sensor_maps
from std_toolkit.scanning.surface.skirt import without_skirt
from std_toolkit.scanning.surface.surface import Fusion, agreeing, closed_mesh, fuse
from std_toolkit.scanning.surface.underside import flatten_unseen
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Depth below the hull that is searched, as a share of the longest side.
_DEEPEST = 0.3
# Voxels of the surface of one side to which the other is registered, as a share of all.
_COARSE = 0.6


@dataclass(frozen=True, kw_only=True)
class DisputeSettings(Settings):
    """Photos whose masks may lack a place."""

    photos_per_gap: int = limit(20, source="3 of 66 masks of the real bottle have one notch")
    """number of photos for each mask that may lack any place"""
    disputed: int = limit(6, source=NOT_RECORDED)
    """number of photos beyond `few` for each mask that may lack a place that depth maps show"""
    hidden: float = limit(0.1, source=NOT_RECORDED)
    """share of the object that may be hidden in a photo that counts among them"""
    few: int = limit(24, source="of few photos, each carves what no other does")
    """photos from which masks may be disputed"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Side:
    """Photos of the object in one position.

    Attributes:
        views: photos with masks, in the world of this position.
        maps: their depth maps.
        sensor: depth maps of a depth sensor, if there is one.
        grid: voxels around the object.
        hull: signed distance to the visual hull on them.
        disputed: the same of a larger hull, which more masks may contradict.
        on_table: whether the table at z = 0 of this world bounds the object.
        digest: of the photos and all that the depth maps depend on.
    """

    views: list[View]
    maps: list[DepthMap | None]
    grid: Grid
    hull: Floats
    disputed: Floats
    on_table: bool
    digest: str
    sensor: list[DepthMap | None] = field(default_factory=list)

    @property
    def layers(self) -> list[list[DepthMap | None]]:
        """Depth maps by matching, and of the sensor."""
        return [self.maps, self.sensor or [None] * len(self.views)]


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """A closed surface.

    Attributes:
        vertices: (V, 3) metres, world.
        faces: (F, 3).
        support: (F,) weight of the depth measurements of each face.
    """

    vertices: Array
    faces: NDArray[np.int64]
    support: Floats


def measure_side(
    options: ScanOptions,
    posed: PosedPhotos,
    views: Sequence[View],
    engine: DepthEngine,
    work: Path,
    threads: int,
    lap: Callable[[str], None],
) -> Side:
    """Depth maps of the photos of one position."""
    grid, longest = _grid(views, options.voxels, posed.on_table)
    floors = [SE3.identity()] if posed.on_table else []
    hull, disputed = _hulls(views, grid, floors, threads)
    lap("hull")
    values = {name: getattr(options, name) for name in ("voxels", "neighbours", "depth")}
    inputs = {"poses": posed.digest, "masks": _mask_digest(views)}
    artefact = Artefact(work, "depth", inputs, values | {"format": 4}, limits=LIMITS)
    among = disputed is hull or any(v.hidden is not None for v in views)
    # Among other things, what masks lack may be theirs.
    looked = views if among else _with_disputed(views, disputed, grid, threads)
    start = hull if among else disputed
    maps = _depth(engine, looked, start, grid, longest, options.neighbours, artefact, threads)
    sensor = _sensor(posed, views, hull, grid, threads)
    lap("depth maps")
    return Side(
        # The images of depth are large, and no longer needed.
        views=[replace(v, sensor=None) for v in views],
        maps=maps, grid=grid, hull=hull, disputed=disputed, on_table=posed.on_table,
        digest=artefact.digest, sensor=sensor,
    )  # fmt: skip


def _sensor(
    posed: PosedPhotos, views: Sequence[View], hull: Floats, grid: Grid, threads: int
) -> list[DepthMap | None]:
    """Depth maps of the sensor, brought to the board's scale; says so in the facts."""
    if all(v.sensor is None for v in views):
        return []
    factor = depth_factor(views, posed.corners) if posed.on_table else 1.0
    if factor is None:
        posed.warnings.append("the sensor's depth shows too little of the board to be compared")
        factor = 1.0
    elif posed.on_table:
        posed.facts["sensor depth"] = f"times {factor:.4f}, by the board"
    if abs(factor - 1) > ScanDepthSettings.current().largest_deviation:
        posed.warnings.append(
            f"the sensor's depth is left out: the board is at {factor:.2f} times what it measured. "
            "Is its unit right, and is it aligned to the colour images?"
        )
        return []
    maps = sensor_maps(views, hull, grid, factor=factor, on_table=posed.on_table, threads=threads)
    share = sum(int((m.depth > 0).sum()) for m in maps if m is not None) / max(
        1, sum(int(v.shown.sum()) for v in views if v.sensor is not None)
    )
    posed.facts["sensor depth on the object"] = f"{100 * share:.0f} % of its pixels"
    return maps


def side_surface(side: Side, voxels: int, threads: int) -> Surface:
    """Coarse surface of one side in its own world, to register the other to."""
    grid, _ = _grid(side.views, max(40, round(_COARSE * voxels)), side.on_table)
    hulls = _hulls(side.views, grid, [SE3.identity()] if side.on_table else [], threads)
    fused, _ = _fused(side.views, side.layers, hulls, grid, threads)
    vertices, faces = closed_mesh(fused.field, grid, 8000)
    support = _at(fused.support, grid, vertices[faces].mean(axis=1))
    return Surface(vertices=vertices, faces=faces, support=support)


def fused_surface(
    options: ScanOptions, sides: Sequence[tuple[Side, SE3]], facts: dict[str, Any], threads: int
) -> Surface:
    """Surface of all photos.

    Args:
        options: of the scan.
        sides: each with the motion from its world into that of the first.
        facts: receives the shares of the volume that is opened, of the base that is cut, and of
            the surface that is closed by a plane.
        threads: number of threads.
    """
    views = [replace(v, T_world_cam=T @ v.T_world_cam) for side, T in sides for v in side.views]
    layers = [
        [m for maps in of_sides for m in maps]
        for of_sides in zip(*(side.layers for side, _ in sides), strict=True)
    ]
    on_table = sides[0][0].on_table
    floors = [T for side, T in sides if side.on_table]
    if len(sides) == 1:
        grid, hulls = sides[0][0].grid, (sides[0][0].hull, sides[0][0].disputed)
    else:
        grid, _ = _grid(views, options.voxels, on_table)
        hulls = _hulls(views, grid, floors, threads)
    fused, weights = _fused(views, layers, hulls, grid, threads)
    field = fused.field
    if on_table:
        field = levelled(field, fused.support, grid, views, threads=threads)
        field, cut = without_skirt(field, fused.support, grid)
        if round(100 * cut):
            facts["cut at the foot"] = f"{100 * cut:.0f} % of the base, a film on the table"
    if options.wall_m is not None:
        # The first folder shows the vessel upright.
        field, opened = hollowed(field, hulls[0], grid, sides[0][0].views, options.wall_m)
        told = f"{100 * opened:.0f} % of the volume, a guess from the wall"
        facts["hollow"] = told if opened else "none: the top is not open to the photos"
    vertices, faces = closed_mesh(field, grid, options.faces)
    vertices = fit_mesh(
        vertices, faces, views, layers, weights, step=grid.step, floors=floors, threads=threads
    )
    if not on_table:
        vertices, flattened = flatten_unseen(vertices, faces, views)
        if flattened:
            facts["closed by a plane"] = f"{100 * flattened:.0f} % of the surface, unseen"
    support = _at(fused.support, grid, vertices[faces].mean(axis=1))
    return Surface(vertices=vertices, faces=faces, support=support)


def _fused(
    views: Sequence[View],
    layers: Sequence[Sequence[DepthMap | None]],
    hulls: tuple[Floats, Floats],
    grid: Grid,
    threads: int,
) -> tuple[Fusion, list[Floats]]:
    """The fused field, and the weights of `agreeing`."""
    middle = np.asarray(grid.origin) + np.array(grid.shape[::-1]) * grid.step / 2
    weights = agreeing(views, layers, middle, threads=threads)
    maps = [m for of_layer in layers for m in of_layer]
    return fuse([*views] * len(layers), maps, weights, *hulls, grid, threads=threads), weights


def _grid(views: Sequence[View], voxels: int, on_table: bool) -> tuple[Grid, float]:
    """Grid around the object, and its longest side in metres."""
    low, high = volume_of_masks(views)
    if on_table:
        low[2] = 0.0
    longest = float((high - low).max())
    return Grid.around(low, high, longest / voxels), longest


def _mask_digest(views: Sequence[View]) -> str:
    return digest_of([np.packbits(v.possible).tobytes().hex()[::7] for v in views],
                     [int(v.shown.sum()) for v in views])  # fmt: skip


def _hulls(
    views: Sequence[View], grid: Grid, floors: Sequence[SE3], threads: int
) -> tuple[Floats, Floats]:
    """The hull, and a larger one that more masks may contradict.

    Masks lack texture of the colour of the table behind it. The depth maps decide in between.
    """
    limits = DisputeSettings.current()
    few = len(views) // limits.photos_per_gap
    # Among other things, fewer photos show a side.
    whole = sum(_whole(v) for v in views)
    many = max(few, (whole - limits.few) // limits.disputed)
    if many == few:
        hull = _cut(hull_field(views, grid, allowed=few, threads=threads), grid, floors)
        return hull, hull
    fields = hull_fields(views, grid, allowed=(few, many), threads=threads)
    hull, larger = (_cut(field, grid, floors) for field in fields)
    return hull, np.minimum(hull, larger)


def _whole(view: View) -> bool:
    """Whether hardly anything hides the object in a photo."""
    if view.hidden is None:
        return True
    hidden = (view.hidden & ~view.shown).sum()
    return bool(hidden <= DisputeSettings.current().hidden * view.shown.sum())


def _cut(field: Floats, grid: Grid, floors: Sequence[SE3]) -> Floats:
    """The largest part of a hull above all tables, each the plane z = 0 of a moved world.

    Raises:
        ToolkitError: nothing is left.
    """
    axes = [
        o + np.arange(n) * grid.step for o, n in zip(grid.origin, grid.shape[::-1], strict=True)
    ]
    for T in floors:
        up = T.R[:, 2]
        x, y, z = (a * n for a, n in zip(axes, up, strict=True))
        height = z[:, None, None] + y[None, :, None] + x[None, None, :] - T.t @ up
        field = np.maximum(field, -height).astype(np.float32)
    inside = largest_component(field < 0)
    if not inside.any():
        raise ToolkitError(
            "the masks of the photos contradict each other: they leave no volume",
            hint="look at the masks in the report and correct them with --masks; did the object "
            "move between photos?",
        )
    return np.where(inside | (field >= 0), field, np.float32(grid.step))


def _depth(
    engine: DepthEngine,
    views: Sequence[View],
    hull: Floats,
    grid: Grid,
    longest: float,
    neighbours: int,
    artefact: Artefact,
    threads: int,
) -> list[DepthMap | None]:
    surface = surface_of(hull, grid)

    def make() -> dict[str, Any]:
        maps = engine(
            views, surface, deepest=_DEEPEST * longest, neighbours=neighbours, threads=threads
        )
        out: dict[str, Any] = {}
        for i, m in enumerate(maps):
            if m is not None:
                out[f"at{i}"] = np.array([m.x, m.y])
                for name in ("depth", "normal", "cost", "contrast"):
                    out[f"{name}{i}"] = getattr(m, name)
        return out

    a = artefact.arrays(make)
    return [
        DepthMap(
            int(a[f"at{i}"][0]), int(a[f"at{i}"][1]), a[f"depth{i}"], a[f"normal{i}"],
            a[f"cost{i}"], a[f"contrast{i}"],
        )
        if f"at{i}" in a else None
        for i in range(len(views))
    ]  # fmt: skip


def _with_disputed(views: Sequence[View], hull: Floats, grid: Grid, threads: int) -> list[View]:
    """Photos, in which nothing hides the object, whose masks have all of a hull."""
    caster = RayCaster(*surface_of(hull, grid), threads=1)
    return in_threads(
        lambda view: view.with_mask(view.shown | covered(view, caster)), views, threads=threads
    )


def _at(values: Floats, grid: Grid, points: Array) -> Floats:
    """Largest value of the voxels around points (N, 3)."""
    from scipy.ndimage import maximum_filter

    return grid.at(maximum_filter(values, 3), points)
