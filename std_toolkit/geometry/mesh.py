"""Meshes in metres: loading, unit checks, extents, error."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh_damage import (
    check_whole,
    refuse_piles,
    warn_of_loose_vertices,
    warn_of_unread_colors,
)
from std_toolkit.geometry.mesh_records import named_ply_colors, read_records
from std_toolkit.geometry.obj_files import FilesBeside, ObjFiles, log_notes, read_obj
from std_toolkit.geometry.obj_texture import CORNER_UV, read_corner_uv
from std_toolkit.geometry.ray_caster import import_open3d
from std_toolkit.log import logger

if TYPE_CHECKING:
    import trimesh

MESH_SUFFIXES = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")

_KNOWN = ", ".join(MESH_SUFFIXES)
OTHER_MESHES = f"one of {_KNOWN}; export COLLADA, FBX, STEP or .blend files as OBJ or GLB"
"""Hint for a mesh in another format."""

UNREAD_MESHES = (".3ds", ".blend", ".dae", ".fbx", ".iges", ".igs", ".step", ".stp",
                 ".usd", ".usdz")  # fmt: skip
"""Meshes that people have and that are not read."""

# Plausible size of table-top objects: 3 mm to 3 m. A mug in millimetres is 100 "metres" high, a
# mug in metres read as millimetres 0.1 mm.
SMALLEST_EXTENT_M = 0.003
LARGEST_EXTENT_M = 3.0
# Faces that Open3D decimates to the usual 200,000 within some 10 s.
_MOST_FOR_OPEN3D = 500_000

UNITS_IN_M = {"m": 1.0, "cm": 0.01, "mm": 0.001}

SECOND_READER = "second_reader"
"""Key of a mesh's metadata: other programs may not read its file."""

Array = NDArray[np.float64]


_ROUNDS = 8

# Pairs of points whose distances are computed at once, 256 KiB.
_PAIRS = 1 << 15

# Edges that are bent by more than this are part of the shape and not of its error.
_CREASE = np.deg2rad(40)


def load_mesh(
    path: Path | str, *, unit: str = "m", any_size: bool = False, corners: bool = True
) -> trimesh.Trimesh:
    """Read a mesh as one `trimesh.Trimesh`, vertices in metres, vertex order kept.

    A textured OBJ file has the texture coordinates of its faces' corners in the face attribute
    `CORNER_UV`: the mesh itself has only one for each vertex.

    Args:
        path: OBJ, PLY, GLB, STL or OFF file.
        unit: unit of the file, "m", "cm" or "mm".
        any_size: also accept an implausible size, for a file whose unit is unknown.
        corners: read `CORNER_UV`, which takes as long as the rest of an OBJ file.

    Raises:
        ToolkitError: the mesh is unreadable, has no faces, has vertices that are not finite, or
            has an implausible size (typical for a wrong unit).
    """
    import trimesh

    path = Path(path)
    if unit not in UNITS_IN_M:
        raise ToolkitError("unknown unit", path=path, value=unit, hint="one of m, cm, mm")
    if not path.is_file():
        raise ToolkitError("mesh file not found", path=path)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise ToolkitError("not a mesh format", path=path, value=path.suffix, hint=OTHER_MESHES)
    files = read_obj(path) if path.suffix.lower() == ".obj" else None
    if files is not None:
        log_notes(path, files)
    try:
        mesh = parse_mesh(path if files is None else files)
    except Exception as error:  # the parsers of trimesh raise many kinds of errors
        mesh = read_records(path)
        if mesh is None:
            commas = files is not None and re.search(rb"^v[ \t].*\d,\d", files.data, re.M)
            raise ToolkitError(
                f"cannot read the mesh: {error}",
                path=path,
                hint="numbers have decimal commas: write points" if commas else None,
            ) from error
        mesh.metadata[SECOND_READER] = True
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        mesh = read_records(path)
        if mesh is None or len(mesh.faces) == 0:
            raise ToolkitError("the mesh has no faces", path=path)
        mesh.metadata[SECOND_READER] = True
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise ToolkitError(
            "faces of the mesh refer to vertices that do not exist",
            path=path,
            value=int(mesh.faces.max()),
        )
    check_whole(path, len(mesh.vertices), len(mesh.faces))
    warn_of_loose_vertices(path, len(mesh.vertices), mesh.faces)
    warn_of_unread_colors(path, mesh)
    if not np.isfinite(mesh.vertices).all():
        raise ToolkitError("the mesh has vertices that are not finite", path=path)
    refuse_piles(path, mesh.vertices, mesh.faces)
    if (
        corners
        and files is not None
        and files.has_one_material
        and getattr(mesh.visual, "kind", None) == "texture"
    ):
        corner_uv = read_corner_uv(files.data, mesh.vertices[mesh.faces])
        if corner_uv is not None:
            mesh.face_attributes[CORNER_UV] = corner_uv
    if unit != "m":
        mesh.apply_scale(UNITS_IN_M[unit])
    if not any_size:
        check_mesh_size(mesh, path=path)
    return mesh


