"""The board of a project in the window: what is next for the person, and all scenes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from PySide6 import QtWidgets
from PySide6.QtCore import Qt, QTimer, Signal

from annotator.app.pose_text import local_minute
from annotator.app.questions import CANCEL, Button, Field, Question
from annotator.app.review import review_question, store_review
from annotator.app.tasks import Runner, Task
from annotator.qt.board_rows import CARD, TASK, SceneRows
from annotator.qt.question_dialog import QuestionDialog
from annotator.qt.start_page import ProblemCard
from std_toolkit.errors import ToolkitError
from std_toolkit.project.cards import Card, Cards, NextTask, board_cards, scene_picture
from std_toolkit.project.queue import comment_scene
from std_toolkit.project.record import Project
from std_toolkit.project.status import SceneRow, project_board

REFRESH_MS = 5000
_WIDTH = 360


class BoardPage(QtWidgets.QWidget):
    """Page to choose a scene of a project, and to review.

    Args:
        project: the project.
        person: who annotates; a stranger to the project has no queue.
        runner: reads scenes and pictures in the background.

    Signals:
        chosen: folder of the scene (Path), whether to open it read-only, and whether to take it
            over from a computer that is gone.
    """

    chosen = Signal(object, bool, bool)

    def __init__(self, project: Project, person: str, runner: Runner) -> None:
        super().__init__()
        self._project, self._person, self._runner = project, person, runner
        self._rows: dict[str, SceneRow] = {}
        self._cards: Cards | None = None
        self._tried: Path | None = None
        self.problem = ProblemCard()
        self.problem.again.clicked.connect(lambda: self._retry())
        self.problem.look.clicked.connect(lambda: self._retry(look=True))
        self.problem.take.clicked.connect(lambda: self._retry(take_over=True))
        self.about = _label("Reading the scenes...", "muted")
        self.search = QtWidgets.QLineEdit()
        self.search.setPlaceholderText("Search scenes, objects, people, states")
        self.search.setAccessibleName("Search the scenes")
        self.search.setClearButtonEnabled(True)
        self.search.textChanged.connect(lambda: self._filter())
        drawn = SceneRows(self, self.picture)
        self.due, self.scenes = _list("Next for me", drawn), _list("Scenes", drawn)
        for one, other in ((self.due, self.scenes), (self.scenes, self.due)):
            one.itemActivated.connect(lambda _: self.open_chosen())
            one.currentItemChanged.connect(partial(self._choose, other=other))
        self.detail = QtWidgets.QLabel()
        self.detail.setTextFormat(Qt.TextFormat.PlainText)
        self.detail.setWordWrap(True)
        self.detail.setAlignment(Qt.AlignmentFlag.AlignTop)
        self.detail.setMinimumHeight(96)
        self.open_button = _button("Open", self.open_chosen, primary=True)
        self.look_button = _button("Look", partial(self.open_chosen, look=True))
        self.review_button = _button("Review...", self._review)
        self.comment_button = _button("Comment...", self._comment)
        self._lay_out()
        self._clock = QTimer(self, interval=REFRESH_MS)
        self._clock.timeout.connect(lambda: self.read() if self.isVisible() else None)
        self._clock.start()
        self._choose(None)

    def _lay_out(self) -> None:
        top = QtWidgets.QHBoxLayout()
        top.addWidget(_label(self._project.record.name, "title"))
        top.addWidget(self.about, 1, Qt.AlignmentFlag.AlignBottom)
        top.addWidget(self.search, 1, Qt.AlignmentFlag.AlignBottom)
        columns = QtWidgets.QHBoxLayout()
        self.due_head, self.all_head = _label("Next for me", "heading"), _label("", "heading")
        for head, shown, share in ((self.due_head, self.due, 2), (self.all_head, self.scenes, 3)):
            column = QtWidgets.QVBoxLayout()
            column.addWidget(head)
            column.addWidget(shown, 1)
            columns.addLayout(column, share)
        buttons = QtWidgets.QHBoxLayout()
        for button in (self.open_button, self.look_button, self.review_button, self.comment_button):
            buttons.addWidget(button)
        buttons.addStretch(1)
        layout = QtWidgets.QVBoxLayout(self)
        layout.setContentsMargins(20, 14, 20, 14)
        layout.addLayout(top)
        layout.addWidget(self.problem)
        layout.addLayout(columns, 1)
        layout.addWidget(self.detail)
        layout.addLayout(buttons)

    # --- reading ---------------------------------------------------------------------------------

    def refresh(self, problem: ToolkitError | None = None, tried: Path | None = None) -> None:
        """Read the board again, and show the error of the scene that could not be opened."""
        self._tried = tried
        self._tell(problem)
        self.read()

    def _tell(self, problem: ToolkitError | None) -> None:
        self.problem.show_problem(problem)
        self.problem.again.setVisible(self._tried is not None)

    def read(self) -> None:
        """Read the board in the background."""

        def work() -> tuple[Project, list[SceneRow]]:
            project = Project.open(self._project.root)
            return project, project_board(project)

        self._runner.submit_aside("board", Task("Read the board"), work, self._show)

    def _show(self, found: Any, error: Exception | None) -> None:
        if error is not None:
            self._tell(error if isinstance(error, ToolkitError) else ToolkitError(str(error)))
            return
        self._project, rows = found
        self._rows = {row.name: row for row in rows}
        cards = board_cards(self._project, rows, self._person)
        if cards == self._cards:
            return
        chosen, self._cards = self.chosen_card(), cards
        counts = ", ".join(f"{n} {stage}" for stage, n in cards.counts.items())
        known = self._person in self._project.record.people
        who = self._person if known else f"{self._person}, not one of its people (--annotator)"
        self.about.setText(f"{counts} · you are {who}")
        self.due_head.setText(f"Next for me: {len(cards.due) or 'nothing'}")
        for shown, entries in (
            (self.due, [(t.card, t) for t in cards.due]),
            (self.scenes, [(card, None) for card in cards.cards.values()]),
        ):
            self._fill(shown, entries, chosen)
        if self.due.currentRow() < 0 and self.scenes.currentRow() < 0 and self.due.count():
            self.due.setCurrentRow(0)
        self._filter()

    def _fill(
        self,
        shown: QtWidgets.QListWidget,
        entries: Sequence[tuple[Card, NextTask | None]],
        chosen: Card | None,
    ) -> None:
        was_here = shown.currentRow() >= 0
        shown.clear()
        for card, task in entries:
            item = QtWidgets.QListWidgetItem(card.name)
            item.setData(CARD, card)
            item.setData(TASK, task)
            what = f"{task.task}, " if task else ""
            item.setData(
                Qt.ItemDataRole.AccessibleTextRole,
                f"{card.name}, {what}{card.stage}, {card.verdict or 'no label'}",
            )
            shown.addItem(item)
            if was_here and chosen is not None and card.name == chosen.name:
                shown.setCurrentItem(item)

    def _filter(self) -> None:
        words = self.search.text().lower().split()
        seen = 0
        for i in range(self.scenes.count()):
            item = self.scenes.item(i)
            fits = all(word in item.data(CARD).words for word in words)
            item.setHidden(not fits)
            seen += fits
        total = self.scenes.count()
        self.all_head.setText(f"Scenes: {total}" if seen == total else f"Scenes: {seen} of {total}")

    def picture(self, name: str, done: Any) -> None:
        """Read the picture of a scene in the background; `done` receives JPEG or None."""
        state = self._rows[name].scene
        self._runner.submit_aside(
            f"picture {name}",
            Task("Read a picture"),
            lambda: scene_picture(self._project, state, width=_WIDTH),
            lambda data, _: done(data),
        )

    # --- what is chosen --------------------------------------------------------------------------

    def _item(self) -> QtWidgets.QListWidgetItem | None:
        found: QtWidgets.QListWidgetItem | None = self.due.currentItem()
        return found or self.scenes.currentItem()

    def chosen_card(self) -> Card | None:
        """The scene that is chosen in one of the lists."""
        item = self._item()
        return None if item is None else item.data(CARD)

    def _choose(
        self,
        item: QtWidgets.QListWidgetItem | None,
        _: object = None,
        other: QtWidgets.QListWidget | None = None,
    ) -> None:
        if item is not None and other is not None:
            other.setCurrentRow(-1)
        card = self.chosen_card()
        task = None if item is None else item.data(TASK)
        readable = card is not None and not card.problem
        for button in (self.open_button, self.look_button, self.comment_button):
            button.setEnabled(readable)
        row = None if card is None else self._rows.get(card.name)
        person, people = self._person, self._project.record.people
        self.comment_button.setEnabled(readable and person in people)
        self.review_button.setEnabled(
            row is not None and readable and person in people and bool(row.scene.labellers)
            and person not in row.hands
        )  # fmt: skip
        self.look_button.setVisible(task is None or task.task != "review")
        self.open_button.setText(_OPENS.get(task.task, "Open") if task else "Open")
        self.detail.setText("" if card is None else _detail(card, task))

    def open_chosen(self, *, look: bool = False) -> None:
        """Open the chosen scene; a task to review opens it to look at."""
        item = self._item()
        if item is None or not self.open_button.isEnabled():
            return
        task, row = item.data(TASK), self._rows[item.data(CARD).name]
        again = task is not None and task.task == "label again, blind"
        folder = self._project.second(self._project.find(row.name)) if again else row.scene.root
        look = look or (task is not None and task.task == "review")
        self.chosen.emit(Path(folder), look, False)

    def _retry(self, *, look: bool = False, take_over: bool = False) -> None:
        if self._tried is not None:
            self.chosen.emit(self._tried, look, take_over)

    # --- what the person says --------------------------------------------------------------------

    def _review(self) -> None:
        card = self.chosen_card()
        if card is None:
            return
        question = review_question(self._rows[card.name], card, self._person)
        pressed, answers = QuestionDialog(self, question).ask()
        if pressed:
            work = partial(store_review, self._project, card.name, self._person, pressed, answers)
            self._say(work)

    def _comment(self) -> None:
        card = self.chosen_card()
        if card is None:
            return
        question = Question(
            f"Comment on {card.name}",
            fields=(Field("comment", "What others should know", kind="lines"),),
            buttons=(Button("comment", "Comment"), CANCEL),
        )
        pressed, answers = QuestionDialog(self, question).ask()
        if pressed:
            text = str(answers["comment"])
            self._say(partial(comment_scene, self._project, card.name, by=self._person, text=text))

    def _say(self, work: Any) -> None:
        self._tried = None
        try:
            against = work()
        except ToolkitError as error:
            self._tell(error)
            return
        self._tell(ToolkitError("; ".join(against)) if against else None)
        self.read()


_OPENS = {
    "correct": "Correct",
    "review": "Look",
    "label again, blind": "Label again, blind",
    "label": "Label",
}


def _detail(card: Card, task: NextTask | None) -> str:
    lines = [card.problem] if card.problem else []
    if task is not None and task.about and task.task != "review":
        lines.append(task.about)
    lines += [f"{o.name} is {o.grade}: {o.reason}" for o in card.evidence[:3]]
    if len(card.evidence) > 3:
        lines.append(f"and {len(card.evidence) - 3} more labels to look at")
    lines += [f"{e.by}, {local_minute(e.time)}: {e.text}" for e in card.comments[:2]]
    return "\n".join(lines) or f"{card.name}: nothing to tell."


def _list(name: str, drawn: SceneRows) -> QtWidgets.QListWidget:
    shown = QtWidgets.QListWidget()
    shown.setAccessibleName(name)
    shown.setItemDelegate(drawn)
    shown.setVerticalScrollMode(QtWidgets.QAbstractItemView.ScrollMode.ScrollPerPixel)
    shown.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    return shown


def _label(text: str, name: str) -> QtWidgets.QLabel:
    label = QtWidgets.QLabel(text)
    label.setObjectName(name)
    return label


def _button(text: str, act: Any, *, primary: bool = False) -> QtWidgets.QPushButton:
    button = QtWidgets.QPushButton(text)
    if primary:
        button.setObjectName("primary")
    button.clicked.connect(lambda: act())
    return button
