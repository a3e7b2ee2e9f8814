"""Objects on the table in one round: sampled from its seed, dropped until they are at rest."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sensors.assets import Asset, AssetSource, SourceOptions, draw_diagonal, open_source
from sensors.materials.material_draw import DrawnMaterial, draw_material, draw_material_class
from sensors.physics import PhysicalObject, SettleOptions, convex_parts, settle
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3

# As in the scenes of DREDS: a vessel of each category, possibly of glass, and others of metal.
VESSELS = ("bottle", "bowl", "mug")
OTHERS = ("can", "car", "aeroplane")
OBJECTS = (4, 5)
# The jaw opens by 80 mm. Vessels are grasped at the rim, aeroplanes at the fuselage or a wing, in
# any orientation: their smallest extent must fit. The others are grasped across that of their two
# smaller extents which is horizontal.
THICKEST_M, WIDEST_M = 0.058, 0.062
HELD_ACROSS = ("bottle", "can", "car")
# Side of the square onto which objects are dropped, and of the table.
DROP_HALF_M, TABLE_HALF_M = 0.19, 0.45
_ROOMY_HALF_M = 0.24
MASS_KG = (0.08, 0.25)


@dataclass(frozen=True, eq=False)
class TableObject:
    """One object of a round.

    Attributes:
        number: 0, 1, ... within the round.
        body: shape, size and collision parts.
        material: its surface.
        mass_kg: its mass.
    """

    number: int
    body: PhysicalObject
    material: DrawnMaterial
    mass_kg: float

    @property
    def label(self) -> str:
        """Material and category, for messages."""
        return f"{self.material.material_class} {self.body.asset.category}"


@dataclass(frozen=True, eq=False)
class Arrangement:
    """A round before the first attempt.

    Attributes:
        seed: seed of the round.
        objects: specular and transparent objects.
        poses: T_world_obj, z up, the table at z = 0.
    """

    seed: int
    objects: tuple[TableObject, ...]
    poses: tuple[SE3, ...]


def round_seed(seed: int, index: int) -> int:
    """Return the seed of round `index` of a run: the same for every depth and planner."""
    return int(np.random.default_rng([seed, index]).integers(2**31))


def arrange(
    seed: int, *, assets: AssetSource | None = None, parts_cache: Path | None = None
) -> Arrangement:
    """Sample the objects of a round and drop them on the table.

    Args:
        seed: seed of the round.
        assets: source of shapes; by default the test part of the built-in library. Of another
            source, categories are drawn at random, and objects of known size keep it.
        parts_cache: cache folder of convex parts.

    Raises:
        ToolkitError: the objects do not come to rest, or a simulation library is missing.
    """
    own = assets is not None
    assets = assets or open_source("procedural", SourceOptions(split="test"))
    shapes, looks = (np.random.default_rng([seed, k]) for k in range(2))
    count = int(shapes.integers(OBJECTS[0], OBJECTS[1] + 1))
    others = [OTHERS[int(k)] for k in shapes.permutation(len(OTHERS))]
    categories = [*VESSELS, *others]
    if own:
        there = assets.categories()
        categories = [there[int(k)] for k in shapes.integers(len(there), size=count)]
    objects = []
    for number, category in enumerate(categories[:count]):
        asset = assets.sample(shapes, category)
        diagonal = draw_diagonal(shapes, asset)
        if not own or asset.diagonal_m is None:
            diagonal = min(diagonal, largest_diagonal(asset))
        material_class = draw_material_class(looks, category, allowed=("specular", "transparent"))
        material = draw_material(looks, material_class, textured=asset.texture is not None)
        body = PhysicalObject(asset, diagonal, convex_parts(asset, parts_cache))
        objects.append(TableObject(number, body, material, float(shapes.uniform(*MASS_KG))))
    return Arrangement(seed, tuple(objects), _settled(objects, seed))


def largest_diagonal(asset: Asset) -> float:
    """Return the largest bounding-box diagonal, metres, at which the jaw can grasp this shape."""
    thinnest, middle, _ = np.sort(np.ptp(asset.vertices, axis=0))
    limit = THICKEST_M / thinnest
    return float(min(limit, WIDEST_M / middle) if asset.category in HELD_ACROSS else limit)


def _settled(objects: Sequence[TableObject], seed: int) -> tuple[SE3, ...]:
    """Poses of the objects at rest; retried on a larger area if they do not come to rest."""
    bodies = [o.body for o in objects]
    try:
        return settle(bodies, seed, SettleOptions(half_width_m=DROP_HALF_M)).poses
    except ToolkitError:
        roomy = SettleOptions(half_width_m=_ROOMY_HALF_M, attempts=20)
        return settle(bodies, seed, roomy).poses


def off_table(poses: Sequence[SE3]) -> list[int]:
    """Return the indices of the poses beyond the edge of the table."""
    return [k for k, T in enumerate(poses) if np.abs(T.t[:2]).max() > TABLE_HALF_M]