def parse_mesh(source: Path | ObjFiles, *, data: bytes | None = None, kind: str = "") -> Any:
    """What trimesh reads: a mesh, or something without faces; errors are those of its parsers.

    Args:
        source: a file, or an OBJ file with its materials.
        data: content of another kind of file, in place of `source`.
        kind: suffix of `data`, without a dot.
    """
    import trimesh

    options: dict[str, Any] = {"process": False, "maintain_order": True}
    if data is not None:
        data = named_ply_colors(data) if kind == "ply" else data
        loaded = trimesh.load(io.BytesIO(data), file_type=kind, **options)
    elif isinstance(source, ObjFiles):
        text = io.BytesIO(source.data)
        loaded = trimesh.load(text, file_type="obj", resolver=cast("Any", source), **options)
    else:
        beside = FilesBeside(source.parent)
        file: Any = source
        if source.suffix.lower() == ".ply":
            file = io.BytesIO(named_ply_colors(source.read_bytes()))
            options["file_type"] = "ply"
        loaded = trimesh.load(file, resolver=cast("Any", beside), **options)
        for name in beside.missing:
            logger.warning("%s: %s is missing; the mesh is read without it", source, name)
    return loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded


def decimate_mesh(mesh: trimesh.Trimesh, faces: int) -> trimesh.Trimesh:
    """Return a copy with at most `faces` faces (quadric error decimation of Open3D).

    Texture and face colours become vertex colours; a mesh without colours stays without. Vertices
    at one place are merged first: decimation would tear the surface at texture seams. Meshes of
    more than 500,000 faces are first reduced to this number by fast_simplification, which takes a
    tenth of the time but may join a few faces at edges that then have four.

    Raises:
        ToolkitError: `faces` is less than 4.
    """
    o3d = import_open3d()
    import trimesh

    if faces < 4:
        raise ToolkitError("a mesh cannot have so few faces", field="faces", value=faces)
    fine = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.asarray(mesh.vertices, dtype=np.float64)),
        o3d.utility.Vector3iVector(np.asarray(mesh.faces, dtype=np.int32)),
    )
    painted = vertex_colors(mesh)
    if painted is not None:
        fine.vertex_colors = o3d.utility.Vector3dVector(painted[:, :3] / 255)
    fine.remove_duplicated_vertices()
    fine.remove_degenerate_triangles()
    if len(fine.triangles) > max(faces, _MOST_FOR_OPEN3D):
        fine = _reduced(fine, max(faces, _MOST_FOR_OPEN3D))
    if len(fine.triangles) > faces:
        fine = fine.simplify_quadric_decimation(faces)
    fine.remove_unreferenced_vertices()
    colors = np.rint(np.asarray(fine.vertex_colors) * 255).astype(np.uint8)
    return trimesh.Trimesh(
        np.asarray(fine.vertices),
        np.asarray(fine.triangles),
        vertex_colors=colors if len(colors) else None,
        process=False,
    )


