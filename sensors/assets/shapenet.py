"""ShapeNetCore as an asset source.

The folder holds one folder per synset, and in it one per model:

- version 2: `<synset>/<model>/models/model_normalized.obj`, up +y, front -z;
- version 1: `<synset>/<model>/model.obj`, up +y, front +x, some models mirrored.

Coordinates are taken as they are, but for centre and scale. They mean no size.
Source of the layout and axes: the read-me of each version and https://shapenet.org/annotations.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sensors.assets.asset import Asset
from sensors.assets.meshfile import read_asset
from sensors.assets.source import SourceOptions, in_split
from std_toolkit.errors import ToolkitError

SYNSETS = {
    "aeroplane": "02691156",
    "bottle": "02876657",
    "bowl": "02880940",
    "camera": "02942699",
    "can": "02946921",
    "car": "02958343",
    "mug": "03797390",
}
_CATEGORY_OF = {synset: category for category, synset in SYNSETS.items()}
_MODELS = ("models/model_normalized.obj", "model.obj")


class ShapeNetSource:
    """The seven categories of a ShapeNetCore folder, as far as they are there.

    Args:
        options: `root` and `split`; one model in five is in the test split, by its name.

    Raises:
        ToolkitError: no such folder, or none of the synsets with a model in it.
    """

    def __init__(self, options: SourceOptions) -> None:
        self._root = options.need_root()
        self._models = {
            category: names
            for category, synset in SYNSETS.items()
            if (names := self._names(synset, options))
        }
        if not self._models:
            raise ToolkitError(
                "no ShapeNetCore model of the seven categories here",
                path=self._root,
                hint=f"expected {SYNSETS['mug']}/<model>/{_MODELS[0]} or .../{_MODELS[1]}",
            )

    def categories(self) -> Sequence[str]:
        return tuple(self._models)

    def sample(self, rng: np.random.Generator, category: str) -> Asset:
        names = self._models.get(category)
        if names is None:
            raise ToolkitError(
                "no model of this category in the folder and split",
                path=self._root,
                field="category",
                value=category,
            )
        return self.load(f"{SYNSETS[category]}-{names[int(rng.integers(len(names)))]}")

    def load(self, asset_id: str) -> Asset:
        synset, _, name = asset_id.partition("-")
        path = self._path(synset, name) if name else None
        if synset not in _CATEGORY_OF or path is None:
            raise ToolkitError(
                "no such model (an id is <synset>-<model>)",
                path=self._root,
                field="id",
                value=asset_id,
            )
        return read_asset(path, asset_id=asset_id, category=_CATEGORY_OF[synset])

    def _names(self, synset: str, options: SourceOptions) -> list[str]:
        folder = self._root / synset
        if not folder.is_dir():
            return []
        return sorted(
            p.name
            for p in folder.iterdir()
            if in_split(p.name, options.split) and self._path(synset, p.name) is not None
        )

    def _path(self, synset: str, name: str) -> Path | None:
        # A name from outside must not lead out of the folder.
        if Path(name).name != name or name in (".", ".."):
            return None
        folder = self._root / synset / name
        return next((folder / m for m in _MODELS if (folder / m).is_file()), None)
