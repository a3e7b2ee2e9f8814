"""Questions as data: what is asked, and what the answers do, without any front end."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import trimesh
from desk_without_window import Desk
from scene_on_disk import write_scene

from annotator.app.action_table import ACTIONS
from annotator.app.dialogs import Dialogs
from annotator.app.label_questions import propagate_options
from annotator.app.questions import Field, Question, symmetry_words
from std_toolkit.errors import ToolkitError

OWN = {"open", "close", "light_theme", "larger_text", "smaller_text", "commands", "panels"}


class Asker:
    """A front end that shows nothing, with dialogs of its own.

    Attributes:
        shown: the questions, the oldest first.
    """

    def __init__(self, root: Path) -> None:
        self.desk = Desk(root)
        self.shown: list[Question] = []
        own = dict.fromkeys(OWN, lambda: None)
        self.dialogs = Dialogs(self.desk.controller, self._show, own=own)
        self.desk.controller.select(self.desk.session.state.objects[0].name)

    def _show(self, question: Question | None) -> None:
        if question is not None:
            self.shown.append(question)

    def ask(self, name: str) -> Question:
        self.dialogs.ask(name)
        return self.shown[-1]

    def answer(self, pressed: str, **answers: object) -> None:
        """Answer the newest question; what is not named keeps its first value."""
        question = self.shown[-1]
        self.dialogs.answer(question.number, pressed, question.first_answers() | answers)


@pytest.fixture
def asker(tmp_path: Path) -> Iterator[Asker]:
    write_scene(tmp_path / "scene")
    asker = Asker(tmp_path / "scene")
    yield asker
    asker.desk.close()


def test_every_dialog_of_an_action_is_a_question_of_plain_values(asker: Asker) -> None:
    names = sorted({a.asks for a in ACTIONS if a.asks} - OWN)
    for name in names:
        question = asker.ask(name)
        assert json.loads(json.dumps(question.as_dict()))["number"] == question.number
        first = question.first_answers()
        assert {f.name: f.read(first) for f in question.fields} == first
    assert len({q.title for q in asker.shown}) == len(names)


def test_a_question_is_answered_once(asker: Asker) -> None:
    asker.ask("rename")
    asker.answer("rename", name="carton")
    asker.answer("rename", name="other")
    assert asker.desk.controller.selected == "carton"
    assert len(asker.desk.session.steps) == 1


def test_cancel_changes_nothing(asker: Asker) -> None:
    asker.ask("note")
    asker.answer("", note="left edge")
    assert not asker.desk.session.unsaved


def test_units_are_asked_one_by_one_and_all_meshes_are_added_in_one_edit(
    asker: Asker, tmp_path: Path
) -> None:
    paths = [tmp_path / f"{name}.ply" for name in ("broken", "brick", "can", "left_out")]
    paths[0].write_bytes(b"ply\nnot really")
    trimesh.creation.box((60, 40, 20)).export(paths[1])
    trimesh.creation.box((0.1, 0.1, 0.1)).export(paths[2])
    trimesh.creation.box((50, 40, 20)).export(paths[3])
    before = [m.id for m in asker.desk.session.state.models]
    asker.dialogs.add_meshes(paths)
    asker.desk.wait(lambda: len(asker.shown) == 1)
    asker.answer("mm")
    assert [q.title for q in asker.shown] == [
        "brick.ply is not in metres",
        "left_out.ply is not in metres",
    ]
    asker.answer("")
    asker.desk.wait_until_idle()
    added = [m for m in asker.desk.session.state.models if m.id not in before]
    assert {m.id: m.size_m for m in added} == {
        "brick": pytest.approx([0.06, 0.04, 0.02]),
        "can": pytest.approx([0.1, 0.1, 0.1]),
    }
    assert len(asker.desk.session.steps) == 1
    assert any("broken.ply" in message for message in asker.desk.messages)


def test_a_number_out_of_its_range_is_refused(asker: Asker) -> None:
    asker.ask("symmetry")
    asker.answer("set", symmetry="fold:z", count="1")
    assert "expected a whole number from 2 to 36" in asker.desk.messages[-1]
    assert not asker.desk.session.unsaved


@pytest.mark.parametrize(
    "chosen, words",
    [
        ("keep", None),
        ("auto", ["auto"]),
        ("none", ["none"]),
        ("axis:y", ["axis:y"]),
        ("box", ["fold:x:2", "fold:y:2", "fold:z:2"]),
        ("fold:x", ["fold:x:4"]),
    ],
)
def test_a_symmetry_is_written_as_on_the_command_line(chosen: str, words: list[str] | None) -> None:
    assert symmetry_words({"symmetry": chosen, "count": 4}) == words


def test_what_is_not_asked_keeps_its_first_value(asker: Asker) -> None:
    """A field that another one switches off is not even checked."""
    question = asker.ask("propagate")
    answers = {"refine": False, "scale": True, "depth": False, "keyframes": "many"}
    options = propagate_options({f.name: f.read(answers) for f in question.fields})
    assert not options.refine and not options.refine_scale
    assert options.use_depth and options.keyframes == 10


def test_only_choices_can_be_chosen() -> None:
    with pytest.raises(ToolkitError, match="not one of the choices"):
        Field("form", "Form", kind="choice").read({"form": "round"})
