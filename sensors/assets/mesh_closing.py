"""Closing the holes of a scanned mesh: glass needs a surface with an inside.

A hole is closed by a fan of triangles around the middle of its rim. Only caps that hardly change
what cameras see are made: small ones, and those that face the table. The opening of a bowl that is
one triangle thick is none of them: such a mesh stays open, with the reason.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.obj_texture import CORNER_UV
from std_toolkit.settings import NOT_RECORDED, Settings, limit

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Loop = list[int]


@dataclass(frozen=True, kw_only=True)
class ClosingSettings(Settings):
    """Which holes of a mesh are closed."""

    small: float = limit(0.02, source=NOT_RECORDED)
    """largest share of the surface that a cap in view may add"""
    facing: float = limit(0.7, source="within 45 degrees")
    """smallest cosine between the normal of a cap and the direction to the table"""


@dataclass(frozen=True, eq=False)
class Closing:
    """A mesh with its holes closed as far as possible.

    Attributes:
        mesh: the mesh itself where nothing was changed.
        caps: number of holes closed.
        problem: why it is still open; "" if it is closed.
    """

    mesh: trimesh.Trimesh
    caps: int = 0
    problem: str = ""


def close_mesh(mesh: trimesh.Trimesh, down: Sequence[Array] = ()) -> Closing:
    """Close the holes of a mesh.

    Colours and textures stay; a cap has the colour of its rim. Faces are turned outwards. A mesh
    that stays open is returned unchanged.

    Args:
        mesh: vertices in metres.
        down: (3,) unit vectors to the table, mesh frame, of each pose of the object.
    """
    import trimesh

    faces = np.asarray(mesh.faces, np.int64)
    places, place_of = np.unique(np.asarray(mesh.vertices), axis=0, return_inverse=True)
    corners = place_of.reshape(-1)[faces]
    if not trimesh.Trimesh(places, corners, process=False).is_winding_consistent:
        turned = trimesh.Trimesh(places, corners, process=False)
        trimesh.repair.fix_winding(turned)
        flip = (np.asarray(turned.faces) != corners).any(axis=1)
        faces = np.where(flip[:, None], faces[:, ::-1], faces)
        corners = place_of.reshape(-1)[faces]
    loops, problem = _rims(corners)
    area = float(_areas(places, corners).sum())
    inside_out = _volume(places, corners) + sum(_cap_volume(places[loop]) for loop in loops) < 0
    limits = ClosingSettings.current()
    for loop in () if problem else loops:
        normal = _cap_normal(places[loop]) * (-1 if inside_out else 1)
        size = float(np.linalg.norm(normal))
        under = bool(down) and all(normal @ d >= limits.facing * size for d in down)
        if size > limits.small * area and not under:
            share = 100 * size / max(area, 1e-12)
            problem = f"an opening of {share:.0f} % of its surface is in view"
            break
    if problem:
        return Closing(mesh, 0, problem)
    caps = [_fan(places[loop]) for loop in loops]
    same = not caps and np.array_equal(faces, mesh.faces) and not inside_out
    if same:
        return Closing(mesh)
    first = np.full(len(places), -1)
    first[place_of.reshape(-1)[::-1]] = np.arange(len(mesh.vertices))[::-1]
    sources = [first[loop] for loop in loops]
    return Closing(_joined(mesh, faces, caps, sources, flip=inside_out), len(loops))


def _rims(corners: NDArray[np.int64]) -> tuple[list[Loop], str]:
    """Rims of the holes as loops of vertices, each in the direction of the faces along it."""
    edges = corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges = edges[edges[:, 0] != edges[:, 1]]
    low, high = edges.min(axis=1), edges.max(axis=1)
    keys, at = np.unique(np.stack([low, high], axis=1), axis=0, return_inverse=True)
    net = np.bincount(
        at.reshape(-1), np.where(edges[:, 0] < edges[:, 1], 1, -1), minlength=len(keys)
    ).astype(int)
    if (np.abs(net) > 1).any():
        return [], "its faces do not agree on an outside"
    following: dict[int, list[int]] = defaultdict(list)
    for (a, b), sign in zip(keys[net != 0].tolist(), net[net != 0].tolist(), strict=True):
        start, end = (a, b) if sign > 0 else (b, a)
        following[start].append(end)
    loops: list[Loop] = []
    # At every vertex as many open edges arrive as leave: each walk returns.
    while following:
        path: Loop = [next(iter(following))]
        place = {path[0]: 0}
        while path:
            here = path[-1]
            if here not in following:
                break
            after = following[here].pop()
            if not following[here]:
                del following[here]
            if after in place:  # a loop; what lies before it goes on
                begin = place[after]
                loops.append(path[begin:])
                for vertex in path[begin + 1 :]:
                    del place[vertex]
                path = path[: begin + 1]
            else:
                place[after] = len(path)
                path.append(after)
    return loops, ""


def _cap_normal(rim: Array) -> Array:
    """Normal of the cap of a rim, as long as its area."""
    middle = rim.mean(axis=0)
    a, b = rim - middle, np.roll(rim, -1, axis=0) - middle
    return np.asarray(np.cross(b, a).sum(axis=0) / 2)


def _fan(rim: Array) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (the rim's, then the middle) and faces of a cap."""
    count = len(rim)
    here = np.arange(count)
    around = np.roll(here, -1)
    faces = np.stack([around, here, np.full(count, count)], axis=1)
    return np.vstack([rim, rim.mean(axis=0)]), faces


