"""The review of a scene of a project as a question, for the window and the board's page."""

from __future__ import annotations

from collections.abc import Callable

from annotator.app.questions import CANCEL, Answers, Button, Field, Question
from std_toolkit.errors import ToolkitError
from std_toolkit.project.board import ObjectState
from std_toolkit.project.cards import Card
from std_toolkit.project.queue import review_scene
from std_toolkit.project.record import Project
from std_toolkit.project.status import SceneRow

ACCEPT, SEND_BACK = "accept", "send_back"
_ABOUT = "about: "


def review_question(
    row: SceneRow, card: Card, by: str, react: Callable[[str, Answers], object] = lambda *_: None
) -> Question:
    """Ask a person to accept the labels of a scene or to send it back.

    Args:
        row, card: the scene.
        by: the reviewer.
    """
    doubtful = [o for o in card.evidence if o.grade in ("doubtful", "unknown")]
    wrong = [f"{o.name} is wrong: {o.reason}." for o in card.evidence if o.grade == "wrong"]
    text = "Look at the labels and the report of the check first."
    if wrong:
        text = f"It cannot be accepted: {' '.join(wrong)}"
    fields = [_field(o, row.scene.reasons.get(o.name, {}).get(by, "")) for o in doubtful]
    back = Field("back", "What is wrong, to send it back", kind="lines")
    return Question(
        f"Review {card.name}",
        react,
        text=text,
        fields=(*fields, back),
        buttons=(
            Button(ACCEPT, "Accept", "All labels stay as they are."),
            Button(SEND_BACK, "Send back", "Its labeller finds the reason."),
            CANCEL,
        ),
    )


def _field(label: ObjectState, said: str) -> Field:
    return Field(
        f"{_ABOUT}{label.name}",
        f"{label.name} is {label.grade}: {label.reason}. Why is it kept?",
        kind="lines",
        value=said,
        tip="Needed to accept the scene.",
    )


def store_review(project: Project, name: str, by: str, pressed: str, answers: Answers) -> list[str]:
    """Store the answer to `review_question`.

    Returns:
        What stands against the acceptance, a line each; nothing was stored if there is any.

    Raises:
        ToolkitError: see `review_scene`.
    """
    reasons = {
        key.removeprefix(_ABOUT): str(text).strip()
        for key, text in answers.items()
        if key.startswith(_ABOUT) and str(text).strip()
    }
    if pressed == ACCEPT:
        return review_scene(project, name, by=by, accept=True, reasons=reasons)
    if pressed != SEND_BACK:
        raise ToolkitError("this is no answer to a review", value=pressed)
    back = str(answers.get("back", "")).strip()
    if not back:
        raise ToolkitError("say what is wrong, to send the scene back")
    # The reasons to keep a label are no complaints.
    return review_scene(project, name, by=by, send_back=back)
