"""The board of a project: what each scene waits for, and whether it is accepted.

Scenes whose files did not change since the last look are not read again: what was found is kept in
`.std/board.json` of the project, by the times and sizes of the files. It is only looked at; what
decides (`project review`, `run`, `export`) reads the scenes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import msgspec

from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import Table, text_table
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.documents import digest_of
from std_toolkit.io.locks import lock_holder
from std_toolkit.project.board import SceneState, scene_state
from std_toolkit.project.record import Project, ProjectScene
from std_toolkit.scene.judgement import GRADES, Grade
from std_toolkit.settings import changed

Stage = Literal[
    "unreadable", "to fix", "to compute", "to label", "to correct", "to review", "accepted"
]
STAGES: tuple[Stage, ...] = get_args(Stage)

_CACHE = Path(".std") / "board.json"
# Files and folders of a scene that its state depends on; a file that is replaced or added changes
# its folder.
_LOOKED_AT = (
    "scene.json", "frames.json", "objects.json", "poses.json", "labels.json", "annotation.json",
    "review.json", "check/report.json", "check/report.html", ".std/records/check.json",
    "gt/info", "color", "depth",
)  # fmt: skip
_TO_LOOK_AT: tuple[Grade, ...] = ("wrong", "doubtful", "unknown")
_BY_MACHINE = ("poses", "propagate", "render", "check")


@dataclass(frozen=True, kw_only=True)
class SceneRow:
    """One scene on the board of a project.

    Attributes:
        name: in the project.
        stage: what it waits for.
        objections: why it is not accepted, of its reviewer; empty if it is, or without a reviewer.
        held_by: who edits or writes to it now: user, computer and process.
        scene: its state.
        twice: whether it is labelled a second time.
        second: state of the second, blind copy; None before `project run` made it.
    """

    name: str
    stage: Stage
    objections: list[str]
    held_by: str
    scene: SceneState
    twice: bool
    second: SceneState | None

    @property
    def hands(self) -> set[str]:
        """Who labelled the scene or its second copy."""
        return {*self.scene.labellers, *(self.second.labellers if self.second else ())}

    @property
    def doubts(self) -> int:
        """How many of its labels need a reviewer's reason."""
        return len(self.scene.graded("doubtful", "unknown"))


def objections(scene: SceneState, by: str, hands: set[str]) -> list[str]:
    """Why a scene is not accepted by a person under the rules; empty if it is.

    Args:
        scene: the scene.
        by: the reviewer.
        hands: who labelled it or its second copy.
    """
    found = [scene.problem] if scene.problem else []
    if by in hands:
        found.append(f"{by} labelled it; another person reviews it")
    unlabelled = [o.name for o in scene.objects if o.state == "open"]
    if unlabelled or not scene.objects:
        found.append(f"without label: {', '.join(unlabelled) or 'all objects'}")
    if scene.next_step in (*_BY_MACHINE, "restore", "fix"):
        found.append(f"incomplete: {scene.next_command}")
    found += [f"the check calls {o.name} wrong: {o.reason}" for o in scene.graded("wrong")]
    found += [
        f"{o.name} is {o.grade} and has no reason of {by}: {o.reason}"
        for o in scene.graded("doubtful", "unknown")
        if by not in scene.reasons.get(o.name, {})
    ]
    return found


def stage_of(scene: SceneState, against: Sequence[str]) -> Stage:
    """What a scene waits for.

    Args:
        scene: the scene.
        against: the objections to its reviewer's acceptance.
    """
    if scene.problem:
        return "unreadable"
    if scene.next_step in ("restore", "fix"):
        return "to fix"
    if scene.next_step == "poses":
        return "to compute"
    if scene.next_step == "label":
        return "to label"
    if any(o.state == "refused" for o in scene.objects):
        return "to correct"
    if scene.next_step in _BY_MACHINE:
        return "to compute"
    if scene.graded("wrong"):
        return "to correct"
    return "accepted" if scene.accepted and not against else "to review"


def project_board(project: Project, *, fresh: bool = False) -> list[SceneRow]:
    """The board of a project, in the order of its scenes.

    Args:
        project: the project.
        fresh: read every scene, also those whose files did not change.
    """
    cache = {} if fresh else _read_cache(project)
    kept: dict[str, _Kept] = {}

    def state(folder: Path) -> SceneState:
        key = str(folder)
        signature = _signature(folder)
        known = cache.get(key)
        if known is None or known.signature != signature:
            known = _Kept(signature=signature, state=scene_state(folder))
        kept[key] = known
        return known.state

    rows = [_row(project, item, state) for item in project.record.scenes]
    if kept != cache:
        with suppress(ToolkitError):  # a project that is only read
            write_bytes_atomic(project.root / _CACHE, msgspec.json.encode(kept))
    return rows


def scene_row(project: Project, item: ProjectScene) -> SceneRow:
    """One scene of the board; its files are read."""
    return _row(project, item, scene_state)


def _row(project: Project, item: ProjectScene, read: Callable[[Path], SceneState]) -> SceneRow:
    folder, copy = project.folder(item), project.second(item)
    scene = read(folder)
    second = read(copy) if (copy / "scene.json").is_file() else None
    hands = {*scene.labellers, *(second.labellers if second else ())}
    against = objections(scene, scene.reviewer, hands) if scene.accepted else []
    return SceneRow(
        name=item.name,
        stage=stage_of(scene, against),
        objections=against,
        held_by=lock_holder(folder, "annotate.lock") or lock_holder(folder, "lock"),
        scene=scene,
        twice=project.is_twice(item),
        second=second,
    )


