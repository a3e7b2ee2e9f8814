"""Thumbnails of meshes, rendered without OpenGL in the background and cached on disk."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from annotator.app import events, mesh_folder, placing, tasks
from annotator.app.controller import Controller
from annotator.session.meshes import Version
from annotator.views.mesh_colors import mesh_colors
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.mesh import load_mesh, mesh_extents, vertex_colors
from std_toolkit.geometry.surface_colors import SurfaceColors
from std_toolkit.geometry.turned_surface import round_axis
from std_toolkit.io.images import read_color, write_color
from std_toolkit.rendering.mesh import RenderMesh, prepare_mesh
from std_toolkit.scene import Model

if TYPE_CHECKING:
    import trimesh

    from annotator.session import Snapshot

# Neutral grey, as the window, to avoid a colour bias.
PAPER = (38, 38, 38)

CLAY = (192, 192, 192)

_SAMPLES = 3

# Longer side of textures, which are drawn some hundred pixels large.
_TEXTURE_PX = 512

# Diameter to which a mesh of unknown unit is scaled, metres.
_DIAMETER_M = 0.1

# A mesh with more faces is drawn with the vertices of each cell of a grid merged.
_MOST_FACES = 200_000

# Cells along its longest side; halved while too many faces remain, as of a noisy scan.
_CELLS = 128

_FOLDER = Path(".std") / "annotate" / "thumbnails"

SIZE_PX = 96


def model_picture(snapshot: Snapshot, model: Model, size: int) -> NDArray[np.uint8] | None:
    """Return the thumbnail of a library model, upright as when placed; None without its mesh.

    Cached in the scene folder if it is writable. Thread-safe.
    """
    try:
        mesh = few_faces(snapshot.meshes.mesh(model))
        axis = placing.standing_axis(snapshot, model)
    except ToolkitError:
        return None  # reported where the mesh itself is drawn
    if snapshot.writable:
        return cached_thumbnail(snapshot.scene.root, mesh, size, axis)
    return thumbnail(mesh, size, axis)


def file_picture(path: Path, size: int) -> NDArray[np.uint8] | None:
    """Return the thumbnail of a mesh file outside the scene, in any unit; None if unreadable.

    Cached in the user's cache folder, by path and modification time. Thread-safe.
    """
    try:
        status = path.stat()
        key = f"{path}\n{status.st_size}\n{status.st_mtime_ns}\n{size}"
        name = hashlib.sha256(key.encode(errors="surrogateescape")).hexdigest()[:32]
        home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
        stored = Path(home) / "std-toolkit" / "thumbnails" / f"{name}.png"
        if stored.is_file():
            with suppress(ToolkitError):  # for example of another size: render again
                return read_color(stored, size=(size, size))
        mesh = few_faces(load_mesh(path, any_size=True))
    except (OSError, ToolkitError):
        return None  # reported when the mesh is added
    mesh.apply_scale(_DIAMETER_M / max(float(np.linalg.norm(mesh_extents(mesh))), 1e-30))
    axis = placing.up_axis(round_axis(np.asarray(mesh.vertices), np.asarray(mesh.faces)))
    picture = thumbnail(mesh, size, axis)
    with suppress(OSError, ToolkitError):  # a read-only folder
        stored.parent.mkdir(parents=True, exist_ok=True)
        write_color(stored, picture)
    return picture


def few_faces(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a coarse copy of a mesh of many faces, which looks the same in a thumbnail."""
    cells = _CELLS
    while len(mesh.faces) > _MOST_FACES and cells >= 32:
        mesh = _merged(mesh, cells)
        cells //= 2
    return mesh


def _merged(mesh: trimesh.Trimesh, cells: int) -> trimesh.Trimesh:
    """Merge the vertices in each cell of a grid, of so many cells along the longest side."""
    import trimesh

    vertices = np.asarray(mesh.vertices)
    low = vertices.min(axis=0)
    cell = ((vertices - low) * (cells / np.ptp(vertices, axis=0).max())).astype(np.int64)
    key = (cell[:, 0] * 2 * cells + cell[:, 1]) * 2 * cells + cell[:, 2]
    _, first, merged = np.unique(key, return_index=True, return_inverse=True)
    faces = merged.reshape(-1)[np.asarray(mesh.faces)]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    colors = vertex_colors(mesh)
    if colors is not None:
        colors = colors[first]
    return trimesh.Trimesh(vertices[first], faces, vertex_colors=colors, process=False)


