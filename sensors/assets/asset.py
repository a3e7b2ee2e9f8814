"""A shape for simulated scenes, in its canonical frame."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array, Floats, Mask
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.symmetry import Symmetry
from std_toolkit.scene.document import check_name
from std_toolkit.scene.model import CATEGORY_CLASS_IDS

if TYPE_CHECKING:
    import trimesh

NO_SYMMETRY = Symmetry()
# Rotations about the vertical axis through the centre, by any angle.
TURN_Y = Symmetry(continuous=(((0.0, 1.0, 0.0), (0.0, 0.0, 0.0)),))
AssetMaterial = Literal["raw", "diffuse", "transparent", "specular"]

# Largest deviation of a mesh from the canonical frame: the rounding of float32 files.
_TOLERANCE = 1e-5


@dataclass(frozen=True, eq=False)
class Asset:
    """One instance of a category.

    The mesh is in the canonical frame of NOCS and ShapeNet: bounding box centred at the origin,
    its diagonal 1, y up. Scaled by a diagonal in metres it is an object (`scaled`). Shapes with a
    front face -z; the handle of a procedural mug points to +x.

    Attributes:
        id: safe name, unique within its source; `AssetSource.load` takes it.
        category: such as "mug".
        mesh: triangles of the surface; its visual is ignored. Watertight if the source's mesh is.
        symmetry: in the canonical frame.
        face_colors: (F, 3) uint8 RGB of each face, or None.
        corner_uv: (F, 3, 2) float32 texture coordinates of each face's corners, u right and v up
            (they may leave [0, 1] where the texture repeats), or None.
        texture: (H, W, 3) uint8 RGB image for `corner_uv`, first row at v = 1, or None.
        diagonal_m: bounding-box diagonal of the real object in metres, if the source knows it.
        face_parts: (F,) name of the part that each face belongs to, or None: one part, "body".
        cavity: closed surface of what the object can contain, if it is a closed vessel.
        material: class of the object's real surface: raw (as textured), diffuse, transparent or
            specular; None: any that its category may have.

    Raises:
        ToolkitError: a mesh without faces or outside the canonical frame, or arrays of wrong shape.
    """

    id: str
    category: str
    mesh: trimesh.Trimesh
    symmetry: Symmetry = NO_SYMMETRY
    face_colors: NDArray[np.uint8] | None = None
    corner_uv: Floats | None = None
    texture: NDArray[np.uint8] | None = None
    diagonal_m: float | None = None
    face_parts: NDArray[np.str_] | None = None
    cavity: trimesh.Trimesh | None = None
    material: AssetMaterial | None = None

    def __post_init__(self) -> None:
        check_name(self.id, field="id")
        check_name(self.category, field="category")
        count = len(self.mesh.faces)
        if count == 0:
            raise ToolkitError("the asset has no faces", field="mesh", value=self.id)
        low, high = _bounds(self.vertices, self.faces)
        if np.abs(low + high).max() > _TOLERANCE or abs(np.linalg.norm(high - low) - 1) > 1e-4:
            raise ToolkitError(
                "the asset is not centred with a bounding-box diagonal of 1",
                field="mesh",
                value=(self.id, low.tolist(), high.tolist()),
            )
        for name, array, shape in (
            ("face_colors", self.face_colors, (count, 3)),
            ("corner_uv", self.corner_uv, (count, 3, 2)),
            ("face_parts", self.face_parts, (count,)),
        ):
            if array is not None and array.shape != shape:
                raise ToolkitError(
                    f"must have the shape {shape}", field=name, value=tuple(array.shape)
                )
        if self.texture is not None and (self.texture.ndim != 3 or self.corner_uv is None):
            raise ToolkitError("a texture is (H, W, 3) and needs corner_uv", field="texture")

    @property
    def class_id(self) -> int:
        """Number of the category in the DREDS and STD layouts; 0 for all others."""
        return CATEGORY_CLASS_IDS.get(self.category, 0)

    @property
    def vertices(self) -> Array:
        """(V, 3) canonical coordinates."""
        return np.asarray(self.mesh.vertices, dtype=np.float64)

    @property
    def faces(self) -> NDArray[np.int64]:
        """(F, 3) vertex indices, counter-clockwise from outside."""
        return np.asarray(self.mesh.faces, dtype=np.int64)

    @cached_property
    def content_hash(self) -> str:
        """Hexadecimal SHA-256 of the geometry alone: the cache key of collision bodies."""
        digest = hashlib.sha256(b"asset-geometry-1")
        digest.update(self.vertices.astype("<f8").tobytes())
        digest.update(self.faces.astype("<i8").tobytes())
        return digest.hexdigest()

    def scaled(self, diagonal_m: float) -> trimesh.Trimesh:
        """The object with a bounding-box diagonal in metres, still centred and y up."""
        import trimesh

        return trimesh.Trimesh(self.vertices * diagonal_m, self.faces, process=False)


def canonical_frame(
    vertices: NDArray[np.floating], faces: NDArray[np.integer]
) -> tuple[Array, float]:
    """Vertices translated and scaled so that the bounding box is centred and has diagonal 1.

    The result is rounded to float32, so that a file stores the same numbers.

    Args:
        vertices: (V, 3); vertices that no face uses are ignored.
        faces: (F, 3) vertex indices.

    Returns:
        (V, 3) canonical vertices, and the original diagonal.

    Raises:
        ToolkitError: all vertices coincide.
    """
    v = np.asarray(vertices, dtype=np.float64)
    low, high = _bounds(v, faces)
    diagonal = float(np.linalg.norm(high - low))
    if not diagonal > 0:
        raise ToolkitError("all vertices of the mesh lie in one place", field="mesh")
    canonical = (v - (low + high) / 2) / diagonal
    return canonical.astype(np.float32).astype(np.float64), diagonal


def welded(vertices: Array, faces: NDArray[np.integer]) -> tuple[Array, NDArray[np.int64], Mask]:
    """Merge coincident vertices and drop the faces that degenerate.

    Returns:
        (P, 3) distinct vertices, (K, 3) faces, and (F,) bool mask of the faces kept.
    """
    places, place_of = np.unique(vertices, axis=0, return_inverse=True)
    corners = place_of.reshape(-1)[faces].astype(np.int64)
    kept = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    return places, corners[kept], kept


def surface_points(vertices: Array, faces: NDArray[np.integer], count: int) -> Array:
    """(count, 3) points spread evenly over a surface, always the same; none without area."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    if not area.sum() > 0:
        return np.zeros((0, 3))
    rng = np.random.default_rng(0)
    face = rng.choice(len(faces), count, p=area / area.sum())
    a, b = np.sort(rng.random((2, count)), axis=0)
    return np.einsum("nk,nkd->nd", np.stack([a, b - a, 1 - b], axis=1), corners[face])


def _bounds(vertices: Array, faces: NDArray[np.integer]) -> tuple[Array, Array]:
    used = vertices[np.unique(faces)]
    return used.min(axis=0), used.max(axis=0)
