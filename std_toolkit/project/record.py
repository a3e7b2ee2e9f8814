"""project.json: the scenes, people and rules of a project; created and extended here.

Scenes stay ordinary scenes: nothing in them names the project.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from std_toolkit.errors import ToolkitError, listed
from std_toolkit.io.atomic import sweep_temporaries
from std_toolkit.io.documents import read_document, write_document
from std_toolkit.io.locks import hold_lock
from std_toolkit.scene.document import Count, Document, check_name, check_unique, safe_name
from std_toolkit.scene.review import Person
from std_toolkit.scene.scene import Scene

FILE = "project.json"
SECOND = "second"
LIBRARY = "library"


class ProjectScene(Document, frozen=True, kw_only=True):
    """A scene of a project.

    Attributes:
        name: unique in the project: name of its folder.
        path: of the folder, relative to the project where it lies in it or beside it, else
            absolute; parts are separated by "/".
    """

    name: str
    path: Annotated[str, msgspec.Meta(min_length=1, max_length=4096)]

    def check(self) -> None:
        check_name(self.name)


class Rules(Document, frozen=True, kw_only=True):
    """What is due in a project, besides what always holds; see data_spec.md.

    Attributes:
        twice_every: k: every k-th scene is labelled a second time, blind; 0 for none.
    """

    twice_every: Count = 10


class ProjectRecord(Document, frozen=True, kw_only=True):
    """project.json: the scenes in the order in which they were added.

    Attributes:
        name: of the project.
        scenes: none is ever moved, because the rule `twice_every` counts them.
        people: names or initials as in the labels (`annotator`).
        library: folder of the shared meshes, relative to the project.
        rules: see `Rules`.
    """

    format: Literal["std-toolkit-project"] = "std-toolkit-project"
    version: Literal[1] = 1
    name: str
    scenes: list[ProjectScene] = msgspec.field(default_factory=list)
    people: list[Person] = msgspec.field(default_factory=list)
    library: Literal["library"] = "library"
    rules: Rules = Rules()

    def check(self) -> None:
        check_name(self.name)
        check_unique([s.name for s in self.scenes], "scenes", "name")
        check_unique(self.people, "people", "name")
        for i, person in enumerate(self.people):
            if person != " ".join(person.split()) or not person.isprintable() or "," in person:
                problem = "a name has no commas, line breaks or spaces at its ends"
                raise ToolkitError(problem, field=f"people[{i}]", value=person)


@dataclass(frozen=True)
class Project:
    """A project on disk.

    Attributes:
        root: its folder.
        record: project.json.
    """

    root: Path
    record: ProjectRecord

    @staticmethod
    def open(root: Path) -> Project:
        """Read project.json.

        Raises:
            ToolkitError: the folder has no project, or the document breaks its schema.
        """
        if not (root / FILE).is_file():
            raise ToolkitError(
                f"no project here ({FILE} is missing)",
                path=root,
                hint="make one with `std-curate project create`",
            )
        return Project(root, read_document(root / FILE, ProjectRecord))

    def folder(self, scene: ProjectScene) -> Path:
        """Folder of a scene."""
        folder = self.root / scene.path
        plain = Path(os.path.normpath(folder))
        # Not the same folder where the project is reached by a link.
        return plain if plain.resolve() == folder.resolve() else folder

    def second(self, scene: ProjectScene) -> Path:
        """Folder of the copy that is labelled a second time."""
        return self.root / SECOND / scene.name

    def is_twice(self, scene: ProjectScene) -> bool:
        """Whether the rules want a scene labelled twice: every k-th of the list."""
        every = self.record.rules.twice_every
        return every > 0 and (self.record.scenes.index(scene) + 1) % every == 0

    def find(self, given: str) -> ProjectScene:
        """The scene that a user names by its name or its folder.

        Raises:
            ToolkitError: the project has no such scene.
        """
        for scene in self.record.scenes:
            if given == scene.name or Path(given).resolve() == self.folder(scene).resolve():
                return scene
        names = [scene.name for scene in self.record.scenes]
        raise ToolkitError(
            "the project has no such scene",
            path=self.root,
            value=given,
            hint=f"one of {listed(names, 8)}" if names else "add it with `std-curate project add`",
        )

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the project for a change of its own files.

        Raises:
            ToolkitError: the folder is read-only.
        """
        with hold_lock(
            self.root, "lock", doing="writing to", what="project", wait=True, deep=False
        ):
            yield


