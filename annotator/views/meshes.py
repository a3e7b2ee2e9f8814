"""Render meshes of models, shared by all views: full mesh, decimated mesh for motion, edges."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from vtkmodules.vtkCommonCore import mutable
from vtkmodules.vtkCommonDataModel import vtkPolyData, vtkStaticCellLocator

from annotator.views.mesh_colors import baked_mesh, colored_mesh, mesh_colors
from annotator.views.triangles import (
    Surface,
    lighter,
    lines,
    sections,
    triangles,
    with_normals,
)
from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    import trimesh

    from std_toolkit.scene import Model

Array = NDArray[np.float64]

# Faces of the light mesh: software rendering draws six of them in four views within 50 ms.
LIGHT_FACES = 2500


class Shape:
    """Render meshes of one model.

    Attributes:
        full: full-resolution surface.
        light: surface with a few thousand faces, for motion; the full one until `complete` is done.
        wire: lines on the full surface: creases, and sections across the three axes. Triangle edges
            are too dense to show the shape.
        light_wire: the same for the light surface.
        bounds: (2, 3) lowest and highest corner, mesh frame, metres.
    """

    def __init__(self, full: Surface, bounds: Array, mesh: trimesh.Trimesh | None = None) -> None:
        self.full = self.light = full
        self._mesh = mesh
        self.wire = self.light_wire = vtkPolyData()
        self.bounds = bounds

    def complete(self) -> None:
        """Compute the parts not needed for the first drawing, which take most of the time."""
        mesh, self._mesh = self._mesh, None
        colors = None if mesh is None else mesh_colors(mesh)
        if colors is not None:
            self.full.colored = colored_mesh(self.full.polydata, colors)
        self.wire = self.light_wire = _wire(self.full, self.bounds)
        if self.full.faces > LIGHT_FACES:
            # Of single vertices: decimation opens a mesh along creases and seams, where they are
            # doubled, and its silhouette would show the cracks.
            light = lighter(triangles(*self.full.corners), LIGHT_FACES)
            surface = Surface(with_normals(light))
            if mesh is not None and colors is not None:
                surface.colored = baked_mesh(surface.polydata, mesh.vertices, mesh.faces, colors)
            self.light_wire = _wire(surface, self.bounds)
            self.light = surface

    @property
    def centre(self) -> Array:
        """(3,) centre of the bounding box."""
        middle: Array = self.bounds.mean(axis=0)
        return middle

    @cached_property
    def corners(self) -> Array:
        """(8, 3) corners of the bounding box."""
        grid = np.stack(np.meshgrid(*self.bounds.T, indexing="ij"), axis=-1)
        return grid.reshape(8, 3)

    @property
    def radius(self) -> float:
        """Half the diagonal of the bounding box, metres."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]) / 2)

    @cached_property
    def _locator(self) -> vtkStaticCellLocator:
        locator = vtkStaticCellLocator()
        locator.SetDataSet(self.full.polydata)
        locator.BuildLocator()
        return locator

    def hit(self, origin: Array, direction: Array) -> tuple[float, Array] | None:
        """Return the first intersection of a ray with the full mesh.

        Args:
            origin, direction: (3,) mesh frame.

        Returns:
            Multiple of `direction`, and the point (3,); None if the ray misses.
        """
        middle = float(np.linalg.norm(self.centre - origin))
        reach = (middle + 2 * self.radius) / float(np.linalg.norm(direction))
        # Reference arguments filled by VTK; its stubs declare plain numbers.
        t: Any = mutable(0.0)
        cell: Any = mutable(0)
        sub: Any = mutable(0)
        point, local = [0.0] * 3, [0.0] * 3
        end = origin + direction * reach
        found = self._locator.IntersectWithLine(
            origin.tolist(), end.tolist(), 1e-12, t, point, local, sub, cell
        )
        if not found:
            return None
        return float(t) * reach, np.asarray(point, dtype=np.float64)


