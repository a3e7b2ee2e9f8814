"""The HTML of the board of a project, and of one of its scenes, of templates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from annotator.app.pose_text import local_minute
from annotator.app.questions import Question
from annotator.web.scene_sessions import SceneSession
from std_toolkit.html.templates import environment
from std_toolkit.io.locks import TAKE_OVER
from std_toolkit.project.cards import Cards, picture_version
from std_toolkit.project.queue import Task
from std_toolkit.project.record import Project
from std_toolkit.project.status import STAGES, SceneRow, Stage

# What the button of a task says, and how it opens the scene; a review begins on the scene's page.
TASKS: Mapping[Task, tuple[str, str]] = {
    "correct": ("Correct", "edit"),
    "review": ("Review", ""),
    "label again, blind": ("Label again, blind", "again"),
    "label": ("Label", "edit"),
}

_TO_REVIEW: tuple[Stage, ...] = ("to review", "to correct", "accepted")

_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)


def headers() -> dict[str, str]:
    """The headers of these pages: they have no script but the one of the server."""
    return {"Content-Security-Policy": _POLICY}


def board_html(
    project: Project,
    cards: Cards,
    rows: Sequence[SceneRow],
    sessions: Sequence[SceneSession],
    *,
    version: str,
) -> str:
    """The page of the board.

    Args:
        project: the project.
        cards: the board for one person.
        rows: the same scenes.
        sessions: that this person has open.
        version: changes with what the page shows.
    """
    return _render(
        "board.html",
        project=project,
        cards=cards,
        stages=[stage for stage in STAGES if stage in cards.counts],
        pictures={row.name: picture_version(row.scene) for row in rows},
        sessions=sessions,
        version=version,
        verdicts=sorted({c.verdict for c in cards.cards.values() if c.verdict}),
    )


def scene_html(
    project: Project,
    cards: Cards,
    row: SceneRow,
    *,
    question: Question,
    sessions: Sequence[SceneSession],
    problem: str,
    typed: Mapping[str, str],
) -> str:
    """The page of one scene.

    Args:
        project: the project.
        cards: the board for one person.
        row: the scene.
        question: the review, see `review_question`.
        sessions: that this person has open.
        problem: why the last thing that was asked for was not done, or "".
        typed: what the person had typed then.
    """
    person, second = cards.person, row.second
    left = second is None or any(o.state == "open" for o in second.objects)
    return _render(
        "board_scene.html",
        project=project,
        cards=cards,
        row=row,
        card=cards.cards[row.name],
        picture=picture_version(row.scene),
        question=question,
        typed=typed,
        problem=problem,
        take_over=TAKE_OVER in problem,
        sessions=[s for s in sessions if s.name == row.name],
        may_review=person not in row.hands and row.stage in _TO_REVIEW,
        # Whoever may label it again should not see these labels.
        blind=row.twice and left and person not in row.scene.labellers,
        again=second is not None and left and {*second.labellers} <= {person}
        and person not in row.scene.labellers,
        tasks=[task for task in cards.due if task.card.name == row.name],
    )  # fmt: skip


def _render(name: str, **values: Any) -> str:
    return (
        environment().get_template(name).render(local_minute=local_minute, buttons=TASKS, **values)
    )
