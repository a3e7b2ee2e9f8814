"""Folder of meshes that scenes share: its meshes are in the library of every scene.

A mesh is copied into a scene when it is placed there first.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import MESH_SUFFIXES
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.scene.document import safe_name

if TYPE_CHECKING:
    from annotator.session import Session

# Argument of --meshes that forgets the folder.
NO_FOLDER = "none"

# Levels of folders below the given one that are searched.
_LEVELS = 2

# Of several files of one mesh, the first of these is taken: with textures before without.
_PREFERRED = (".obj", ".glb", ".gltf", ".ply", ".off", ".stl")

_FILE = "meshes.json"


@dataclass(frozen=True)
class FolderMesh:
    """Mesh file of the folder.

    Attributes:
        name: unique in the folder, valid as id of a model.
        path: absolute path of the file.
    """

    name: str
    path: Path


@dataclass(frozen=True)
class MeshFolder:
    """Folder with its meshes, sorted by name."""

    path: Path
    meshes: tuple[FolderMesh, ...]

    @staticmethod
    def read(path: Path | str) -> MeshFolder:
        """List the mesh files in a folder and in two levels of folders below it.

        A mesh has the name of its file. If the name is generic ("textured") or files in other
        folders share it, the mesh has the name of its folder. Several files of one mesh (formats,
        or textured and not) are one entry.

        Raises:
            ToolkitError: there is no such folder, it is unreadable, or has no mesh file.
        """
        root = Path(path).expanduser()
        if not root.is_dir():
            raise ToolkitError(
                "the folder of meshes does not exist",
                field="--meshes",
                path=root,
                hint="give a folder that contains meshes",
            )
        root = root.resolve()
        try:
            files = sorted(_mesh_files(root, _LEVELS))
        except OSError as error:
            raise ToolkitError(f"cannot read the folder of meshes: {error}", path=root) from error
        if not files:
            kinds = ", ".join(s.lstrip(".").upper() for s in MESH_SUFFIXES)
            raise ToolkitError(
                "the folder contains no mesh",
                field="--meshes",
                path=root,
                hint=f"give a folder with {kinds} files, in it or {_LEVELS} folders below",
            )
        return MeshFolder(root, tuple(_named(root, files)))

    def find(self, name: str) -> FolderMesh | None:
        """Return a mesh by name; None if there is none."""
        return next((m for m in self.meshes if m.name == name), None)


@dataclass(frozen=True)
class MeshToPlace:
    """Mesh of the folder and what to do with its model.

    Attributes:
        place: called with the id of the model once it is in the scene.
    """

    mesh: FolderMesh
    place: Callable[[str], object]


def meshes_to_add(folder: MeshFolder | None, session: Session) -> Sequence[FolderMesh]:
    """Return the meshes whose names no model of the scene has; none if the scene is read-only."""
    if folder is None or not session.writable:
        return ()
    known = {m.id for m in session.state.models}
    return [m for m in folder.meshes if m.name not in known]


# --- the remembered folder ------------------------------------------------------------------------


def settings_folder() -> Path:
    """Return the folder of the user's settings."""
    home = os.environ.get("XDG_CONFIG_HOME") or str(Path.home() / ".config")
    return Path(home) / "std-toolkit"


def choose_folder(argument: str | None) -> MeshFolder | None:
    """Return the folder given on the command line, else the remembered one, and remember it.

    Args:
        argument: path; `NO_FOLDER` forgets the remembered folder; None: the remembered one, which
            is ignored where it has no meshes now.

    Raises:
        ToolkitError: the given folder does not exist or contains no mesh.
    """
    if argument == NO_FOLDER:
        remember_folder(None)
        return None
    if argument is not None:
        folder = MeshFolder.read(argument)
        remember_folder(folder)
        return folder
    with suppress(OSError, ValueError, TypeError, KeyError, ToolkitError):
        return MeshFolder.read(json.loads((settings_folder() / _FILE).read_text())["folder"])
    return None


def remember_folder(folder: MeshFolder | None) -> None:
    """Store the folder for later starts; ignores a read-only settings folder."""
    path = settings_folder() / _FILE
    with suppress(ToolkitError, OSError):
        if folder is None:
            path.unlink(missing_ok=True)
        else:
            write_bytes_atomic(path, json.dumps({"folder": str(folder.path)}).encode())


# --- names ----------------------------------------------------------------------------------------


def _mesh_files(folder: Path, levels: int) -> Iterator[Path]:
    for path in folder.iterdir():
        if path.name.startswith("."):
            continue
        if path.is_dir():
            if levels > 0:
                # An unreadable folder among others hides no mesh of theirs.
                with suppress(PermissionError):
                    yield from _mesh_files(path, levels - 1)
        elif path.suffix.lower() in MESH_SUFFIXES:
            yield path


def _named(root: Path, files: Sequence[Path]) -> Iterator[FolderMesh]:
    from annotator.session.requests.mesh_requests import is_generic_name

    by_mesh: dict[tuple[Path, str], list[Path]] = {}
    folders_of: dict[str, set[Path]] = {}
    for path in files:
        folders_of.setdefault(path.stem, set()).add(path.parent)
    for path in files:
        says_nothing = is_generic_name(path.stem) or len(folders_of[path.stem]) > 1
        named_after = path.parent if says_nothing and path.parent != root else None
        key = (path.parent, path.stem) if named_after is None else (named_after, "")
        by_mesh.setdefault(key, []).append(path)
    # models/mug/scan/textured.obj and models/can/scan/textured.obj: the folder says nothing either.
    shared = Counter(folder.name for folder, stem in by_mesh if not stem)
    found = []
    for (folder, stem), paths in by_mesh.items():
        name = stem
        if not stem:
            name = folder.name
            if folder.parent != root and (shared[name] > 1 or is_generic_name(name)):
                name = folder.parent.name
        found.append((safe_name(name), min(paths, key=_rank)))
    taken: set[str] = set()
    for name, path in sorted(found):
        free, number = name, 2
        while free in taken:
            free, number = f"{name}_{number}", number + 1
        taken.add(free)
        yield FolderMesh(free, path)


def _rank(path: Path) -> tuple[bool, bool, int]:
    stem = path.stem.lower()
    plain = "nontextured" in stem
    return plain, "textured" not in stem, _PREFERRED.index(path.suffix.lower())
