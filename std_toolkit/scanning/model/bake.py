"""Texture of a mesh from the photos: atlas, exposure compensation, blending."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array, Floats, Mask
from std_toolkit.compiled import compiled
from std_toolkit.geometry.camera import pixel_rays
from std_toolkit.geometry.ray_caster import RayCaster, import_open3d
from std_toolkit.scanning.photos.views import View, in_threads
from std_toolkit.scanning.photos.visibility import depth_of, seen_from, vertex_normals

# The best photo of a texel dominates: the mean of many is blurred by errors of the poses.
_SHARPNESS = 4.0
_UNSEEN_GREY = 128


@dataclass(frozen=True, eq=False)
class Texture:
    """Texture of a mesh.

    Attributes:
        uv: (F, 3, 2) coordinates of the corners of the faces; v = 0 is the bottom of the image.
        image: (size, size, 3) RGB.
        guessed: (size, size) texels that no photo shows; their colour is that of the nearest place
            on the surface that one shows, or grey.
        seen: (F,) number of photos that show each face.
        gains: (V, 3) exposure of each photo relative to the texture.
    """

    uv: Array
    image: NDArray[np.uint8]
    guessed: Mask
    seen: NDArray[np.int64]
    gains: Array


def bake_texture(
    vertices: Array,
    faces: NDArray[np.int64],
    views: Sequence[View],
    *,
    size: int,
    threads: int = 1,
) -> Texture:
    """Unwrap a closed mesh and colour it from the photos.

    Args:
        vertices: (V, 3) world.
        faces: (F, 3).
        views: photos with masks.
        size: width and height of the texture.
        threads: number of threads.
    """
    uv = unwrap(vertices, faces, size, threads)
    face, weights = _rasterise(np.ascontiguousarray(uv), size)
    rows, columns = np.nonzero(face >= 0)
    chosen = face[rows, columns]
    b, c = weights[rows, columns].T.astype(np.float64)
    corners = vertices[faces]
    places = (
        corners[chosen, 0] * (1 - b - c)[:, None]
        + corners[chosen, 1] * b[:, None]
        + corners[chosen, 2] * c[:, None]
    )
    normals = vertex_normals(vertices, faces)[faces]
    normal = (
        normals[chosen, 0] * (1 - b - c)[:, None]
        + normals[chosen, 1] * b[:, None]
        + normals[chosen, 2] * c[:, None]
    )
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
    caster = RayCaster(vertices, faces, threads=1)
    gains = exposures(corners.mean(axis=1), _face_normals(corners), views, caster, threads)
    total = np.zeros((len(places), 3))
    weight = np.zeros(len(places))
    middle, facing = corners.mean(axis=1), _face_normals(corners)
    seen = np.zeros(len(faces), np.int64)
    for view, gain in zip(views, gains, strict=True):
        depth = depth_of(view, caster)
        _, w = seen_from(view, middle, facing, depth)
        seen += w > 0
        # Texels of faces that are turned away need no further look.
        towards = ((view.centre - middle) * facing).sum(axis=1) > 0
        turned = np.flatnonzero(towards[chosen])
        color, w = seen_from(view, places[turned], normal[turned], depth)
        w = w**_SHARPNESS
        total[turned] += color / gain * w[:, None]
        weight[turned] += w
    some = weight > 0
    found = np.zeros((len(places), 3))
    found[some] = total[some] / weight[some, None]
    share = np.stack([1 - b - c, b, c], axis=1)
    found[~some] = nearest_colors(vertices, faces, chosen, share, found, some)[~some]
    image = np.full((size, size, 3), _UNSEEN_GREY, np.uint8)
    image[rows, columns] = np.clip(np.rint(found), 0, 255).astype(np.uint8)
    guessed = np.zeros((size, size), bool)
    guessed[rows[~some], columns[~some]] = True
    take = _nearest_texel(face >= 0)
    if take is not None:
        image, guessed = image[take[..., 0], take[..., 1]], guessed[take[..., 0], take[..., 1]]
    return Texture(uv, image, guessed, seen, gains)


def nearest_colors(
    vertices: Array,
    faces: NDArray[np.int64],
    face: NDArray[np.int64],
    share: Array,
    colors: Array,
    known: Mask,
) -> Array:
    """Colours (T, 3) that texels take from the nearest coloured place on the surface.

    The way leads over edges of the mesh: through a thin wall, the other side is no neighbour.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3).
        face: (T,) face of each texel.
        share: (T, 3) barycentric weights of its corners.
        colors: (T, 3), used where known.
        known: (T,) texels with a colour.

    Returns:
        Colours between those of the corners; grey on parts of the mesh without any colour.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra

    count = len(vertices)
    corner = faces[face[known]].ravel()
    amount = np.maximum(share[known].ravel(), 1e-6)
    weight = np.bincount(corner, amount, minlength=count)
    each = np.repeat(colors[known], 3, axis=0)
    color = np.stack(
        [np.bincount(corner, amount * each[:, k], minlength=count) for k in range(3)], axis=1
    )
    sources = np.flatnonzero(weight)
    color[sources] = color[sources] / weight[sources, None]
    nearest = np.arange(count)
    if len(sources):
        ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        ends = np.unique(np.sort(ends, axis=1), axis=0)
        length = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
        # Two vertices in one place: a length of zero would be no edge.
        graph = coo_matrix((np.maximum(length, 1e-12), ends.T), shape=(count, count)).tocsr()
        _, _, nearest = dijkstra(
            graph, directed=False, indices=sources, min_only=True, return_predecessors=True
        )
    reached = nearest >= 0
    reached[reached] = weight[nearest[reached]] > 0
    color = np.where(reached[:, None], color[np.maximum(nearest, 0)], _UNSEEN_GREY)
    return np.asarray((color[faces[face]] * share[..., None]).sum(axis=1))


