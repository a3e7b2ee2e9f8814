"""What is drawn of a model: its full mesh, a light one for moving, edges; shared by all views."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from vtkmodules.vtkCommonCore import mutable
from vtkmodules.vtkCommonDataModel import vtkPolyData, vtkStaticCellLocator

from annotator.views.surfaces import (
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

Array = NDArray[np.float64]

# Faces of the light mesh: six of them in four views are drawn in software within 50 ms.
LIGHT_FACES = 4000


class Shape:
    """One model.

    Attributes:
        full: its surface as it is.
        light: with a few thousand faces, for moving; the full one until `complete` has made it.
        wire: lines on the full surface: creases, and sections across the three axes. The edges of
            the triangles would be as dense as a solid, and tell less of the form.
        light_wire: the same of the light surface.
        bounds: (2, 3) lowest and highest corner, mesh frame, metres.
    """

    def __init__(self, full: Surface, bounds: Array) -> None:
        self.full = self.light = full
        self.wire = self.light_wire = vtkPolyData()
        self.bounds = bounds

    def complete(self) -> None:
        """Make what is not needed to draw it for the first time; takes most of the time."""
        self.wire = self.light_wire = _wire(self.full, self.bounds)
        light = lighter(self.full.polydata, LIGHT_FACES)
        if light is not self.full.polydata:
            surface = Surface(with_normals(light))
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
        """Where a ray meets the full mesh first.

        Args:
            origin, direction: (3,) mesh frame.

        Returns:
            How many times `direction` away, and the point (3,); None if it misses.
        """
        middle = float(np.linalg.norm(self.centre - origin))
        reach = (middle + 2 * self.radius) / float(np.linalg.norm(direction))
        # References as VTK fills them; its stubs know only numbers.
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
    """Shape of a mesh in metres, which is still to be completed."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    full = triangles(vertices, faces)
    used = vertices[np.unique(faces)] if len(faces) else np.zeros((1, 3))
    bounds = np.stack([used.min(axis=0), used.max(axis=0)]).astype(np.float64)
    return Shape(Surface(with_normals(full)), bounds)


def _wire(surface: Surface, bounds: Array) -> vtkPolyData:
    return lines(np.concatenate([surface.creases(), sections(surface, bounds)]))


class ShapeStore:
    """The shapes of a session's models, made when they are first asked for.

    Args:
        mesh: mesh of a model by id; may be called in another thread.
        background: make them in a thread: `get` answers None until a shape is ready.
    """

    def __init__(self, mesh: Callable[[str], trimesh.Trimesh], *, background: bool = False) -> None:
        self._mesh = mesh
        self._shapes: dict[str, Shape] = {}
        self._making: dict[str, Future[Shape]] = {}
        self._completing: list[Future[None]] = []
        self._failed: set[str] = set()
        self._problems: dict[str, ToolkitError] = {}
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="meshes") if background else None

    def get(self, model_id: str) -> Shape | None:
        """The shape; None if it is still being made or its mesh cannot be read."""
        if model_id in self._shapes or model_id in self._failed:
            return self._shapes.get(model_id)
        if self._pool is None:
            self._finish(model_id, lambda: make_shape(self._mesh(model_id)))
        elif model_id not in self._making:
            self._making[model_id] = self._pool.submit(lambda: make_shape(self._mesh(model_id)))
        return self._shapes.get(model_id)

    def collect(self) -> bool:
        """Take over what the thread has finished; True if something looks different now."""
        done = [m for m, future in self._making.items() if future.done()]
        for model_id in done:
            self._finish(model_id, self._making.pop(model_id).result)
        before = len(self._completing)
        self._completing = [f for f in self._completing if not f.done()]
        return bool(done) or (before > 0 and not self._completing)

    @property
    def pending(self) -> bool:
        """Some shape is still being made or completed."""
        return bool(self._making or self._completing)

    def problems(self) -> dict[str, ToolkitError]:
        """Models whose mesh cannot be read, each told once."""
        problems, self._problems = self._problems, {}
        return problems

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)

    def _finish(self, model_id: str, result: Callable[[], Shape]) -> None:
        try:
            shape = self._shapes[model_id] = result()
        except ToolkitError as error:
            self._failed.add(model_id)
            self._problems[model_id] = error
            return
        if self._pool is None:
            shape.complete()
        else:
            # After the shapes that wait to be seen at all.
            self._completing.append(self._pool.submit(shape.complete))
