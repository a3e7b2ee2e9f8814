"""What a mesh is called in the library."""

from __future__ import annotations

from pathlib import Path

from std_toolkit.scene.names import safe_name

# Data sets keep each mesh in a folder that has the object's name, under a name like these.
_GENERIC = frozenset(
    ("mesh", "model", "models", "nontextured", "object", "poisson", "scan", "textured", "untitled")
)


def model_name(path: Path) -> str:
    """Id for the model of a mesh file: its name, or that of its folder where it tells nothing."""
    stem, folder = path.stem, path.resolve().parent.name
    words = stem.lower().replace("-", "_").split("_")
    return safe_name(
        folder if folder and all(w in _GENERIC or w.isdigit() for w in words) else stem
    )
