"""Thread-safe cache of the library meshes."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.turned_surface import round_axis
from std_toolkit.scene import Model

if TYPE_CHECKING:
    import trimesh


# Path of a mesh file in the scene, its size and modification time.
Version = tuple[str, int, int]


class _Entry:
    """One mesh; the first thread reads it while others wait."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.read: tuple[trimesh.Trimesh, NDArray[np.float64]] | None = None
        # A tuple once computed, because the axis itself may be None.
        self.round_axis: tuple[int | None] | None = None


class MeshLibrary:
    """Meshes by file; a changed file is read again."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._lock = threading.Lock()
        self._entries: dict[Version, _Entry] = {}

    def mesh(self, model: Model) -> trimesh.Trimesh:
        """Return the mesh of a model, metres; the caller must not modify it.

        Raises:
            ToolkitError: the file is missing or unreadable, or the size is implausible.
        """
        return self._read(self._entry(model), model)[0]

    def centre(self, model: Model) -> NDArray[np.float64]:
        """Return the (3,) centre of the bounding box, mesh frame, metres; raises as `mesh`."""
        return self._read(self._entry(model), model)[1]

    def round_axis(self, model: Model) -> int | None:
        """Return the rotation axis of a round mesh, cached, or None; raises as `mesh`."""
        entry = self._entry(model)
        mesh = self._read(entry, model)[0]
        with entry.lock:
            if entry.round_axis is None:
                entry.round_axis = (round_axis(np.asarray(mesh.vertices), np.asarray(mesh.faces)),)
            return entry.round_axis[0]

    def version(self, model: Model) -> Version:
        """Return a key that changes if the mesh file of the model id changes."""
        try:
            status = (self._root / model.mesh).stat()
        except OSError:
            return model.mesh, -1, -1
        return model.mesh, status.st_size, status.st_mtime_ns

    def _entry(self, model: Model) -> _Entry:
        with self._lock:
            return self._entries.setdefault(self.version(model), _Entry())

    def _read(self, entry: _Entry, model: Model) -> tuple[trimesh.Trimesh, NDArray[np.float64]]:
        from std_toolkit.geometry.mesh import load_mesh, mesh_bounds

        with entry.lock:
            if entry.read is None:
                mesh = load_mesh(self._root / model.mesh)
                entry.read = mesh, mesh_bounds(mesh).mean(axis=0)
            return entry.read
