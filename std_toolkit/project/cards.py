"""The board of a project as its page and its window show it to one person."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.documents import digest_of
from std_toolkit.io.images import read_color
from std_toolkit.io.locks import person_of
from std_toolkit.project.board import Event, ObjectState, SceneState
from std_toolkit.project.queue import Task, due_for
from std_toolkit.project.record import Project
from std_toolkit.project.status import STAGES, SceneRow, Stage
from std_toolkit.scene.judgement import Grade

# The worst first; of a scene, the first that one of its labels has.
_WORST: tuple[Grade, ...] = ("wrong", "doubtful", "unknown", "fits")
_PICTURES = Path(".std") / "pictures"
_QUALITY = 78
_LATEST = 60


@dataclass(frozen=True, kw_only=True)
class Card:
    """One scene.

    Attributes:
        name: in the project.
        stage: what it waits for.
        verdict: the worst verdict on its labels; "" without a label.
        labelled, objects: numbers of objects.
        people: who labelled it.
        reviewer: who accepted it or sent it back; "" for nobody.
        minutes: that people worked on its labels, with the unit, or "".
        last: the latest thing that a person did; None for nothing.
        held_by: a sentence on who has it open now, with the computer, or "".
        evidence: its labels that are wrong, doubtful or unknown, the wrong ones first.
        comments: what people said, the latest first.
        problem: why it cannot be read, or "".
        words: what a search looks through, in small letters.
    """

    name: str
    stage: Stage
    verdict: Grade | str
    labelled: int
    objects: int
    people: str
    reviewer: str
    minutes: str
    last: Event | None
    held_by: str
    evidence: list[ObjectState]
    comments: list[Event]
    problem: str
    words: str


@dataclass(frozen=True, kw_only=True)
class NextTask:
    """Something for the person to do: what, in which scene, and why or what to look at."""

    task: Task
    card: Card
    about: str


@dataclass(frozen=True, kw_only=True)
class Cards:
    """The board for one person.

    Attributes:
        person: who looks; one of the people of the project, or "" for anybody.
        due: what is next for the person, the first task first.
        cards: by name, in the order of the project.
        counts: number of scenes by stage, without zeros.
        history: what people did, with the scene; the latest first.
    """

    person: str
    due: list[NextTask]
    cards: Mapping[str, Card]
    counts: Mapping[Stage, int]
    history: list[tuple[str, Event]]


def board_cards(project: Project, rows: Sequence[SceneRow], person: str) -> Cards:
    """The board of a project for one person; the queue of a stranger is empty."""
    cards = {row.name: card_of(row) for row in rows}
    due = due_for(project, rows, person) if person in project.record.people else []
    counts = {stage: sum(row.stage == stage for row in rows) for stage in STAGES}
    events = ((row.name, event) for row in rows for event in row.scene.events)
    return Cards(
        person=person,
        due=[NextTask(task=d.task, card=cards[d.scene], about=d.about) for d in due],
        cards=cards,
        counts={stage: n for stage, n in counts.items() if n},
        history=sorted(events, key=lambda found: found[1].time, reverse=True)[:_LATEST],
    )


def card_of(row: SceneRow) -> Card:
    """The card of one scene."""
    scene = row.scene
    grades = {o.grade for o in scene.objects}
    evidence = [o for grade in _WORST[:3] for o in scene.graded(grade)]
    people = ", ".join(sorted(row.hands))
    who = person_of(row.held_by)
    held_by = f"{who} has it open" if ", annotator " in row.held_by else ""
    if who and not held_by:
        held_by = f"a program of {who} works on it"
    words = [row.name, row.stage, people, scene.reviewer, *(o.name for o in scene.objects)]
    return Card(
        name=row.name,
        stage=row.stage,
        verdict=next((grade for grade in _WORST if grade in grades), ""),
        labelled=sum(o.state != "open" for o in scene.objects),
        objects=len(scene.objects),
        people=people,
        reviewer=scene.reviewer,
        minutes="" if scene.minutes is None else f"{scene.minutes:.1f}\u00a0min",
        last=next(iter(scene.events), None),
        held_by=held_by,
        evidence=evidence,
        comments=[e for e in scene.events if e.text],
        problem=scene.problem,
        words=" ".join([*words, held_by, *grades_words(grades)]).lower(),
    )


def grades_words(grades: set[Grade | None]) -> list[str]:
    """The verdicts among the objects of a scene, the worst first."""
    return [grade for grade in _WORST if grade in grades]


def scene_picture(project: Project, scene: SceneState, *, width: int) -> bytes:
    """The image of the first frame, reduced to a width in pixels, as JPEG.

    It is kept in `.std/pictures` of the project until the image changes.

    Raises:
        ToolkitError: there is no frame, or its image cannot be read.
    """
    if not scene.picture:
        raise ToolkitError("the scene has no picture", path=scene.root)
    path = Path(scene.root) / scene.picture
    kept = project.root / _PICTURES / f"{_signature(path, width)}.jpg"
    try:
        return kept.read_bytes()
    except OSError:
        data = _reduced(path, width)
    with suppress(ToolkitError):  # a project that is only read
        write_bytes_atomic(kept, data)
    return data


def picture_version(scene: SceneState) -> str:
    """Changes with the image of the first frame."""
    return _signature(Path(scene.root) / scene.picture, 0) if scene.picture else ""


def _signature(path: Path, width: int) -> str:
    try:
        found = path.stat()
    except OSError:
        return "none"
    return digest_of(str(path), found.st_mtime_ns, found.st_size, width)[:20]


def _reduced(path: Path, width: int) -> bytes:
    rgb = read_color(path)
    height = max(1, round(width * rgb.shape[0] / rgb.shape[1]))
    small = cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA)
    bgr = np.ascontiguousarray(small[..., ::-1])
    done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not done:
        raise ToolkitError("the image cannot be encoded", path=path, value=rgb.shape)
    return bytes(data)