def _reduced(fine: Any, faces: int) -> Any:
    """An Open3D mesh reduced to `faces` faces, vertices coloured as the nearest old ones."""
    import fast_simplification

    o3d = import_open3d()
    from scipy.spatial import cKDTree

    old = np.asarray(fine.vertices)
    # Centred, because the library calculates in single precision.
    center = old.mean(axis=0)
    vertices, triangles = fast_simplification.simplify(
        (old - center).astype(np.float32),
        np.ascontiguousarray(fine.triangles, dtype=np.int32),
        target_count=faces,
        agg=1,
    )
    vertices = vertices.astype(np.float64) + center
    coarse = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices),
        o3d.utility.Vector3iVector(triangles.astype(np.int32)),
    )
    if fine.has_vertex_colors():
        nearest = cKDTree(old).query(vertices)[1]
        coarse.vertex_colors = o3d.utility.Vector3dVector(np.asarray(fine.vertex_colors)[nearest])
    return coarse


def vertex_colors(mesh: trimesh.Trimesh) -> NDArray[np.uint8] | None:
    """(V, 4) RGBA of the vertices, also from a texture or face colours; None without colours."""
    visual: Any = mesh.visual
    if visual.kind == "texture":
        visual = visual.to_color()
    return np.asarray(visual.vertex_colors, np.uint8) if visual.defined else None


def check_mesh_size(mesh: trimesh.Trimesh, *, path: Path | str | None = None) -> None:
    """Check that a mesh has a plausible size for a table-top object.

    Raises:
        ToolkitError: the largest extent is outside 3 mm to 3 m.
    """
    extents = mesh_extents(mesh)
    largest = float(extents.max())
    size = " x ".join(f"{x:.4g}" for x in extents)
    if largest > LARGEST_EXTENT_M:
        raise ToolkitError(
            "the mesh is implausibly large in metres",
            path=path,
            value=f"{size} m",
            hint="millimetres? give --mesh-unit mm (or cm)",
        )
    if largest < SMALLEST_EXTENT_M:
        raise ToolkitError(
            "the mesh is implausibly small in metres",
            path=path,
            value=f"{size} m",
            hint="was a metre mesh scaled as if it were in millimetres?",
        )


def _used_vertices(mesh: trimesh.Trimesh) -> Array:
    """(V, 3) vertices that faces use, in their order; sorting millions of faces takes seconds."""
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    used = np.zeros(len(vertices), dtype=bool)
    used[np.asarray(mesh.faces)] = True
    return vertices[used]


