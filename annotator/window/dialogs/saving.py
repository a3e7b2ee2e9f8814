"""Questions about edits: recover them, save them, and whose version to keep."""

from __future__ import annotations

from PySide6.QtWidgets import QWidget

from annotator.clock import local_minute
from annotator.session.recovery import Recovery
from annotator.window.dialogs.question import Answer, Question


def recovery_question(parent: QWidget | None, found: Recovery) -> Question:
    """Answers "recover", "discard" or "close"."""
    edits = "1 edit" if found.count == 1 else f"{found.count} edits"
    who = f" by {found.annotator}" if found.annotator else ""
    heading = f"{edits}{who} from {local_minute(found.time)} were not saved"
    discard = Answer(
        "discard", "Discard", "Open the scene as it was saved; the journal is kept aside."
    )
    close = Answer("close", "Decide later", "Close the scene; nothing is lost.")
    if found.problem:
        text = f"They cannot be brought back: {found.problem}. Their journal is kept aside."
        return Question(parent, heading, text, [discard, close], level="warning")
    text = "The last session on this scene ended before it saved. Bring its edits back?"
    if found.changed:
        text += (
            f"\n\n{', '.join(found.changed)} was written by others since. What they changed and "
            "these edits left alone is kept."
        )
    if found.damage:
        text += f"\n\nThe end of the journal cannot be read ({found.damage}): the rest can."
    recover = Answer("recover", "Recover", "Undo and redo will work as before.")
    return Question(parent, heading, text, [recover, discard, close], level="warning")


def closing_question(parent: QWidget | None, edits: int) -> Question:
    """Answers "save", "keep" or "cancel"."""
    told = "1 edit is" if edits == 1 else f"{edits} edits are" if edits else "The edits are"
    return Question(
        parent,
        f"{told} not saved",
        "Save the labels now, or leave the edits in the journal: the scene offers to recover "
        "them when it is opened next.",
        [
            Answer("save", "Save", "Write the labels into the scene, then close."),
            Answer("keep", "Keep for next time", "Close; they can be recovered."),
            Answer("cancel", "Cancel", "Go on annotating."),
        ],
        level="warning",
    )


def conflict_question(parent: QWidget | None, names: str) -> Question:
    """Answers "mine", "theirs" or "cancel"."""
    return Question(
        parent,
        "Others changed the same objects",
        f"While you edited them, another program or person wrote these into the scene: {names}.\n\n"
        "Whose version shall be saved? Everything else is kept from both, and what you give up "
        "can be brought back by undo.",
        [
            Answer("mine", "Keep mine", "Your version of these objects is written."),
            Answer("theirs", "Keep theirs", "Their version of these objects is taken over."),
            Answer("cancel", "Cancel", "Nothing is saved yet."),
        ],
        level="warning",
    )
