"""The synthetic table top for ray casting: geometry, albedo, light, reflection, refraction."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from sensors.synthetic.shapes import Shape, label_texture, sample, wrap
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.geometry.se3 import SE3

Array = NDArray[np.float64]
TABLE_HALF_M = 0.75
FLOOR_HALF_M = 5.0
FLOOR_Z_M = -0.72
SUN = np.array([0.35, -0.45, 0.82]) / np.linalg.norm([0.35, -0.45, 0.82])
MIRROR_TINT = np.array([0.86, 0.87, 0.88])
GLASS_INDEX = 1.45


@dataclass(frozen=True)
class Hits:
    """Ray hits: arrays over rays.

    Attributes:
        t: ray parameter, inf where nothing was hit.
        entity: 0 table, 1 floor, 2 + i for object i, -1 for nothing.
        points, normals: (N, 3) world frame; the normal faces the ray.
    """

    t: Array
    entity: NDArray[np.int64]
    points: Array
    normals: Array


class World:
    """Objects on a printed table; world frame z up, table top at z = 0.

    Args:
        shapes: the objects.
        poses: T_world_obj of each.
        seed: of all textures.

    Attributes:
        textures: textures of the objects, wrapped around them as `textured_mesh` does.
    """

    def __init__(self, shapes: list[Shape], poses: list[SE3], *, seed: int) -> None:
        self.shapes = shapes
        self.poses = poses
        rng = np.random.default_rng(seed)
        self._meshes = [_plane(TABLE_HALF_M, 0.0), _plane(FLOOR_HALF_M, FLOOR_Z_M)]
        self._meshes += [
            trimesh.Trimesh(T @ s.mesh.vertices, s.mesh.faces, process=False)
            for s, T in zip(shapes, poses, strict=True)
        ]
        self._normals = [np.asarray(m.vertex_normals) for m in self._meshes]
        self._everything, self._opaque = RayCaster(), RayCaster()
        self._opaque_entities: list[int] = []
        for i, mesh in enumerate(self._meshes):
            self._everything.add(mesh.vertices, mesh.faces)
            if not self._is_glass(i):
                self._opaque.add(mesh.vertices, mesh.faces)
                self._opaque_entities.append(i)
        self._table = label_texture(
            rng,
            width=2048,
            height=2048,
            base=(0.40, 0.33, 0.25),
            marks=3500,
            contrast=0.4,
            mark_size=(0.004, 0.016),
        )
        self._floor = label_texture(
            rng,
            width=1024,
            height=1024,
            base=(0.30, 0.32, 0.34),
            marks=900,
            contrast=0.3,
            mark_size=(0.004, 0.02),
        )
        self.textures = [
            label_texture(rng, width=768, height=512, base=base, marks=s.marks, contrast=0.8)
            for s, base in zip(shapes, _paints(len(shapes)), strict=True)
        ]

    def cast(self, origins: Array, directions: Array, *, through_glass: bool = False) -> Hits:
        """First hits of rays (N, 3); `through_glass` ignores transparent objects."""
        caster = self._opaque if through_glass else self._everything
        met = caster.cast(np.concatenate([origins, directions], axis=1))
        t = met.distance.astype(np.float64)
        known = self._opaque_entities if through_glass else range(len(self._meshes))
        entity = np.array([*known, -1])[np.where(np.isfinite(t), met.mesh.astype(np.int64), -1)]
        points = origins + np.where(np.isfinite(t), t, 0)[:, None] * directions
        normals = np.zeros_like(points)
        for i in np.unique(entity[entity >= 0]):
            rows = entity == i
            corner = self._normals[i][self._meshes[i].faces[met.face[rows]]]
            u, v = met.uv[rows].T
            weights = np.stack([1 - u - v, u, v], axis=1)
            normals[rows] = np.einsum("nk,nkc->nc", weights, corner)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.where(length > 0, length, 1)
        facing = np.sum(normals * directions, axis=1) > 0
        normals[facing] *= -1
        return Hits(t, entity, points, normals)

    def radiance(self, origins: Array, directions: Array, *, bounces: int = 2) -> Array:
        """(N, 3) linear RGB that arrives along unit directions (N, 3) from origins (N, 3)."""
        return self.shade(self.cast(origins, directions), directions, bounces=bounces)

    def shade(self, hits: Hits, directions: Array, *, bounces: int = 2) -> Array:
        """(N, 3) linear RGB of hits, seen along unit directions (N, 3)."""
        colour = _sky(directions)
        hit = hits.entity >= 0
        kinds = np.array([0, 0, *(_KIND[s.material] for s in self.shapes)])
        kind = np.where(hit, kinds[np.maximum(hits.entity, 0)], -1)

        rows = np.flatnonzero(kind == 0)
        if len(rows):
            colour[rows] = self._albedo(hits, rows) * self._light(hits, rows)[:, None]
        rows = np.flatnonzero(kind == 1)  # mirror
        if len(rows) and bounces:
            n, d = hits.normals[rows], directions[rows]
            reflected = d - 2 * np.sum(d * n, axis=1, keepdims=True) * n
            seen = self.radiance(hits.points[rows] + 1e-5 * n, reflected, bounces=bounces - 1)
            colour[rows] = seen * MIRROR_TINT
        rows = np.flatnonzero(kind == 2)  # glass
        if len(rows) and bounces:
            colour[rows] = self._glass(hits, rows, directions, bounces)
        return colour

    def _glass(self, hits: Hits, rows: NDArray[np.int64], directions: Array, bounces: int) -> Array:
        n, d = hits.normals[rows], directions[rows]
        cosine = -np.sum(d * n, axis=1, keepdims=True)
        fresnel = 0.06 + 0.94 * (1 - np.clip(cosine, 0, 1)) ** 5
        reflected = d + 2 * cosine * n
        mirror = self.radiance(hits.points[rows] + 1e-5 * n, reflected, bounces=bounces - 1)
        # A thin wall hardly refracts, its rim does: refract in proportion to the obliqueness.
        bent = d - (1 - 1 / GLASS_INDEX) * (1 - cosine) * 1.3 * n
        bent /= np.linalg.norm(bent, axis=1, keepdims=True)
        behind = self.cast(hits.points[rows] - 1e-5 * n, bent, through_glass=True)
        clear = self.shade(behind, bent, bounces=0)
        tint = np.array([0.90, 0.95, 0.93]) * (0.45 + 0.55 * np.clip(cosine, 0, 1) ** 0.6)
        return fresnel * mirror + (1 - fresnel) * clear * tint

    def _albedo(self, hits: Hits, rows: NDArray[np.int64]) -> Array:
        out = np.zeros((len(rows), 3))
        for i in np.unique(hits.entity[rows]):
            mine = hits.entity[rows] == i
            p = hits.points[rows[mine]]
            if i < 2:
                half, texture = ((TABLE_HALF_M, self._table), (FLOOR_HALF_M, self._floor))[i]
                out[mine] = sample(texture, p[:, 0] / (2 * half) + 0.5, p[:, 1] / (2 * half) + 0.5)
                continue
            to_object = self.poses[i - 2].inverse()
            local, normal = to_object @ p, hits.normals[rows[mine]] @ to_object.R.T
            u, v = wrap(local, normal, self.shapes[i - 2].mesh.extents)
            out[mine] = sample(self.textures[i - 2], u, v)
        return out

    def _light(self, hits: Hits, rows: NDArray[np.int64]) -> Array:
        n = hits.normals[rows]
        sun = np.clip(n @ SUN, 0, 1)
        origins = hits.points[rows] + 1e-4 * n
        rays = np.concatenate([origins, np.broadcast_to(SUN, origins.shape)], axis=1)
        blocked = self._opaque.occluded(rays)
        return 0.42 + 0.16 * n[:, 2] + 0.52 * sun * np.where(blocked, 0.25, 1.0)

    def _is_glass(self, entity: int) -> bool:
        return entity >= 2 and self.shapes[entity - 2].material == "transparent"


_KIND = {"raw": 0, "diffuse": 0, "specular": 1, "transparent": 2}


def _paints(count: int) -> list[tuple[float, float, float]]:
    """Clearly distinct base colours of the objects, linear RGB."""
    hues = (np.arange(count) * 0.381966 + 0.08) % 1
    channels = 0.12 + 0.55 * (0.5 + 0.5 * np.cos(2 * np.pi * (hues[:, None] - np.arange(3) / 3)))
    return [(float(r), float(g), float(b)) for r, g, b in channels]


def _plane(half: float, z: float) -> trimesh.Trimesh:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * half + [0, 0, z]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def _sky(directions: Array) -> Array:
    """A bright soft box above, grey walls around, for reflection in mirrors and glass."""
    up = directions[:, 2:3]
    wall = np.array([0.50, 0.52, 0.55]) + 0.12 * np.sin(3 * directions[:, :1] + 1.3)
    lamp = 1 / (1 + np.exp(-30 * (up - 0.75)))
    return wall * (1 - lamp) + lamp * np.array([1.25, 1.22, 1.15])