def unwrap(vertices: Array, faces: NDArray[np.int64], size: int, threads: int = 1) -> Array:
    """(F, 3, 2) texture coordinates by Open3D's UVAtlas."""
    o3d = import_open3d()

    mesh = o3d.t.geometry.TriangleMesh(
        o3d.core.Tensor.from_numpy(vertices.astype(np.float32)),
        o3d.core.Tensor.from_numpy(faces.astype(np.int64)),
    )
    # In one partition 20,000 faces take 20 times as long.
    mesh.compute_uvatlas(
        size=size, gutter=3.0, max_stretch=0.5, parallel_partitions=8, nthreads=threads
    )
    return np.asarray(mesh.triangle.texture_uvs.numpy(), np.float64)


def vertex_colors(count: int, faces: NDArray[np.int64], texture: Texture) -> NDArray[np.uint8]:
    """RGB (count, 3) of the texture at every vertex."""
    row, column = texels_at(texture, texture.uv)
    color = np.full((count, 3), 128, np.uint8)
    color[faces.ravel()] = texture.image[row, column].reshape(-1, 3)
    return color


def vertex_guessed(count: int, faces: NDArray[np.int64], texture: Texture) -> Mask:
    """(count,) vertices of which no face has a colour that a photo shows."""
    row, column = texels_at(texture, texture.uv)
    guessed = np.ones(count, bool)
    guessed[faces.ravel()[~texture.guessed[row, column].ravel()]] = False
    return guessed


