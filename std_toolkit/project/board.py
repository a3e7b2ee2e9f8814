"""The board of several scenes: the state of every object, and the next command of every scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from std_toolkit.checks.summary import SceneSummary, Step, summarise
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import Table, text_table
from std_toolkit.scene.judgement import GRADES, Grade
from std_toolkit.scene.review import Reviews, Standing, label_digests, read_reviews, standing
from std_toolkit.scene.scene import Scene

# What the reasons of a review of labels are.
_REASON = {"noted": "gave a reason", "accepted": "gave a reason"}

State = Literal["open", "labelled", "done", "reviewed", "refused"]


@dataclass(frozen=True, kw_only=True)
class ObjectState:
    """One object of a scene.

    Attributes:
        name: of the object.
        state: "open" without a label, "labelled", "done" if its annotator accepted the pose,
            "reviewed" if another person accepted the scene since, "refused" if that person sent
            the label back.
        grade, reason: verdict on the label as far as it holds; None without a label.
        annotator: who labelled it, or "".
        minutes: that the annotator worked on it, at least; None if that is not known.
        note: of the annotator.
    """

    name: str
    state: State
    grade: Grade | None = None
    reason: str = ""
    annotator: str = ""
    minutes: float | None = None
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Event:
    """Something that a person did in a scene.

    Attributes:
        time: UTC, ISO 8601.
        by: who, or "".
        did: "labelled", "accepted", "sent back", "commented" or "gave a reason".
        about: an object, or "".
        text: what was said, or "".
    """

    time: str
    by: str
    did: str
    about: str = ""
    text: str = ""


@dataclass(frozen=True, kw_only=True)
class SceneState:
    """One scene.

    Attributes:
        root: its folder.
        folder: as it was given.
        name: of the scene.
        frames, registered: number of frames, and of those with a camera pose.
        objects: all of them.
        check: "passed", "failed", or "" without a current report.
        check_gates: sentences on the gates of the scene that failed.
        reviewer: who accepted the labels as they are or sent them back; "" for nobody.
        accepted: whether that person accepted them.
        reason: why they were sent back.
        reasons: why labels are kept that the check doubts: text by object and reviewer.
        next_step: what is missing, see `checks.summary`.
        next_command: what to run next; None if the scene is complete.
        events: who labelled, reviewed and commented, the latest first.
        picture: path of the image of the first frame, relative to the scene.
        problem: why the scene cannot be read; "" otherwise, and all else is empty.
    """

    root: str
    folder: str
    name: str
    frames: int = 0
    registered: int = 0
    objects: list[ObjectState] = field(default_factory=list)
    check: Literal["passed", "failed", ""] = ""
    check_gates: list[str] = field(default_factory=list)
    reviewer: str = ""
    accepted: bool = False
    reason: str = ""
    reasons: dict[str, dict[str, str]] = field(default_factory=dict)
    next_step: Step = ""
    next_command: str | None = None
    events: list[Event] = field(default_factory=list)
    picture: str = ""
    problem: str = ""

    @property
    def minutes(self) -> float | None:
        """That people worked on its labels, at least; None if that is not known of any."""
        known = [o.minutes for o in self.objects if o.minutes is not None]
        return sum(known) if known else None

    @property
    def labellers(self) -> list[str]:
        """Who labelled, sorted; labels without a name are nobody's.

        A label that was merged of those of several people names them all.
        """
        names = (name for o in self.objects for name in o.annotator.split(", "))
        return sorted({name for name in names if name})

    def graded(self, *grades: Grade) -> list[ObjectState]:
        """The labelled objects with one of these verdicts."""
        return [o for o in self.objects if o.grade in grades]


def board(folders: Sequence[Path]) -> list[SceneState]:
    """The states of scenes, in the order given; a scene that cannot be read is one of them.

    Raises:
        ToolkitError: a folder is given twice.
    """
    roots = [folder.resolve() for folder in folders]
    for k, root in enumerate(roots):
        if root in roots[:k]:
            raise ToolkitError("the scene is given twice", path=folders[k])
    return [scene_state(folder) for folder in folders]


def scene_state(folder: Path) -> SceneState:
    """The state of one scene, with the problem if it cannot be read."""
    try:
        scene = Scene.open(folder)
        return _state(folder, scene, summarise(scene))
    except ToolkitError as error:
        shown = str(folder)
        return SceneState(root=shown, folder=shown, name=folder.name, problem=str(error))


def _state(folder: Path, scene: Scene, summary: SceneSummary) -> SceneState:
    reviews = read_reviews(scene.root)
    said = standing(reviews, label_digests(scene))
    labels = {label.object: label for label in scene.labels.labels}
    verdicts = {verdict.object: verdict for verdict in summary.verdicts}
    objects = []
    for item in scene.objects.objects:
        label, verdict = labels.get(item.id), verdicts.get(item.id)
        noted = scene.annotation.of(item.id)
        if label is None:
            objects.append(ObjectState(name=item.name, state="open", note=noted.note))
            continue
        seconds = label.provenance.hands_on_s if label.provenance else None
        objects.append(
            ObjectState(
                name=item.name,
                state=_object_state(item.name, said, noted.status),
                grade=verdict.grade if verdict else "unknown",
                reason=verdict.reason if verdict else "",
                annotator=label.annotator,
                minutes=None if seconds is None else seconds / 60,
                note=noted.note,
            )
        )
    passed = summary.check_passed
    return SceneState(
        root=str(scene.root),
        folder=str(folder),
        name=summary.name,
        frames=summary.frames,
        registered=summary.registered or 0,
        objects=objects,
        check="" if passed is None else "passed" if passed else "failed",
        check_gates=summary.check_gates,
        reviewer=said.by,
        accepted=said.accepted,
        reason=said.reason,
        reasons={name: dict(texts) for name, texts in said.reasons.items()},
        next_step=summary.next_step,
        next_command=summary.next_command,
        events=_events(scene, reviews),
        picture=scene.frames[0].color if scene.frames else "",
    )


def _events(scene: Scene, reviews: Reviews) -> list[Event]:
    names = {o.id: o.name for o in scene.objects.objects}
    found = [
        Event(time=label.provenance.time, by=label.annotator, did="labelled",
              about=names[label.object])
        for label in scene.labels.labels
        if label.provenance
    ]  # fmt: skip
    for row in reviews.reviews:
        did = {"noted": "commented"}.get(row.verdict, row.verdict)
        if row.reason or row.verdict != "noted":
            found.append(Event(time=row.time, by=row.by, did=did, text=row.reason))
        found += [
            Event(time=row.time, by=row.by, did=_REASON.get(row.verdict, row.verdict), about=name,
                  text=text)
            for name, text in row.reasons.items()
        ]  # fmt: skip
    return sorted(found, key=lambda event: event.time, reverse=True)


def _object_state(name: str, said: Standing, status: str) -> State:
    if name in said.refused:
        return "refused"
    if said.accepted:
        return "reviewed"
    return "done" if status == "done" else "labelled"


def board_table(scenes: Sequence[SceneState]) -> Table:
    """One row per scene: frames, labels, verdicts, people, minutes, check and the next command."""
    words = ("scene", "poses", "labelled", "done", *GRADES, "by", "minutes", "check", "next")
    left = ("scene", "by", "check", "next")
    return text_table(words, [_cells(scene) for scene in scenes], texts=left)


def _cells(scene: SceneState) -> list[str]:
    if scene.problem:
        blank = [""] * (len(GRADES) + 5)
        return [scene.folder, *blank, "unreadable", scene.problem]
    labelled = [o for o in scene.objects if o.state != "open"]
    total = len(scene.objects)
    grades = [sum(o.grade == grade for o in labelled) for grade in GRADES]
    return [
        scene.folder,
        f"{scene.registered}/{scene.frames}",
        f"{len(labelled)}/{total}",
        f"{sum(o.state in ('done', 'reviewed') for o in labelled)}/{total}",
        *(str(n) if n else "" for n in grades),
        ", ".join(scene.labellers),
        "" if scene.minutes is None else f"{scene.minutes:.1f}",
        scene.check or "none",
        scene.next_command or "complete",
    ]


def doubts(scenes: Sequence[SceneState]) -> list[str]:
    """A line for every label that is wrong or doubtful, the wrong ones first."""
    rows = [
        (o.grade, f"{o.grade}: {scene.folder}: {o.name}: {o.reason}")
        for scene in scenes
        for o in scene.objects
        if o.grade in ("wrong", "doubtful")
    ]
    return [line for _, line in sorted(rows, key=lambda row: row[0] != "wrong")]