class _Kept(msgspec.Struct, frozen=True):
    signature: str
    state: SceneState


def _read_cache(project: Project) -> dict[str, _Kept]:
    try:
        return msgspec.json.decode((project.root / _CACHE).read_bytes(), type=dict[str, _Kept])
    except (OSError, msgspec.MsgspecError, ValueError):
        return {}


def _signature(folder: Path) -> str:
    """Digest of times and sizes of the files that the state of a scene depends on."""
    parts = [_stat(folder / name) for name in _LOOKED_AT]
    parts += list(_meshes(folder))
    return digest_of(__version__, str(folder), parts, changed("checks.", "labels."))


def _meshes(folder: Path) -> Iterator[list[int | str]]:
    with suppress(OSError), os.scandir(folder / "models") as models:
        for model in sorted(models, key=lambda entry: entry.name):
            with suppress(OSError), os.scandir(model.path) as files:
                yield from (
                    [f.name, *_numbers(f.stat())] for f in sorted(files, key=lambda f: f.name)
                )


def _stat(path: Path) -> list[int | str]:
    try:
        return _numbers(path.stat())
    except OSError:
        return []


def _numbers(found: os.stat_result) -> list[int | str]:
    return [found.st_mtime_ns, found.st_size, found.st_ino]


def needs_second(row: SceneRow) -> bool:
    """Whether the copy for second, blind labels is due: the first labels are complete."""
    scene = row.scene
    complete = scene.objects and all(o.state != "open" for o in scene.objects)
    return bool(row.twice and row.second is None and complete and scene.registered)


def due_steps(project: Project, rows: Sequence[SceneRow]) -> list[tuple[str, Path, bool]]:
    """What a machine can do: name, folder, and whether it is a second copy.

    Of a second copy only the poses are needed, to compare them.
    """
    found: list[tuple[str, Path, bool]] = []
    for item, row in zip(project.record.scenes, rows, strict=True):
        if row.scene.next_step in _BY_MACHINE:
            found.append((row.name, project.folder(item), False))
        if row.second is not None and row.second.next_step == "propagate":
            found.append((f"{row.name} (second)", project.second(item), True))
    return found


def project_table(rows: Sequence[SceneRow]) -> Table:
    """One row per scene: what it waits for, its objects by state and verdict, people, minutes."""
    words = ("scene", "state", "labelled", "reviewed", "refused", *GRADES, "by", "again",
             "minutes", "check", "reviewer", "held by")  # fmt: skip
    left = ("scene", "state", "by", "again", "check", "reviewer", "held by")
    return text_table(words, [_cells(row) for row in rows], texts=left)


def _cells(row: SceneRow) -> list[str]:
    scene = row.scene
    counts = {s: sum(o.state == s for o in scene.objects) for s in ("open", "reviewed", "refused")}
    total = len(scene.objects)
    grades = [len(scene.graded(grade)) for grade in GRADES]
    again = ""
    if row.twice:
        second = row.second
        done = sum(o.state != "open" for o in second.objects) if second else 0
        again = f"{done}/{len(second.objects)} {', '.join(second.labellers)}" if second else "due"
    return [
        row.name,
        row.stage,
        f"{total - counts['open']}/{total}",
        *(str(counts[s] or "") for s in ("reviewed", "refused")),
        *(str(n or "") for n in grades),
        ", ".join(scene.labellers),
        again.strip(),
        "" if scene.minutes is None else f"{scene.minutes:.1f}",
        scene.check or "none",
        scene.reviewer,
        row.held_by,
    ]


def object_table(rows: Sequence[SceneRow]) -> Table:
    """One row per object of every scene."""
    words = ("scene", "object", "state", "verdict", "by", "minutes", "reason")
    cells = [
        (row.name, o.name, o.state, o.grade or "", o.annotator,
         "" if o.minutes is None else f"{o.minutes:.1f}", o.reason)
        for row in rows
        for o in row.scene.objects
    ]  # fmt: skip
    return text_table(words, cells, texts=[word for word in words if word != "minutes"])


def board_lines(rows: Sequence[SceneRow]) -> list[str]:
    """What is not in the table: scenes that cannot be read, labels to look at, reasons, a count."""
    lines = [f"unreadable: {row.name}: {row.scene.problem}" for row in rows if row.scene.problem]
    lines += [
        f"sent back: {row.name}: {row.scene.reviewer}: {row.scene.reason}"
        for row in rows
        if row.scene.reason
    ]
    lines += [f"not accepted: {row.name}: {why}" for row in rows for why in row.objections]
    lines += [
        f"{o.grade}: {row.name}: {o.name}: {o.reason}"
        for grade in _TO_LOOK_AT
        for row in rows
        for o in row.scene.graded(grade)
    ]
    counts = {stage: sum(row.stage == stage for row in rows) for stage in STAGES}
    told = ", ".join(f"{n} {stage}" for stage, n in counts.items() if n)
    return [*lines, f"{len(rows)} scenes: {told}" if rows else "no scenes"]
