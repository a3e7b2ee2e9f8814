"""Meshes of the library, read once and shared by all threads."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.mesh import round_axis
from std_toolkit.scene import Model

if TYPE_CHECKING:
    import trimesh


# Path of a mesh file in the scene, its size and the time of its last change.
Version = tuple[str, int, int]


class _Entry:
    """One mesh; whoever comes first reads it, others of the same mesh wait."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.read: tuple[trimesh.Trimesh, NDArray[np.float64]] | None = None
        # In a tuple once it was looked for: there may be none.
        self.round_axis: tuple[int | None] | None = None


class MeshLibrary:
    """Meshes by file; a file that changed is read again."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._lock = threading.Lock()
        self._entries: dict[Version, _Entry] = {}

    def mesh(self, model: Model) -> trimesh.Trimesh:
        """Mesh of a model, metres; the caller must not change it.

        Raises:
            ToolkitError: missing, unreadable, or of implausible size.
        """
        return self._read(self._entry(model), model)[0]

    def centre(self, model: Model) -> NDArray[np.float64]:
        """(3,) centre of the bounding box, mesh frame, metres; raises as `mesh`."""
        return self._read(self._entry(model), model)[1]

    def round_axis(self, model: Model) -> int | None:
        """The coordinate axis a mesh is turned about, looked for once; raises as `mesh`."""
        entry = self._entry(model)
        mesh = self._read(entry, model)[0]
        with entry.lock:
            if entry.round_axis is None:
                entry.round_axis = (round_axis(np.asarray(mesh.vertices), np.asarray(mesh.faces)),)
            return entry.round_axis[0]

    def version(self, model: Model) -> Version:
        """What tells the mesh of a model from another one that the same id had before or gets."""
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
