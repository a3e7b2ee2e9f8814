"""Scenes that poses may be carried over from: those of the project, and those beside a scene."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import read_document
from std_toolkit.project.record import FILE, SECOND, Project
from std_toolkit.scene.model import Labels, ObjectTable

# Folders with more entries are not searched to their end.
_MOST_ENTRIES = 400


@dataclass(frozen=True)
class NearbyScene:
    """A labelled scene.

    Attributes:
        folder: its folder.
        labelled: number of labelled objects.
        common: how many of them have a mesh of the scene that it was searched for.
    """

    folder: Path
    labelled: int
    common: int


def nearby_scenes(root: Path, objects: ObjectTable) -> list[NearbyScene]:
    """Labelled scenes of the projects of a scene, and beside it; most common objects first.

    Of a copy that is labelled a second time, blind, only the other scenes of its project count.
    What cannot be read is left out.

    Args:
        root: folder of the scene.
        objects: its models and objects.
    """
    here = root.resolve()
    folders = list(_folders(here))
    own = {m.id for m in objects.models}
    found = []
    for folder in dict.fromkeys(folders):
        with suppress(ToolkitError, OSError):
            labels = read_document(folder / "labels.json", Labels)
            table = read_document(folder / "objects.json", ObjectTable)
            models = [table.object(x.object).model for x in labels.labels]
            common = sum(model in own for model in models) if own else len(models)
            if models:
                found.append(NearbyScene(folder, len(models), common))
    return sorted(found, key=lambda s: (-s.common, s.folder.name))


def _folders(here: Path) -> Iterator[Path]:
    """Folders of scenes, without this one and without the one that it is a blind copy of."""
    blind = here.parent.name == SECOND and (here.parent.parent / FILE).is_file()
    known = {here}
    for project in _projects(here):
        for scene in project.record.scenes:
            folder = project.folder(scene).resolve()
            if blind and scene.name == here.name:
                known.add(folder)
            elif folder not in known:
                yield folder
    if not blind:
        for folder in _entries(here.parent):
            if folder.resolve() not in known and (folder / "scene.json").is_file():
                yield folder.resolve()


def _projects(here: Path) -> Iterator[Project]:
    """Projects that list a scene: its parents, and the folders beside them."""
    places = [here.parent, here.parent.parent]
    places += [folder for place in tuple(places) for folder in _entries(place)]
    for place in dict.fromkeys(places):
        if not (place / FILE).is_file():
            continue
        with suppress(ToolkitError):
            project = Project.open(place)
            listed = [project.folder(s).resolve() for s in project.record.scenes]
            listed += [project.second(s).resolve() for s in project.record.scenes]
            if here in listed:
                yield project


def _entries(folder: Path) -> list[Path]:
    with suppress(OSError):
        return sorted(p for p in islice(folder.iterdir(), _MOST_ENTRIES) if p.is_dir())
    return []