def texels_at(texture: Texture, uv: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column (...) of the texels at texture coordinates (..., 2)."""
    size = texture.image.shape[0]
    column = np.clip((uv[..., 0] * size).astype(np.int64), 0, size - 1)
    row = np.clip(((1 - uv[..., 1]) * size).astype(np.int64), 0, size - 1)
    return row, column


def exposures(
    places: Array, normals: Array, views: Sequence[View], caster: RayCaster, threads: int
) -> Array:
    """(V, 3) brightness of each photo relative to the mean of those that show the same places."""
    step = max(1, len(places) // 6000)
    places, normals = places[::step], normals[::step]
    seen = in_threads(
        lambda v: seen_from(v, places, normals, depth_of(v, caster)), views, threads=threads
    )
    color = np.stack([c for c, _ in seen])
    weight = np.stack([w for _, w in seen])
    gains = np.ones((len(views), 3))
    for _ in range(4):
        scaled = color / gains[:, None]
        mean = (scaled * weight[..., None]).sum(axis=0) / (weight.sum(axis=0)[:, None] + 1e-9)
        for i in range(len(views)):
            use = (weight[i] > 0.2) & (mean.min(axis=1) > 10) & (color[i].max(axis=1) < 250)
            if use.sum() > 50:
                gains[i] = np.median(color[i][use] / mean[use], axis=0)
        gains /= np.exp(np.mean(np.log(np.maximum(gains, 1e-3)), axis=0))
    return np.clip(gains, 0.3, 3.0)


def _face_normals(corners: Array) -> Array:
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(n / (np.linalg.norm(n, axis=1, keepdims=True) + 1e-20))


def _rasterise(uv: Array, size: int) -> tuple[NDArray[np.int64], Floats]:
    """Face (size, size), -1 for none, and barycentric weights (size, size, 2) of every texel."""
    face = np.full((size, size), -1, np.int64)
    weights = np.zeros((size, size, 2), np.float32)
    _fill_faces(uv, face, weights)
    return face, weights


@compiled
def _fill_faces(uv, face, weights) -> None:  # type: ignore[no-untyped-def]
    size = face.shape[0]
    for f in range(uv.shape[0]):
        x0, y0 = uv[f, 0, 0] * size - 0.5, (1 - uv[f, 0, 1]) * size - 0.5
        x1, y1 = uv[f, 1, 0] * size - 0.5, (1 - uv[f, 1, 1]) * size - 0.5
        x2, y2 = uv[f, 2, 0] * size - 0.5, (1 - uv[f, 2, 1]) * size - 0.5
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if abs(area) < 1e-12:
            continue
        # Texels whose corner the face covers count too: bilinear lookups read them.
        slack = 0.75
        for y in range(max(0, int(min(y0, y1, y2) - 1)), min(size, int(max(y0, y1, y2) + 2))):
            for x in range(max(0, int(min(x0, x1, x2) - 1)), min(size, int(max(x0, x1, x2) + 2))):
                b = ((x - x0) * (y2 - y0) - (x2 - x0) * (y - y0)) / area
                c = ((x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)) / area
                a = 1 - b - c
                inside = a >= 0 and b >= 0 and c >= 0
                if not inside:
                    if face[y, x] >= 0:
                        continue
                    h = slack / np.sqrt(abs(area))
                    if a < -h or b < -h or c < -h:
                        continue
                    b = min(max(b, 0.0), 1.0)
                    c = min(max(c, 0.0), 1.0 - b)
                face[y, x] = f
                weights[y, x, 0] = b
                weights[y, x, 1] = c


def _nearest_texel(filled: Mask) -> NDArray[np.int64] | None:
    """Row and column (size, size, 2) of the nearest filled texel; None without any.

    Texels beside the charts of the faces repeat their rims, for lookups between texels.
    """
    if not filled.any():
        return None
    _, label = cv2.distanceTransformWithLabels(
        (~filled).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero(filled)
    source = np.zeros((int(label.max()) + 1, 2), np.int64)
    source[label[rows, columns]] = np.stack([rows, columns], axis=1)
    return source[label]


def rendered(
    view: View, mesh_caster: RayCaster, texture: Texture
) -> tuple[NDArray[np.uint8], Mask]:
    """The textured mesh as the camera of a view sees it, RGB, and where it is seen."""
    from std_toolkit.rendering.texture import SurfaceColors

    local = pixel_rays(view.camera)
    rays = np.empty((*local.shape[:2], 6), np.float32)
    rays[..., :3] = view.centre
    rays[..., 3:] = local @ view.T_world_cam.R.T
    hits = mesh_caster.cast(rays)
    mask = np.isfinite(hits.distance)
    colors = SurfaceColors(texture.uv.astype(np.float32), texture.image.astype(np.float32))
    out = np.zeros((*mask.shape, 3), np.uint8)
    out[mask] = np.clip(colors.at(hits.face[mask].astype(np.int64), hits.uv[mask]), 0, 255)
    return out, mask
