"""Shape priors from meshes: sampled surfaces, and their barycentre.

The barycentre in optimal transport needs no network. Each point of the mean is paired with one
point of each shape so that the sum of squared distances is smallest, and moves to the mean of its
partners, until the pairs no longer change. Thin parts at different places in different shapes
become blurred, as in the mean of embeddings.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from benchmark.methods.pose.priors.options import PriorOptions
from benchmark.methods.pose.priors.prior_file import Priors
from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger

_OTHER = "other"

Floats = NDArray[np.float32]

# A source has no list of its shapes: draw until this many draws bring no new one.
_FRUITLESS = 50


def make_priors(options: PriorOptions | None = None) -> Priors:
    """The mean shape of every category.

    Raises:
        ToolkitError: no such assets or categories.
    """
    options = options or PriorOptions()
    shapes = read_shapes(options)
    about = {
        "assets": options.assets,
        "split": options.split,
        "how": options.how,
        "seed": str(options.seed),
        "instances": ", ".join(f"{name} {len(found.ids)}" for name, found in shapes.items()),
    }
    points = {name: found.points for name, found in shapes.items()}
    if options.how == "barycentre":
        return Priors({name: barycentre(some) for name, some in points.items()}, about)
    from benchmark.methods.pose.priors.autoencoder import AutoencoderOptions, mean_shapes

    found = mean_shapes(
        points,
        AutoencoderOptions(
            points=options.points, epochs=options.epochs, seed=options.seed, device=options.device
        ),
        lambda epoch, loss: logger.info("epoch %d: chamfer distance %.6f", epoch + 1, loss),
    )
    return Priors(found, {**about, "epochs": str(options.epochs)})


def read_shapes(options: PriorOptions) -> dict[str, Shapes]:
    """Points on the shapes of every category that priors are made of.

    Raises:
        ToolkitError: no such assets or categories.
    """
    from sensors.assets import SourceOptions, open_source

    name = "procedural" if options.assets == "builtin" else options.assets
    source = open_source(
        name, SourceOptions(root=options.root, split=options.split, unit=options.unit)
    )
    categories: Sequence[str] = options.categories or [
        category for category in source.categories() if category != _OTHER
    ]
    shapes = {}
    for category in categories:
        shapes[category] = sample_shapes(
            source,
            category,
            instances=options.instances,
            points=options.points,
            seed=options.seed,
        )
        logger.info("%s: %d shapes", category, len(shapes[category].ids))
    return shapes


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
    from sensors.assets.asset_source import AssetSource

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


def barycentre(shapes: NDArray[np.floating], *, rounds: int = 4) -> Floats:
    """(p, 3) mean of shapes (n, p, 3).

    It begins with the shape that is nearest to all others by the distance of sorted coordinates
    along many directions, a cheap bound of the one that counts.

    Args:
        rounds: at most; it ends earlier where no pair changes.

    Raises:
        ToolkitError: no shape.
    """
    points = np.asarray(shapes, dtype=np.float64)
    if points.ndim != 3 or not len(points):
        raise ToolkitError("needs shapes (n, p, 3)", value=points.shape)
    mean = points[_most_central(points)]
    before: NDArray[np.intp] | None = None
    for _ in range(rounds):
        pairs = np.stack([linear_sum_assignment(cdist(mean, s, "sqeuclidean"))[1] for s in points])
        if before is not None and (pairs == before).all():
            break
        mean = np.take_along_axis(points, pairs[..., None], axis=1).mean(axis=0)
        before = pairs
    return mean.astype(np.float32)


def _most_central(points: NDArray[np.float64], directions: int = 32) -> int:
    rng = np.random.default_rng(0)
    unit = rng.normal(size=(3, directions))
    unit /= np.linalg.norm(unit, axis=0)
    sliced = np.sort(points @ unit, axis=1).reshape(len(points), -1)
    return int(cdist(sliced, sliced, "sqeuclidean").sum(axis=1).argmin())
