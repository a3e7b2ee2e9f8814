"""The built-in library: objects of the seven categories and distractors, made from a number."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sensors.assets.asset import TURN_Y, Asset, canonical_frame, welded
from sensors.assets.procedural.painted import Paint
from sensors.assets.source import SourceOptions
from sensors.assets.uv import box_uv, wrapped_uv
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.symmetry import Symmetry

if TYPE_CHECKING:
    from manifold3d import Manifold

# Changed whenever a seed gives another shape than it did: part of every id.
EDITION = 1
OTHER = "other"
CATEGORIES = ("aeroplane", "bottle", "bowl", "camera", "can", "car", "mug", OTHER)
# Bodies that turning about y leaves as they are, colours included.
_TURNED = ("bottle", "bowl", "can")
_SEEDS = 1_000_000
# `sample` draws from so many shapes of a category, as a data set has so many models: what is made
# of a shape once, such as its convex parts, is then made once for many scenes.
INSTANCES = 500
_ID = re.compile(r"([a-z]+)-p(\d+)-(\d{6})")


class ProceduralSource:
    """Parametric objects. A category and a seed below a million are an object, bit for bit.

    Sampling draws from the first 500 seeds: the even ones are the training split, the odd ones
    the test split.

    Args:
        options: `split` is heeded; there are no files.
    """

    def __init__(self, options: SourceOptions) -> None:
        self._split = options.split

    def categories(self) -> Sequence[str]:
        return CATEGORIES

    def sample(self, rng: np.random.Generator, category: str) -> Asset:
        seed = int(rng.integers(INSTANCES))
        if self._split != "all":
            seed = seed - seed % 2 + (self._split == "test")
        return make(category, seed)

    def load(self, asset_id: str) -> Asset:
        found = _ID.fullmatch(asset_id)
        if found is None or found[1] not in CATEGORIES:
            raise ToolkitError("not the id of a procedural asset", field="id", value=asset_id)
        if int(found[2]) != EDITION:
            raise ToolkitError(
                f"this asset belongs to edition {int(found[2])} of the procedural library; "
                f"this is edition {EDITION}",
                field="id",
                value=asset_id,
            )
        return make(found[1], int(found[3]))


def make(category: str, seed: int) -> Asset:
    """The object of a category and a seed.

    Args:
        category: one of `CATEGORIES`.
        seed: 0 to 999999.

    Raises:
        ToolkitError: another category or seed, or manifold3d is not installed.
    """
    if category not in CATEGORIES:
        raise ToolkitError(
            "the procedural library has no such category",
            field="category",
            value=category,
            hint=f"one of {', '.join(CATEGORIES)}",
        )
    if not 0 <= seed < _SEEDS:
        raise ToolkitError("must be 0 to 999999", field="seed", value=seed)
    import trimesh

    # The category is part of the seed: a car and a mug of one seed share no random numbers.
    rng = np.random.default_rng([EDITION, CATEGORIES.index(category), seed])
    paint = Paint()
    body, is_turned = _body(category, rng, paint)
    vertices, faces, colors = paint.mesh(body)
    vertices, _ = canonical_frame(vertices, faces)
    places, corners, kept = welded(vertices, faces)
    # Rounding brings corners of slivers together, which then go. Where two parts touch in an edge
    # they stay apart: welded, four faces would meet there.
    if trimesh.Trimesh(places, corners, process=False).is_watertight:
        vertices, faces, colors = places, corners, colors[kept]
    wrap = wrapped_uv if category in (*_TURNED, "mug") else box_uv
    return Asset(
        id=f"{category}-p{EDITION}-{seed:06d}",
        category=category,
        mesh=trimesh.Trimesh(vertices, faces, process=False),
        symmetry=TURN_Y if is_turned else Symmetry(),
        face_colors=colors,
        corner_uv=wrap(vertices, faces),
    )


def _body(category: str, rng: np.random.Generator, paint: Paint) -> tuple[Manifold, bool]:
    try:
        import manifold3d  # noqa: F401
    except ImportError as error:
        raise ToolkitError(
            "manifold3d is not installed", hint="pip install 'std-toolkit[sim]'"
        ) from error
    from sensors.assets.procedural.aeroplane import aeroplane
    from sensors.assets.procedural.bottle import bottle
    from sensors.assets.procedural.bowl import bowl
    from sensors.assets.procedural.camera import camera
    from sensors.assets.procedural.can import can
    from sensors.assets.procedural.car import car
    from sensors.assets.procedural.distractors import distractor
    from sensors.assets.procedural.mug import mug

    if category == OTHER:
        return distractor(rng, paint)
    makers: dict[str, Callable[[np.random.Generator, Paint], Any]] = {
        "aeroplane": aeroplane,
        "bottle": bottle,
        "bowl": bowl,
        "camera": camera,
        "can": can,
        "car": car,
        "mug": mug,
    }
    return makers[category](rng, paint), category in _TURNED
