"""What a mesh is called in the library."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
from pathlib import Path

from std_toolkit.scene.names import safe_name

# Data sets keep each mesh in a folder that has the object's name, under a name like these.
_GENERIC = frozenset(
    ("mesh", "model", "models", "nontextured", "object", "poisson", "scan", "textured", "untitled")
)


def model_names(path: Path) -> Iterator[str]:
    """Ids for the model of a mesh file, the best first: its name, or its folder's; then numbered.

    Endless, so that there is a free one.
    """
    stem, folder = path.stem, path.resolve().parent.name
    words = stem.lower().replace("-", "_").split("_")
    name = safe_name(
        folder if folder and all(w in _GENERIC or w.isdigit() for w in words) else stem
    )
    yield name
    for number in count(2):
        yield f"{name}_{number}"