def thumbnail(mesh: trimesh.Trimesh, size: int, axis: int = 2) -> NDArray[np.uint8]:
    """Render an upright mesh from above its front as (size, size, 3) RGB uint8.

    A mesh with a texture or vertex colours has its colours, another is grey. Takes some tenths of a
    second for 50,000 faces. Thread-safe.

    Args:
        mesh: in metres.
        size: of the picture, pixels.
        axis: the coordinate axis (0, 1, 2) that is up.
    """
    return _thumbnail(mesh, mesh_colors(mesh, largest=_TEXTURE_PX), size, axis)


def cached_thumbnail(
    root: Path, mesh: trimesh.Trimesh, size: int, axis: int = 2
) -> NDArray[np.uint8]:
    """Return `thumbnail`, cached in the scene folder under the mesh's digest if writable."""
    colors = mesh_colors(mesh, largest=_TEXTURE_PX)
    # The style is part of the name, so that thumbnails of earlier versions are not used.
    style = "grey" if colors is None else f"colors-{_digest(colors)[:12]}"
    name = f"{prepare_mesh(mesh).digest[:24]}-{size}-{'xyz'[axis]}-{style}.png"
    path = root / _FOLDER / name
    if path.is_file():
        try:
            return read_color(path, size=(size, size))
        except ToolkitError:  # damaged, or of an earlier version: render again
            pass
    picture = _thumbnail(mesh, colors, size, axis)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_color(path, picture)
    except (OSError, ToolkitError):
        # In a read-only folder thumbnails are shown without caching.
        pass
    return picture


def _thumbnail(
    mesh: trimesh.Trimesh, colors: SurfaceColors | None, size: int, axis: int
) -> NDArray[np.uint8]:
    from std_toolkit.rendering.maps import compose, surface_maps
    from std_toolkit.rendering.raycast import RaycastRenderer
    from std_toolkit.rendering.renderer import PlacedMesh

    prepared = prepare_mesh(mesh)
    large = size * _SAMPLES
    # Ten radii away for weak perspective; the image just contains the bounding sphere.
    radius = prepared.diagonal / 2
    f = 10 * 0.96 * large / 2
    camera = Camera(large, large, f, f, (large - 1) / 2, (large - 1) / 2)
    T_cam_obj = _front_view(prepared, axis, 10 * radius)
    placed = [PlacedMesh(1, prepared, T_cam_obj)]
    drawn = compose(RaycastRenderer(threads=1), camera, placed, canvas=1)
    nocs, normals = surface_maps(camera, placed, drawn)
    if colors is None:
        picture = _shaded(normals, drawn.depth > 0, np.array(CLAY), ambient=0.30, shine=0.10)
    else:
        seen = drawn.depth > 0
        points = (nocs[seen].astype(np.float64) - 0.5) * prepared.diagonal
        paint = np.zeros((large, large, 3))
        paint[seen] = _colors_at(prepared, colors, drawn.face[seen], points)
        picture = _shaded(normals, seen, paint, ambient=0.60, shine=0.0)
    return np.asarray(cv2.resize(picture, (size, size), interpolation=cv2.INTER_AREA), np.uint8)