def create_project(
    root: Path, *, scenes: Sequence[Path] = (), people: Sequence[str] = (), rules: Rules | None
) -> tuple[Project, list[ToolkitError]]:
    """Write project.json into a folder that has none; the folder may hold other files.

    Args:
        root: the folder, made if it does not exist; a scene cannot be a project, too.
        scenes: folders of scenes.
        people: names or initials.
        rules: None for the default ones.

    Returns:
        The project, and an error for each folder that is no scene; nothing was written if there
        is one.

    Raises:
        ToolkitError: there is a project here already, or a person is named twice.
    """
    if (root / FILE).exists() or (root / FILE).is_symlink():
        raise ToolkitError(
            "there is a project here already",
            path=root,
            hint="add scenes and people with `std-curate project add`",
        )
    if (root / "scene.json").exists():
        problem = "a scene is no project"
        raise ToolkitError(problem, path=root, hint="choose the folder above it")
    record = ProjectRecord(
        name=safe_name(root.resolve().name), people=list(people), rules=rules or Rules()
    )
    project = Project(root, record)
    found, problems = _found(project, scenes)
    if problems:
        return project, problems
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ToolkitError(f"cannot make the folder: {error.strerror}", path=root) from error
    with project.locked():
        if (root / FILE).exists():  # another process was first
            raise ToolkitError("there is a project here already", path=root)
        return _saved(project, [*found], [*people]), []


def extend_project(
    project: Project,
    *,
    scenes: Sequence[Path] = (),
    people: Sequence[str] = (),
    twice_every: int | None = None,
) -> tuple[Project, list[ToolkitError]]:
    """Add scenes and people to a project, at the end of its lists.

    Args:
        project: the project.
        scenes, people: see `create_project`.
        twice_every: replaces the rule; None keeps it.

    Returns:
        The project with the additions, and an error for each folder that is no scene; nothing was
        written if there is one.

    Raises:
        ToolkitError: a scene or person is in the project already, or it cannot be written to.
    """
    with project.locked():
        project = Project.open(project.root)  # others may have added something
        sweep_temporaries_of(project)
        found, problems = _found(project, scenes)
        if problems:
            return project, problems
        if twice_every is not None:
            rules = msgspec.structs.replace(project.record.rules, twice_every=twice_every)
            project = Project(project.root, msgspec.structs.replace(project.record, rules=rules))
        return _saved(
            project, [*project.record.scenes, *found], [*project.record.people, *people]
        ), []


def sweep_temporaries_of(project: Project) -> None:
    """Remove what killed writers left of files of the project itself, not of its scenes."""
    for path in project.root.glob(".project.*.tmp.json"):
        path.unlink(missing_ok=True)
    if (project.root / ".std").is_dir():
        sweep_temporaries(project.root / ".std")


def _saved(project: Project, scenes: list[ProjectScene], people: list[str]) -> Project:
    record = msgspec.structs.replace(project.record, scenes=scenes, people=people)
    write_document(project.root / FILE, record)
    return Project(project.root, record)


def _found(
    project: Project, folders: Sequence[Path]
) -> tuple[list[ProjectScene], list[ToolkitError]]:
    """The rows of new scenes, and what is wrong with each of the others."""
    rows, problems = [], []
    known = {project.folder(s).resolve(): s.name for s in project.record.scenes}
    for folder in folders:
        try:
            Scene.open(folder)
            where = folder.resolve()
            if where in known:
                raise ToolkitError("the scene is in the project already", path=folder)
            name = safe_name(where.name)
            if name in known.values():
                raise ToolkitError(
                    "another scene of the project has this name",
                    path=folder,
                    value=name,
                    hint="rename the folder: reviews, second copies and exports go by it",
                )
        except ToolkitError as error:
            problems.append(error)
            continue
        known[where] = name
        rows.append(ProjectScene(name=name, path=_path(project.root, where)))
    return rows, problems


def _path(root: Path, scene: Path) -> str:
    home = root.resolve()
    near = scene.is_relative_to(home.parent)
    return Path(os.path.relpath(scene, home)).as_posix() if near else scene.as_posix()
