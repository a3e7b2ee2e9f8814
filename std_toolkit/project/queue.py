"""What is due for a person, and reviews under the rules of the project."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from std_toolkit.errors import ToolkitError, check_known
from std_toolkit.html.table import Table, text_table
from std_toolkit.io.documents import utc_text
from std_toolkit.project.board import SceneState
from std_toolkit.project.people import check_person
from std_toolkit.project.record import Project
from std_toolkit.project.status import SceneRow, objections, scene_row
from std_toolkit.scene.review import Review, Verdict, add_review, label_digests
from std_toolkit.scene.scene import Scene

# In the order in which they are due.
Task = Literal["correct", "review", "label again, blind", "label"]


@dataclass(frozen=True, kw_only=True)
class Due:
    """Something for a person to do.

    Attributes:
        task: what.
        scene: its name in the project.
        folder: to open: that of the scene, or of its blind copy.
        about: why, or what to look at.
        held_by: who works in it now, or "".
    """

    task: Task
    scene: str
    folder: str
    about: str
    held_by: str


def due_for(project: Project, rows: Sequence[SceneRow], person: str) -> list[Due]:
    """What a person may do next, in this order.

    Labels of theirs that were sent back or that the check calls wrong; reviews, the most doubtful
    scene first; second, blind labels; scenes to label, those that they began first. Scenes that
    nobody began are dealt out, so that two people begin with different ones.

    Raises:
        ToolkitError: nobody of the project has this name.
    """
    check_person(project, person)
    turn, people = project.record.people.index(person), len(project.record.people)
    correct, again = [], []
    reviews: list[tuple[tuple[int, int], Due]] = []
    begun: list[Due] = []
    fresh: list[tuple[tuple[int, int], Due]] = []
    for index, (item, row) in enumerate(zip(project.record.scenes, rows, strict=True)):
        hands, scene, second = row.scene.labellers, row.scene, row.second
        mine = person in hands
        if row.stage == "to correct" and (mine or not hands):
            wrong = [f"{o.name} is wrong: {o.reason}" for o in scene.graded("wrong")]
            told = [f"{scene.reviewer}: {scene.reason}"] if scene.reason else []
            correct.append(_due("correct", row, "; ".join([*told, *wrong])))
        elif row.stage == "to review" and person not in row.hands:
            names = ", ".join(f"{o.name} {o.grade}" for o in scene.graded("doubtful", "unknown"))
            reviews.append(((-row.doubts, index), _due("review", row, names)))
        elif row.stage == "to label" and mine:
            begun.append(_due("label", row, _left(scene)))
        elif row.stage == "to label" and not hands:
            fresh.append((((index - turn) % people, index), _due("label", row, "")))
        if second is not None and not second.problem and not mine and person != scene.reviewer:
            left = _left(second)
            if left and {*second.labellers} <= {person}:
                folder = str(project.second(item))
                again.append(replace(_due("label again, blind", row, left), folder=folder))
    return [
        *correct,
        *(due for _, due in sorted(reviews, key=lambda found: found[0])),
        *again,
        *begun,
        *(due for _, due in sorted(fresh, key=lambda found: found[0])),
    ]


def _due(task: Task, row: SceneRow, about: str) -> Due:
    return Due(task=task, scene=row.name, folder=row.scene.folder, about=about, held_by=row.held_by)


def _left(scene: SceneState) -> str:
    names = [o.name for o in scene.objects if o.state == "open"]
    return f"left: {', '.join(names)}" if names else ""


def due_table(found: Sequence[Due]) -> Table:
    """One row per task, the first one first."""
    words = ("next", "scene", "folder", "about", "held by")
    cells = [(d.task, d.scene, d.folder, d.about, d.held_by) for d in found]
    return text_table(words, cells, texts=words)


def review_scene(
    project: Project,
    given: str,
    *,
    by: str,
    accept: bool = False,
    send_back: str | None = None,
    reasons: Mapping[str, str] | None = None,
) -> list[str]:
    """Store a review in the scene.

    Args:
        project: the project.
        given: name or folder of the scene.
        by: the reviewer, one of the people of the project.
        accept: accept all labels as they are.
        send_back: why the scene is sent back, or None.
        reasons: text by object: why a label is kept that the check doubts or, where the scene is
            sent back, what is wrong with it. Earlier ones hold while the label does not change.

    Returns:
        What stands against the acceptance, a line each; nothing was stored if there is any.

    Raises:
        ToolkitError: an unknown person, scene or object, the reviewer labelled the scene, or an
            object has no label.
    """
    reasons = dict(reasons or {})
    if accept and send_back is not None:
        raise ToolkitError("--accept and --send-back exclude each other")
    if not accept and send_back is None and not reasons:
        raise ToolkitError("give --accept, --send-back REASON or --reason OBJECT=TEXT")
    if send_back is not None and not send_back.strip():
        raise ToolkitError("needs a reason", field="--send-back", value=send_back)
    check_person(project, by)
    item = project.find(given)
    row = scene_row(project, item)
    if row.scene.problem:
        raise ToolkitError(row.scene.problem)
    if by in row.hands:
        raise ToolkitError(
            "who labelled a scene may not review it",
            path=row.scene.root,
            field="--by",
            value=by,
            hint="another person of the project reviews it",
        )
    scene = Scene.open(project.folder(item))
    labels = label_digests(scene)
    for name, text in reasons.items():
        check_known(name, labels, "no such labelled object", field="--reason")
        if not text.strip():
            raise ToolkitError("needs a text", field="--reason", value=f"{name}={text}")
    if accept:
        merged = {n: dict(texts) for n, texts in row.scene.reasons.items()}
        for name, text in reasons.items():
            merged.setdefault(name, {})[by] = text
        against = objections(replace(row.scene, reasons=merged), by, row.hands)
        if against:
            return against
    verdict: Verdict = "accepted" if accept else "noted" if send_back is None else "sent back"
    _add(scene, by, verdict, send_back or "", reasons)
    return []


def comment_scene(project: Project, given: str, *, by: str, text: str) -> None:
    """Store a comment on a scene; anybody of the project may, and it changes no state.

    Raises:
        ToolkitError: an unknown person or scene, no text, or a scene that cannot be read.
    """
    check_person(project, by)
    if not text.strip():
        raise ToolkitError("needs a text", field="--comment", value=text)
    _add(Scene.open(project.folder(project.find(given))), by, "noted", text.strip(), {})


def _add(scene: Scene, by: str, verdict: Verdict, text: str, reasons: Mapping[str, str]) -> None:
    row = Review(time=utc_text(), by=by, verdict=verdict, reason=text, reasons=dict(reasons),
                 labels=label_digests(scene))  # fmt: skip
    add_review(scene, row)