def mesh_bounds(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """(2, 3) smallest and largest coordinates of the vertices that faces use, metres."""
    used = _used_vertices(mesh)
    return np.stack([used.min(axis=0), used.max(axis=0)])


def mesh_extents(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """(3,) size of the axis-aligned bounding box in the mesh frame, metres."""
    low, high = mesh_bounds(mesh)
    return high - low


def hull_vertices(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """(H, 3) vertices of the convex hull; of the outline if the mesh is flat."""
    return hull_points(_used_vertices(mesh))


def hull_points(points: NDArray[np.floating]) -> NDArray[np.float64]:
    """(H, 3) those of the points (V, 3) that are on their convex hull, or on their outline."""
    from scipy.spatial import ConvexHull, QhullError

    used = np.asarray(points, dtype=np.float64)
    # The hull of a flat mesh (a board, a picture) is in its plane or line.
    _, extent, axes = np.linalg.svd(used - used.mean(axis=0), full_matrices=False)
    rank = int((extent > 1e-9 * extent[0]).sum())
    along = (used - used.mean(axis=0)) @ axes[:rank].T
    if rank == 1:
        return used[[int(along.argmin()), int(along.argmax())]]
    try:
        return used[ConvexHull(along if rank < 3 else used).vertices]
    except QhullError:
        return used


def mesh_diameter(mesh: trimesh.Trimesh) -> float:
    """Largest distance between two vertices that faces use, metres (BOP's diameter); exact.

    Directions of space are divided into ever smaller cones. In each, only the vertices that are
    extreme enough to be the ends of a longer segment than the longest one known are kept.
    """
    return largest_distance(_used_vertices(mesh))


def largest_distance(points: Array) -> float:
    """Largest distance between two of the points (N, 3); exact."""
    best, at = 0.0, points[0]
    for _ in range(_ROUNDS):  # from a point to the farthest one, and again
        distance = np.linalg.norm(points - at, axis=1)
        best, at = max(best, float(distance.max())), points[distance.argmax()]
    rounding = 1e-14 * float(np.abs(points).max())
    cones = [(triangle, points, points) for triangle in _half_of_all_directions()]
    while cones:
        triangle, above, below = cones.pop()
        axis = triangle.sum(axis=0)
        axis /= np.linalg.norm(axis)
        high, low = above @ axis, below @ axis
        # Along the axis, a segment in the cone is at least this fraction of its length. The ends
        # of one that is longer than `best` are within `slack` of the extremes.
        fraction = float((triangle @ axis).min())
        slack = float(high.max() - low.min()) - best * fraction + rounding
        if slack < 0:
            continue
        above, below = above[high >= high.max() - slack], below[low <= low.min() + slack]
        if len(above) * len(below) > _PAIRS and fraction < 1 - 1e-9:
            a, b, c = triangle
            ab, bc, ca = (m / np.linalg.norm(m) for m in (a + b, b + c, c + a))
            cones += [
                (np.stack(corners), above, below)
                for corners in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
            ]
        else:
            best = max(best, _largest_between(above, below))
    return best


def _largest_between(first: Array, second: Array) -> float:
    """Largest distance between a point of each set; equal points count once."""
    from scipy.spatial.distance import cdist

    if len(first) * len(second) > _PAIRS:
        first, second = np.unique(first, axis=0), np.unique(second, axis=0)
    rows = max(1, _PAIRS // len(second))
    parts = range(0, len(first), rows)
    return max(float(cdist(first[i : i + rows], second).max()) for i in parts)


def _half_of_all_directions() -> Array:
    """(10, 3, 3) unit corners of the faces of an icosahedron, one of each pair of opposite ones."""
    import trimesh

    solid = trimesh.creation.icosahedron()
    corners = np.asarray(solid.vertices[solid.faces], dtype=np.float64)
    middles = corners.sum(axis=1)
    half: Array = corners[middles @ [0.9, 0.4, 0.15] > 0]
    return half


def nocs_frame(mesh: trimesh.Trimesh) -> tuple[NDArray[np.float64], float]:
    """Centre (3,) and diagonal of the bounding box, metres: NOCS = (p - centre)/diagonal + 0.5."""
    low, high = mesh_bounds(mesh)
    return (low + high) / 2, float(np.linalg.norm(high - low))


def surface_error(mesh: trimesh.Trimesh) -> float:
    """Error of a mesh that shows in itself: facets on curved parts and roughness, metres.

    The height of an arc over a facet whose neighbours are bent by an angle; the 95th percentile
    over the surface. A slow warp does not show.
    """
    import trimesh

    # Vertices at one place, at seams of a texture, are one.
    places, welded = np.unique(mesh.vertices, axis=0, return_inverse=True)
    mesh = trimesh.Trimesh(places, welded.reshape(-1)[mesh.faces], process=False)
    angle, pairs = mesh.face_adjacency_angles, mesh.face_adjacency
    if not len(pairs):
        return 0.0
    ends = mesh.vertices[mesh.face_adjacency_edges]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    area = mesh.area_faces[pairs].sum(axis=1)
    smooth = (angle < _CREASE) & (length > 0) & (area > 0)
    if not smooth.any():
        return 0.0
    arc = area[smooth] / length[smooth] / 2 * np.tan(angle[smooth] / 4)
    order = np.argsort(arc)
    share = np.cumsum(area[smooth][order])
    return float(arc[order][np.searchsorted(share, 0.95 * share[-1])])
