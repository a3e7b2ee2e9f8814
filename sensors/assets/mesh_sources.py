"""Assets from files: a folder of your own meshes, or ShapeNetCore.

By default, sub-folders are categories: `mug/red.obj`, `mug/blue/textured.obj`. A document
`assets.json` in the folder replaces this and sets further properties:

    {"assets": [{"mesh": "scans/red.obj", "category": "mug", "symmetry": "none", "up": "z",
                 "unit": "mm"}]}

A ShapeNetCore folder has one folder per synset, and in it one per model:

- version 2: `<synset>/<model>/models/model_normalized.obj`, up +y, front -z;
- version 1: `<synset>/<model>/model.obj`, up +y, front +x, some models mirrored.

Coordinates are only centred and scaled; they carry no real size.
Source of the layout and axes: the read-me of each version and https://shapenet.org/annotations.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from sensors.assets import asset, asset_source, mesh_file
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import MESH_SUFFIXES, OTHER_MESHES, UNITS_IN_M, UNREAD_MESHES
from std_toolkit.io.documents import read_document
from std_toolkit.scene.document import check_name, check_relative, safe_name

DOCUMENT = "assets.json"

_SYMMETRIES = {"none": asset.NO_SYMMETRY, "axis:y": asset.TURN_Y, "auto": None}

SYNSETS = {
    "aeroplane": "02691156",
    "bottle": "02876657",
    "bowl": "02880940",
    "camera": "02942699",
    "can": "02946921",
    "car": "02958343",
    "mug": "03797390",
}

_MODELS = ("models/model_normalized.obj", "model.obj")


class AssetRow(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One mesh of assets.json.

    Attributes:
        mesh: path relative to the folder.
        category: such as "mug"; any name, "other" for distractors.
        id: safe name; by default built from category and path.
        symmetry: "axis:y" for rotations about the vertical axis, "none", or "auto" to detect it.
        up: vertical axis of the file, "y" or "z".
        unit: "m", "cm" or "mm" if the file has the object's real size; by default the unit that
            the source was opened with.
        material: class of the object's real surface: "raw" (as textured), "diffuse", "transparent"
            or "specular"; by default any that objects of the category may have.
    """

    mesh: str
    category: str
    id: str = ""
    symmetry: Literal["none", "axis:y", "auto"] = "auto"
    up: Literal["y", "z"] = "y"
    unit: Literal["m", "cm", "mm"] | None = None
    material: asset.AssetMaterial | None = None


