"""Points on the surfaces of the shapes of a category."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError

Floats = NDArray[np.float32]

# A source tells no list of its shapes: it is drawn from until so many draws bring nothing new.
_FRUITLESS = 50


@dataclass(frozen=True, eq=False)
class Shapes:
    """Shapes of one category.

    Attributes:
        ids: (n,) names of the shapes, in the order of their names.
        points: (n, p, 3) evenly over each surface; the bounding box centred with a diagonal of 1,
            y up.
    """

    ids: tuple[str, ...]
    points: Floats


def sample_shapes(
    source: object, category: str, *, instances: int, points: int, seed: int = 0
) -> Shapes:
    """Draw distinct shapes of a category, and points on them.

    Args:
        source: a `sensors.assets.AssetSource`.
        category: such as "mug".
        instances: at most so many shapes; a source that has fewer gives all.
        points: on each.
        seed: of the draws. Points on a shape depend on the seed and its name alone.

    Raises:
        ToolkitError: the source has none of this category.
    """
    from sensors.assets.source import AssetSource

    assets: AssetSource = source  # type: ignore[assignment]
    if category not in assets.categories():
        raise ToolkitError(
            "the assets have no such category",
            value=category,
            hint=f"they have {', '.join(assets.categories())}",
        )
    rng = np.random.default_rng([seed, *category.encode()])
    found: dict[str, Floats] = {}
    fruitless = 0
    while len(found) < instances and fruitless < _FRUITLESS:
        asset = assets.sample(rng, category)
        if asset.id in found:
            fruitless += 1
            continue
        fruitless = 0
        found[asset.id] = surface_points(asset.vertices, asset.faces, points, (seed, asset.id))
    ids = sorted(found)
    return Shapes(tuple(ids), np.stack([found[i] for i in ids]))


def surface_points(
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    count: int,
    seed: Sequence[object],
) -> Floats:
    """(count, 3) points drawn evenly over a surface."""
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    edges = corners[:, 1:] - corners[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    if not area.sum() > 0:
        raise ToolkitError("the surface has no area", value=seed[-1])
    digest = hashlib.sha256(repr(tuple(seed)).encode()).digest()
    rng = np.random.default_rng(list(digest[:16]))
    face = rng.choice(len(faces), count, p=area / area.sum())
    # Evenly over a triangle: what falls beyond its diagonal is folded back.
    weights = rng.random((count, 2))
    over = weights.sum(axis=1) > 1
    weights[over] = 1 - weights[over]
    place = corners[face, 0] + (weights[..., None] * edges[face]).sum(axis=1)
    return place.astype(np.float32)