def make_shape(mesh: trimesh.Trimesh) -> Shape:
    """Return the shape of a mesh in metres; `complete` must be called later."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    full = triangles(vertices, faces)
    used = vertices[np.unique(faces)] if len(faces) else np.zeros((1, 3))
    bounds = np.stack([used.min(axis=0), used.max(axis=0)]).astype(np.float64)
    return Shape(Surface(with_normals(full)), bounds, mesh)


def _wire(surface: Surface, bounds: Array) -> vtkPolyData:
    return lines(np.concatenate([surface.creases(), sections(surface, bounds)]))


@dataclass
class _Entry:
    """Cache entry of a model: its document, mesh and shape."""

    model: Model
    mesh: trimesh.Trimesh | None = None
    shape: Shape | None = None


class ShapeStore:
    """The shapes of a session's models, computed on first use.

    The mesh of a model id may change, for example when an import is undone and repeated with
    another unit. A changed model is read again, and its old shape is dropped.

    Args:
        mesh: returns the mesh of a model by id, the same object while its file is unchanged; may be
            called in another thread.
        background: compute shapes in a thread: `get` returns None until a shape is ready.
    """

    def __init__(self, mesh: Callable[[str], trimesh.Trimesh], *, background: bool = False) -> None:
        self._mesh = mesh
        self._entries: dict[str, _Entry] = {}
        self._making: dict[str, tuple[_Entry, Future[_Entry]]] = {}
        self._completing: list[Future[None]] = []
        self._problems: dict[str, ToolkitError] = {}
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="meshes") if background else None

    def get(self, model: Model) -> Shape | None:
        """Return the shape; None if it is still being computed or its mesh is unreadable."""
        known = self._entries.get(model.id)
        if known is None or known.model is not model:
            known = self._begin(model, known)
        return known.shape

    def collect(self) -> bool:
        """Collect results of the thread; True if a shape has changed."""
        done = [m for m, (_, future) in self._making.items() if future.done()]
        new = False
        for model_id in done:
            entry, future = self._making.pop(model_id)
            new |= self._finish(entry, future.result)
        before = len(self._completing)
        self._completing = [f for f in self._completing if not f.done()]
        return new or (before > 0 and not self._completing)

    @property
    def pending(self) -> bool:
        """Whether some shape is still being computed or completed."""
        return bool(self._making or self._completing)

    def problems(self) -> dict[str, ToolkitError]:
        """Return errors of models with unreadable meshes, each reported once."""
        problems, self._problems = self._problems, {}
        return problems

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)

    def _begin(self, model: Model, before: _Entry | None) -> _Entry:
        entry = self._entries[model.id] = _Entry(model)
        if before is not None and _alike(before.model, model):
            # Most likely only category or symmetry has changed: keep the shape.
            entry.mesh, entry.shape = before.mesh, before.shape
        known = _Entry(model, entry.mesh, entry.shape)
        if self._pool is None:
            self._finish(entry, lambda: self._made(known))
        else:
            self._making[model.id] = entry, self._pool.submit(self._made, known)
        return entry

    def _made(self, known: _Entry) -> _Entry:
        """Return the entry with the current mesh; keeps its shape if the mesh is unchanged."""
        mesh = self._mesh(known.model.id)
        if mesh is known.mesh and known.shape is not None:
            return known
        return _Entry(known.model, mesh, make_shape(mesh))

    def _finish(self, entry: _Entry, result: Callable[[], _Entry]) -> bool:
        """Store a result; True if the shape has changed."""
        before = entry.shape
        try:
            found = result()
        except ToolkitError as error:
            entry.shape = None
            self._problems[entry.model.id] = error
            return True
        entry.mesh, entry.shape = found.mesh, found.shape
        if entry.shape is before or entry.shape is None:
            return False
        if self._pool is None:
            entry.shape.complete()
        else:
            # Queued after the shapes that are not yet visible.
            self._completing.append(self._pool.submit(entry.shape.complete))
        return True


def _alike(one: Model, other: Model) -> bool:
    """Whether the documents of two models describe the same mesh."""
    return (one.mesh, one.size_m, one.diameter_m) == (other.mesh, other.size_m, other.diameter_m)
