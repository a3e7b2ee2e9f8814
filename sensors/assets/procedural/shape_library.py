"""The built-in library: objects of the seven categories and distractors, generated from a seed.

Also generates texture coordinates for shapes that have none.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sensors.assets.asset import TURN_Y, Asset, canonical_frame, welded
from sensors.assets.asset_source import SourceOptions
from sensors.assets.procedural.solids import Paint
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.symmetry import Symmetry

if TYPE_CHECKING:
    from manifold3d import Manifold

# Part of every id; increased whenever a seed gives a different shape.
EDITION = 1

OTHER = "other"

CATEGORIES = ("aeroplane", "bottle", "bowl", "camera", "can", "car", "mug", OTHER)

# Bodies that are symmetric under rotations about y, colours included.
_TURNED = ("bottle", "bowl", "can")

_SEEDS = 1_000_000

# `sample` draws from this many shapes per category, as a data set has a fixed number of models.
# Results computed once per shape, such as its convex parts, are then reused in many scenes.
INSTANCES = 500

_ID = re.compile(r"([a-z]+)-p(\d+)-(\d{6})")

Array = NDArray[np.float64]


class ProceduralSource:
    """Parametric objects. A category and a seed below a million define an object, bit for bit.

    Sampling draws from the first 500 seeds: the even ones are the training split, the odd ones
    the test split.

    Args:
        options: only `split` is used; there are no files.
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
    """Generate the object of a category and a seed.

    Args:
        category: one of `CATEGORIES`.
        seed: 0 to 999999.

    Raises:
        ToolkitError: unknown category, seed out of range, or manifold3d is not installed.
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
    vertices, faces, colors, parts = paint.mesh(body)
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    vertices, diagonal = canonical_frame(vertices, faces)
    cavity = None
    if paint.cavity is not None:
        room = paint.cavity.to_mesh64()
        inside = (np.asarray(room.vert_properties[:, :3]) - middle) / diagonal
        cavity = trimesh.Trimesh(inside, np.asarray(room.tri_verts, np.int64), process=False)
    places, corners, kept = welded(vertices, faces)
    # Rounding merges corners of slivers, which are then dropped. Parts that touch in an edge stay
    # separate: if welded, four faces would share that edge.
    if trimesh.Trimesh(places, corners, process=False).is_watertight:
        vertices, faces, colors, parts = places, corners, colors[kept], parts[kept]
    wrap = wrapped_uv if category in (*_TURNED, "mug") else box_uv
    return Asset(
        id=f"{category}-p{EDITION}-{seed:06d}",
        category=category,
        mesh=trimesh.Trimesh(vertices, faces, process=False),
        symmetry=TURN_Y if is_turned else Symmetry(),
        face_colors=colors,
        corner_uv=wrap(vertices, faces),
        face_parts=parts,
        cavity=cavity,
    )


def _body(category: str, rng: np.random.Generator, paint: Paint) -> tuple[Manifold, bool]:
    try:
        import manifold3d  # noqa: F401
    except ImportError as error:
        raise ToolkitError(
            "manifold3d is not installed", hint="pip install 'std-toolkit[sim]'"
        ) from error
    from sensors.assets.procedural.aeroplane import aeroplane
    from sensors.assets.procedural.bottle_can import bottle, can
    from sensors.assets.procedural.bowl_mug import bowl, mug
    from sensors.assets.procedural.camera import camera
    from sensors.assets.procedural.car import car
    from sensors.assets.procedural.distractors import distractor

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


def box_uv(vertices: Array, faces: NDArray[np.integer]) -> NDArray[np.float32]:
    """(F, 3, 2) coordinates projected from the side of a box that each face is most aligned with.

    Args:
        vertices: (V, 3) canonical; one unit of texture is one unit of length.
        faces: (F, 3).
    """
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = np.abs(normal).argmax(axis=1)
    side = np.sign(np.take_along_axis(normal, axis[:, None], 1))
    x, y, z = np.moveaxis(corners, -1, 0)
    u = np.choose(axis[:, None], [-side * z, x, side * x])
    v = np.choose(axis[:, None], [y, -side * z, y])
    return (np.stack([u, v], axis=-1) + 0.5).astype(np.float32)


def wrapped_uv(vertices: Array, faces: NDArray[np.integer]) -> NDArray[np.float32]:
    """(F, 3, 2) coordinates wrapped once around the y axis, v along it; lids as in `box_uv`.

    u exceeds 1 on faces that cross the seam: the texture repeats there.
    """
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    u = np.arctan2(corners[..., 0], corners[..., 2]) / (2 * np.pi) + 0.5
    u = np.where(u.max(axis=1, keepdims=True) - u > 0.5, u + 1, u)
    wrapped = np.stack([u, corners[..., 1] + 0.5], axis=-1)
    lid = np.abs(normal[:, 1]) > 0.8 * np.linalg.norm(normal, axis=1)
    return np.where(lid[:, None, None], box_uv(vertices, faces), wrapped).astype(np.float32)