def _areas(vertices: Array, faces: NDArray[np.int64]) -> Array:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


def _volume(vertices: Array, faces: NDArray[np.int64]) -> float:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def _cap_volume(rim: Array) -> float:
    vertices, faces = _fan(rim)
    return _volume(vertices, faces)


def _joined(
    mesh: trimesh.Trimesh,
    faces: NDArray[np.int64],
    caps: list[tuple[Array, NDArray[np.int64]]],
    sources: list[NDArray[np.int64]],
    *,
    flip: bool,
) -> trimesh.Trimesh:
    """The mesh with its caps, colours and texture.

    Args:
        sources: for each cap, the vertices of the mesh at its rim.
    """
    import trimesh

    count, kept = len(mesh.vertices), len(faces)
    turned = (faces != np.asarray(mesh.faces)).any(axis=1)
    vertices, every = [np.asarray(mesh.vertices)], [faces]
    rows = [np.arange(count)]  # whose colour each vertex has
    for (points, fan), rim in zip(caps, sources, strict=True):
        every.append(fan + count)
        vertices.append(points)
        # One place of the texture for the whole cap: between rims a texture is of something else.
        rows.append(np.full(len(points), rim[0]) if _textured(mesh) else np.append(rim, rim[0]))
        count += len(points)
    row, joined = np.concatenate(rows), np.concatenate(every)
    uv = np.asarray(mesh.face_attributes.get(CORNER_UV, ()))
    if len(uv) == kept:
        uv = np.where(turned[:, None, None], uv[:, ::-1], uv)
        at = {int(v): uv[f, c] for f, face in enumerate(faces) for c, v in enumerate(face)}
        more = [at[int(rim[0])] for (_, fan), rim in zip(caps, sources, strict=True) for _ in fan]
        uv = np.concatenate([uv, np.repeat(np.reshape(more, (-1, 1, 2)), 3, axis=1)])
    if flip:
        joined = joined[:, ::-1]
        uv = uv[:, ::-1] if len(uv) else uv
    visual: Any = mesh.visual
    made = trimesh.Trimesh(np.concatenate(vertices), joined, process=False)
    if visual.kind == "texture" and visual.uv is not None and len(visual.uv):
        made.visual = trimesh.visual.TextureVisuals(uv=visual.uv[row], material=visual.material)
    elif visual.kind == "vertex":
        made.visual = trimesh.visual.ColorVisuals(made, vertex_colors=visual.vertex_colors[row])
    elif visual.kind == "face":
        whole = visual.face_colors
        first = {int(v): f for f, face in enumerate(faces) for v in face}
        more = [
            first[int(rim[0])] for (_, fan), rim in zip(caps, sources, strict=True) for _ in fan
        ]
        chosen = whole[np.concatenate([np.arange(kept), more]).astype(int)]
        made.visual = trimesh.visual.ColorVisuals(made, face_colors=chosen)
    if len(uv):
        made.face_attributes[CORNER_UV] = uv
    return made


def _textured(mesh: trimesh.Trimesh) -> bool:
    visual: Any = mesh.visual
    return bool(visual.kind == "texture")