class AssetList(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """assets.json."""

    assets: list[AssetRow]


class FolderSource:
    """Meshes below a folder.

    Args:
        options: `root`, `split` (one mesh in five is in the test split, by its path) and `unit`.

    Raises:
        ToolkitError: no such folder, no mesh in it, an invalid `assets.json`, or two meshes with
            the same id.
    """

    def __init__(self, options: asset_source.SourceOptions) -> None:
        self._root = options.need_root()
        if options.unit is not None and options.unit not in UNITS_IN_M:
            raise ToolkitError(
                "unknown unit", field="unit", value=options.unit, hint="one of m, cm, mm"
            )
        self._unit = options.unit
        document = self._root / DOCUMENT
        rows = self._listed(document) if document.is_file() else self._found()
        counts = Counter(_id(row) for row in rows)
        twice = [i for i, n in counts.items() if n > 1]
        if twice:
            raise ToolkitError(
                "two meshes would have the same id",
                path=self._root,
                value=twice[0],
                hint=f"give them ids in {DOCUMENT}",
            )
        self._rows = {_id(row): row for row in rows}
        self._ids: dict[str, list[str]] = {}
        for key in sorted(self._rows):
            if asset_source.in_split(self._rows[key].mesh, options.split):
                self._ids.setdefault(self._rows[key].category, []).append(key)
        if not self._ids:
            unread = sorted(p for p in self._root.rglob("*") if p.suffix.lower() in UNREAD_MESHES)
            if not self._rows and unread:
                raise ToolkitError("not a mesh format", path=unread[0], hint=OTHER_MESHES)
            others = f": {len(self._rows)} of the other split" if self._rows else ""
            raise ToolkitError(
                f"no mesh here for the split {options.split!r}{others}",
                path=self._root,
                hint="one mesh in five is for tests, by its path; add meshes, or take that split"
                if self._rows
                else f"expected <category>/*{MESH_SUFFIXES[0]} or a {DOCUMENT}",
            )

    def categories(self) -> Sequence[str]:
        return tuple(sorted(self._ids))

    def sample(self, rng: np.random.Generator, category: str) -> asset.Asset:
        ids = self._ids.get(category)
        if ids is None:
            raise ToolkitError(
                "no mesh of this category in the folder and split",
                path=self._root,
                field="category",
                value=category,
            )
        return self.load(ids[int(rng.integers(len(ids)))])

    def ids(self) -> Sequence[str]:
        """Ids of all meshes, whatever their split."""
        return tuple(sorted(self._rows))

    def load(self, asset_id: str) -> asset.Asset:
        row = self._rows.get(asset_id)
        if row is None:
            raise ToolkitError("no mesh of this id", path=self._root, field="id", value=asset_id)
        read = mesh_file.read_asset(
            self._root / row.mesh,
            asset_id=asset_id,
            category=row.category,
            unit=row.unit or self._unit,
            symmetry=_SYMMETRIES[row.symmetry],
            up=row.up,
        )
        return replace(read, material=row.material)

    def _found(self) -> list[AssetRow]:
        return [
            AssetRow(
                mesh=path.relative_to(self._root).as_posix(),
                category=safe_name(path.relative_to(self._root).parts[0]),
            )
            for path in sorted(self._root.rglob("*"))
            if path.suffix.lower() in MESH_SUFFIXES
            and path.is_file()
            and len(path.relative_to(self._root).parts) > 1
        ]

    def _listed(self, document: Path) -> list[AssetRow]:
        try:
            listed = read_document(document, AssetList)
        except ToolkitError as error:
            raise error.revised(problem=f"not a list of assets: {error.problem}") from error
        for k, row in enumerate(listed.assets):
            check_name(row.category, path=document, field=f"assets[{k}].category")
            check_relative(row.mesh, path=document, field=f"assets[{k}].mesh")
            if row.id:
                check_name(row.id, path=document, field=f"assets[{k}].id")
        return listed.assets


def _id(row: AssetRow) -> str:
    stem = Path(row.mesh).with_suffix("").as_posix()
    return row.id or safe_name(
        stem if stem.startswith(f"{row.category}/") else f"{row.category}_{stem}"
    )


_CATEGORY_OF = {synset: category for category, synset in SYNSETS.items()}


class ShapeNetSource:
    """The seven categories of a ShapeNetCore folder, as far as they exist.

    Args:
        options: `root` and `split`; one model in five is in the test split, by its name.

    Raises:
        ToolkitError: no such folder, or no model of these synsets in it.
    """

    def __init__(self, options: asset_source.SourceOptions) -> None:
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

    def sample(self, rng: np.random.Generator, category: str) -> asset.Asset:
        names = self._models.get(category)
        if names is None:
            raise ToolkitError(
                "no model of this category in the folder and split",
                path=self._root,
                field="category",
                value=category,
            )
        return self.load(f"{SYNSETS[category]}-{names[int(rng.integers(len(names)))]}")

    def load(self, asset_id: str) -> asset.Asset:
        synset, _, name = asset_id.partition("-")
        path = self._path(synset, name) if name else None
        if synset not in _CATEGORY_OF or path is None:
            raise ToolkitError(
                "no such model (an id is <synset>-<model>)",
                path=self._root,
                field="id",
                value=asset_id,
            )
        return mesh_file.read_asset(path, asset_id=asset_id, category=_CATEGORY_OF[synset])

    def _names(self, synset: str, options: asset_source.SourceOptions) -> list[str]:
        folder = self._root / synset
        if not folder.is_dir():
            return []
        return sorted(
            p.name
            for p in folder.iterdir()
            if asset_source.in_split(p.name, options.split)
            and self._path(synset, p.name) is not None
        )

    def _path(self, synset: str, name: str) -> Path | None:
        # A name from a document must not point outside the folder.
        if Path(name).name != name or name in (".", ".."):
            return None
        folder = self._root / synset / name
        return next((folder / m for m in _MODELS if (folder / m).is_file()), None)
