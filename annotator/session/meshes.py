"""Meshes of the library, read once and shared by all threads."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from std_toolkit.scene import Model

if TYPE_CHECKING:
    import trimesh


class _Entry:
    """One mesh; whoever comes first reads it, others of the same mesh wait."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.read: tuple[trimesh.Trimesh, NDArray[np.float64]] | None = None


class MeshLibrary:
    """Meshes by file; a file that changed is read again."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._lock = threading.Lock()
        self._entries: dict[tuple[str, int, int], _Entry] = {}

    def mesh(self, model: Model) -> trimesh.Trimesh:
        """Mesh of a model, metres; the caller must not change it.

        Raises:
            ToolkitError: missing, unreadable, or of implausible size.
        """
        return self._load(model)[0]

    def centre(self, model: Model) -> NDArray[np.float64]:
        """(3,) centre of the bounding box, mesh frame, metres; raises as `mesh`."""
        return self._load(model)[1]

    def _load(self, model: Model) -> tuple[trimesh.Trimesh, NDArray[np.float64]]:
        from std_toolkit.geometry.mesh import load_mesh, mesh_bounds

        path = self._root / model.mesh
        try:
            status = path.stat()
            key = (model.mesh, status.st_size, status.st_mtime_ns)
        except OSError:
            key = (model.mesh, -1, -1)  # load_mesh says what is wrong
        with self._lock:
            entry = self._entries.setdefault(key, _Entry())
        with entry.lock:
            if entry.read is None:
                mesh = load_mesh(path)
                entry.read = mesh, mesh_bounds(mesh).mean(axis=0)
            return entry.read