def _colors_at(
    mesh: RenderMesh, colors: SurfaceColors, face: NDArray[np.integer], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the colours (N, 3) of points (N, 3), relative to the mesh's centre, on faces (N,)."""
    a, b, c = (mesh.vertices[mesh.faces[face, k]] for k in range(3))
    u, v, w = b - a, c - a, points - a
    uu, uv, vv, wu, wv = (
        np.einsum("ni,ni->n", *p) for p in ((u, u), (u, v), (v, v), (w, u), (w, v))
    )
    area = np.maximum(uu * vv - uv * uv, 1e-30)
    weights = np.stack([vv * wu - uv * wv, uu * wv - uv * wu], axis=1) / area[:, None]
    return colors.at(face, np.clip(weights, 0, 1))


def _digest(colors: SurfaceColors) -> str:
    """Return the SHA-256 of the colours of a mesh."""
    digest = hashlib.sha256(np.ascontiguousarray(colors.corners).tobytes())
    if colors.texture is not None:
        digest.update(np.ascontiguousarray(colors.texture).tobytes())
    return digest.hexdigest()


def _front_view(mesh: RenderMesh, axis: int, distance: float) -> SE3:
    R = placing.front_rotation(axis)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle = mesh.centre + (low + high) / 2
    return SE3(R, np.array([0.0, 0.0, distance]) - R @ middle)


def _shaded(
    normals: NDArray[np.floating],
    mask: NDArray[np.bool_],
    paint: NDArray[np.floating] | NDArray[np.integer],
    *,
    ambient: float,
    shine: float,
) -> NDArray[np.uint8]:
    """Shade colours (3,) or (H, W, 3) with a light from the upper left and ambient light."""
    n = np.asarray(normals, dtype=np.float64)
    # Scans have inconsistent winding; visible normals must point to the eye.
    n = n * np.where(n[..., 2:] > 0, -1.0, 1.0)
    light = np.array([-0.45, -0.65, -0.62])
    bright = ambient + (1 - ambient) * np.clip(n @ (light / np.linalg.norm(light)), 0, 1)
    gloss = np.clip(-n[..., 2], 0, 1) ** 24 * shine
    picture = bright[..., None] * paint + 255 * gloss[..., None]
    shaded = np.where(mask[..., None], np.clip(picture, 0, 255), np.array(PAPER))
    return np.asarray(shaded, np.uint8)


class Thumbnails:
    """Renders missing thumbnails of the library one after the other, first of the scene's meshes.

    Args:
        show: called with the available thumbnails by name in the library: (size, size, 3) RGB, or
            None for an unreadable mesh.
        size: pixels.
    """

    def __init__(
        self,
        controller: Controller,
        show: Callable[[dict[str, NDArray[np.uint8] | None]], None],
        *,
        size: int = SIZE_PX,
    ) -> None:
        self._c, self._show, self._size = controller, show, size
        # By mesh, with the set of all meshes, which determines the up axis of boxes.
        self._pictures: dict[Version, tuple[frozenset[Version], NDArray[np.uint8] | None]] = {}
        self._of_files: dict[Path, NDArray[np.uint8] | None] = {}
        self._shown: dict[str, object] = {}
        self._asked_for: tuple[Version, frozenset[Version]] | Path | None = None
        self._unsubscribe = controller.subscribe(self._on_event)
        self._draw_next()

    def close(self) -> None:
        self._unsubscribe()

    def _on_event(self, event: events.Event) -> None:
        if event.kind in ("edited", "library"):
            self._show_all()
            self._draw_next()

    def _draw_next(self) -> None:
        snapshot = self._c.session.snapshot()
        models, meshes = snapshot.state.models, snapshot.meshes
        versions = {m.id: meshes.version(m) for m in models}
        library = frozenset(versions.values())

        def is_missing(model: Model) -> bool:
            drawn, _ = self._pictures.get(versions[model.id], (frozenset(), None))
            return not library <= drawn

        model = next((m for m in models if is_missing(m)), None)
        if model is None:
            self._draw_next_file()
            return
        if self._asked_for == (versions[model.id], library):
            return
        self._asked_for = versions[model.id], library

        def work(_: tasks.Task) -> NDArray[np.uint8] | None:
            return model_picture(snapshot, model, self._size)

        def finish(picture: NDArray[np.uint8] | None) -> None:
            self._pictures[versions[model.id]] = library, picture
            self._show_all()
            self._draw_next()

        self._c.start_aside("Thumbnails", work, finish)

    def _draw_next_file(self) -> None:
        c = self._c
        waiting = (
            m.path
            for m in mesh_folder.meshes_to_add(c.mesh_folder, c.session)
            if m.path not in self._of_files
        )
        path = next(waiting, None)
        if path is None or self._asked_for == path:
            return
        self._asked_for = path

        def work(_: tasks.Task) -> NDArray[np.uint8] | None:
            return file_picture(path, self._size)

        def finish(picture: NDArray[np.uint8] | None) -> None:
            self._of_files[path] = picture
            self._show_all()
            self._draw_next()

        self._c.start_aside("Thumbnails", work, finish)

    def _show_all(self) -> None:
        session = self._c.session
        versions = {m.id: session.meshes.version(m) for m in session.state.models}
        drawn = {i: (v, self._pictures[v][0]) for i, v in versions.items() if v in self._pictures}
        meshes = mesh_folder.meshes_to_add(self._c.mesh_folder, session)
        files = {m.name: m.path for m in meshes if m.path in self._of_files}
        shown: dict[str, object] = {**drawn, **files}
        if shown != self._shown:
            self._shown = shown
            pictures = {i: self._pictures[v][1] for i, (v, _) in drawn.items()}
            self._show(pictures | {name: self._of_files[path] for name, path in files.items()})
