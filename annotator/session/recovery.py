"""Recovery of edits of a session that ended without saving."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from annotator.session import journal
from annotator.session.ledger import Ledger
from annotator.session.merge import Version
from std_toolkit.errors import ToolkitError
from std_toolkit.scene import Scene


@dataclass(frozen=True, eq=False)
class Recovery:
    """Unsaved edits of an earlier session.

    Attributes:
        count: number of edits, undos and redos since the last save.
        annotator: annotator of the last one.
        time: time of the last one, UTC, ISO 8601.
        problem: reason why they cannot be recovered, or "".
        damage: text on the unreadable part of the journal, or ""; lines before it are recovered.
        changed: documents of the scene that were written since the edits began.
        ledger: recovered ledger of the session.
        entries: number of journal lines replayed.
        content: the journal.
    """

    count: int
    annotator: str
    time: str
    problem: str
    damage: str
    changed: tuple[str, ...]
    ledger: Ledger
    entries: int
    content: journal.JournalContent

    def __str__(self) -> str:
        edits = "1 edit" if self.count == 1 else f"{self.count} edits"
        who = self.annotator or "somebody"
        when = datetime.fromisoformat(self.time).astimezone().strftime("%Y-%m-%d %H:%M")
        were = "was" if self.count == 1 else "were"
        text = f"{edits} by {who}, the last one at {when}, {were} not saved"
        if self.problem:
            text += f", and cannot be recovered: {self.problem}"
        if self.damage:
            text += f"; the journal is damaged: {self.damage}, edits before that are kept"
        return text


def replay(content: journal.JournalContent) -> tuple[Ledger, int, str]:
    """Return the ledger after all entries, the number of applied entries, and the problem.

    An entry that is invalid for the state ends the replay, as a damaged line does.
    """
    assert content.begun is not None
    ledger = Ledger(Version(content.begun.stored, content.begun.state))
    for done, entry in enumerate(content.entries):
        try:
            ledger.plan(entry)()
        except ToolkitError as error:
            return ledger, done, f"line {done + 2} does not fit ({error.problem})"
    return ledger, len(content.entries), content.damage


def find_recovery(scene: Scene, content: journal.JournalContent) -> Recovery | None:
    """Return the recoverable edits of a journal; None if all readable edits were saved."""
    begun = content.begun
    if begun is None:
        return None
    ledger, entries, damage = replay(content)
    if not ledger.unsaved:
        return None
    saves = [i + 1 for i, x in enumerate(content.entries[:entries]) if isinstance(x, journal.Saved)]
    made = [
        entry
        for entry in content.entries[max(saves, default=0) : entries]
        if isinstance(entry, journal.Edited | journal.Undone | journal.Redone)
    ]
    last = made[-1] if made else begun
    now = journal.scene_digests(scene.root)
    changed = tuple(name for name, digest in begun.digests.items() if now.get(name) != digest)
    problem = ""
    if begun.scene != scene.info.name or "frames.json" in changed:
        problem = "they are of another recording (frames.json has changed)"
    return Recovery(
        len(made), last.annotator, last.time, problem, damage, changed, ledger, entries, content
    )
