"""Visual hull of the masks as a signed distance on a grid of voxels."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array, Floats, Mask
from std_toolkit.compiled import compiled
from std_toolkit.geometry.ray_caster import import_open3d
from std_toolkit.scanning.photos.views import Grid, View, in_threads

# Signed distances to outlines are kept in steps of 1/32 pixel.
_STEPS = 32.0
_FARTHEST = 32000
_MOST_ALLOWED = 8
# Pixels around a mask beyond which a voxel is outside anyway.
_REACH = 64


def outline_distance(mask: Mask, reach: int | None = None) -> NDArray[np.int16]:
    """Signed distance of pixel centres to the outline of a mask in 1/32 pixel, positive outside.

    A side where the mask meets the border of the image is no outline: the object may go on there.

    Args:
        mask: (H, W).
        reach: pixels around the mask from which its distance does not matter: it is then as large
            as it can be. None: it matters everywhere.
    """
    if reach is not None:
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        found = np.full(mask.shape, _FARTHEST, np.int16)
        if len(rows):
            place = (slice(max(0, rows[0] - reach), rows[-1] + reach + 1),
                     slice(max(0, columns[0] - reach), columns[-1] + reach + 1))  # fmt: skip
            found[place] = outline_distance(mask[place])
        return found
    h, w = mask.shape
    padded = cv2.copyMakeBorder(mask.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    inside = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    outside = cv2.distanceTransform(1 - padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # The outline lies half a pixel from the centres on both of its sides.
    signed = np.where(padded > 0, 0.5 - inside, outside - 0.5)[1 : h + 1, 1 : w + 1]
    return np.asarray(np.clip(np.rint(signed * _STEPS), -_FARTHEST, _FARTHEST), dtype=np.int16)


def hull_field(views: Sequence[View], grid: Grid, *, allowed: int = 0, threads: int = 1) -> Floats:
    """Signed distance to the visual hull, metres, positive outside; arguments as of `hull_fields`.

    Returns:
        Field in the shape of the grid. Voxels that no photo shows are outside.
    """
    return hull_fields(views, grid, allowed=(allowed,), threads=threads)[0]


def hull_fields(
    views: Sequence[View], grid: Grid, *, allowed: tuple[int, ...], threads: int = 1
) -> list[Floats]:
    """Fields of `hull_field` of several hulls at once.

    Args:
        views: photos with masks.
        grid: the voxels.
        allowed: numbers of photos that may contradict a voxel, one of each hull.
        threads: number of threads.
    """
    P = np.stack([v.P for v in views])
    focal = np.array([np.sqrt(v.camera.fx * v.camera.fy) for v in views])
    sizes = np.array([v.image.shape[:2] for v in views], dtype=np.int64)
    height, width = sizes.max(axis=0)
    distance = np.zeros((len(views), height, width), np.int16)
    for i, view in enumerate(views):
        h, w = sizes[i]
        distance[i, :h, :w] = outline_distance(view.possible, _REACH)
    fields = np.empty((len(allowed), *grid.shape), np.float32)
    counts = np.minimum(allowed, _MOST_ALLOWED - 1)
    origin = np.array(grid.origin)
    parts = np.array_split(np.arange(grid.shape[0]), min(grid.shape[0], 4 * threads))
    in_threads(
        lambda part: _carve(
            P, focal, distance, sizes, origin, grid.step, int(part[0]), int(part[-1]) + 1,
            counts, fields,
        ),
        parts,
        threads=threads,
    )  # fmt: skip
    return list(fields)


@compiled
def _carve(  # type: ignore[no-untyped-def]
    P, focal, distance, sizes, origin, step, z0, z1, counts, fields
) -> None:
    """Write the (count + 1)-th largest signed distance over the views, for slices z0 to z1."""
    largest = np.empty(8, np.float64)
    allowed = counts.max()
    for k in range(z0, z1):
        z = origin[2] + k * step
        for j in range(fields.shape[2]):
            y = origin[1] + j * step
            for i in range(fields.shape[3]):
                x = origin[0] + i * step
                for a in range(allowed + 1):
                    largest[a] = -1e9
                seen = 0
                for v in range(P.shape[0]):
                    w = P[v, 2, 0] * x + P[v, 2, 1] * y + P[v, 2, 2] * z + P[v, 2, 3]
                    if w <= 1e-6:
                        continue
                    px = (P[v, 0, 0] * x + P[v, 0, 1] * y + P[v, 0, 2] * z + P[v, 0, 3]) / w
                    py = (P[v, 1, 0] * x + P[v, 1, 1] * y + P[v, 1, 2] * z + P[v, 1, 3]) / w
                    if px < 0 or py < 0 or px > sizes[v, 1] - 1.001 or py > sizes[v, 0] - 1.001:
                        continue
                    ix, iy = int(px), int(py)
                    fx, fy = px - ix, py - iy
                    d = distance[v]
                    s = (1 - fy) * ((1 - fx) * d[iy, ix] + fx * d[iy, ix + 1]) + fy * (
                        (1 - fx) * d[iy + 1, ix] + fx * d[iy + 1, ix + 1]
                    )
                    s = s / 32.0 * w / focal[v]
                    seen += 1
                    for a in range(allowed + 1):
                        if s > largest[a]:
                            for b in range(allowed, a, -1):
                                largest[b] = largest[b - 1]
                            largest[a] = s
                            break
                for n in range(counts.shape[0]):
                    if seen <= counts[n]:
                        fields[n, k, j, i] = 4 * step
                    else:
                        fields[n, k, j, i] = largest[counts[n]]


def surface_of(field: Floats, grid: Grid) -> tuple[Array, NDArray[np.int64]]:
    """Closed zero surface of a field that is negative inside: vertices (V, 3), faces (F, 3).

    The border of the grid counts as outside, so the surface is closed.
    """
    o3d = import_open3d()

    closed = np.pad(field, 1, constant_values=np.float32(grid.step))
    closed[closed == 0] = 1e-9
    mesh = o3d.t.geometry.TriangleMesh.create_isosurfaces(o3d.core.Tensor.from_numpy(closed), [0.0])
    if "positions" not in mesh.vertex or len(mesh.vertex.positions) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    vertices = mesh.vertex.positions.numpy().astype(np.float64) - 1
    faces = mesh.triangle.indices.numpy().astype(np.int64)
    placed = np.asarray(grid.origin) + vertices * grid.step
    a, b, c = (placed[faces[:, n]] for n in range(3))
    if (a * np.cross(b, c)).sum() < 0:
        faces = faces[:, ::-1]
    return placed, faces


def column_tops(inside: Mask) -> tuple[NDArray[np.int64], Mask]:
    """Index (h, w) of the highest true voxel of each column, and which columns have one."""
    index = len(inside) - 1 - inside[::-1].argmax(axis=0)
    return index, np.asarray(inside.any(axis=0))


def largest_component(inside: Mask) -> Mask:
    """The largest connected part of the true voxels."""
    from scipy.ndimage import label

    labels, count = label(inside)
    if count <= 1:
        return inside
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.asarray(labels == sizes.argmax())
