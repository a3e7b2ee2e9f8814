"""Poses carried over in a session: one undo step, a script, a dialog, and the journal."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from desk_without_window import Desk

from annotator.app.action_table import BY_ID
from annotator.app.dialogs import Dialogs
from annotator.app.object_summary import work_state
from annotator.app.questions import Question
from annotator.session import Session
from annotator.session.requests import CarryOver
from annotator.session.requests.mesh_requests import RequestCancelled
from annotator.session.script import read_script, run_script
from std_toolkit.errors import ToolkitError
from std_toolkit.scene import Scene
from tests import carried_scenes as made


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("carried")
    texture = made.with_board(made.plain())
    made.write_table_scene(root / "a", texture=texture, labelled=True)
    made.write_table_scene(root / "b", made.SECOND, T_world_table=made.ELSEWHERE, texture=texture)
    made.write_board(root / "b/board.json")
    return root


@pytest.fixture
def root(recorded: Path, tmp_path: Path) -> Path:
    shutil.copytree(recorded, tmp_path / "scenes")
    return tmp_path / "scenes"


def test_one_undo_step_with_objects_and_meshes_and_saved_labels(root: Path) -> None:
    with Session.open(root / "b", annotator="ben") as session:
        outcome = session.perform(CarryOver(source=str(root / "a")))
        assert outcome.report[0].startswith("carried over from a by the board: 48 corners")
        assert [o.name for o in session.state.objects] == ["box_a", "box_b"]
        assert [o.status for o in session.state.objects] == ["open", "open"]
        assert session.judgement("box_a") is None
        assert session.undoable.title == "Carry over from a"
        session.undo()
        assert session.state.objects == []
        session.redo()
        session.save()
    scene = Scene.open(root / "b")
    assert made.errors_of(scene, made.SECOND)[:, 0].max() < 0.5
    for label in scene.labels.labels:
        assert (label.method, label.annotator) == ("carry:board", "ben")
        assert label.provenance.refinement.startswith("carried over from a by the board")
    assert sorted(p.name for p in (root / "b/models").iterdir()) == ["box_a", "box_b"]


def test_what_is_placed_is_kept_and_told(root: Path) -> None:
    with Session.open(root / "b") as session:
        session.perform(CarryOver(source=str(root / "a"), objects=["box_a"]))
        before = session.state.object("box_a")
        outcome = session.perform(CarryOver(source=str(root / "a")))
        assert session.state.object("box_a") == before
        assert outcome.warnings == ["box_a: it has a pose here already"]
        with pytest.raises(ToolkitError, match="nothing to carry over"):
            session.perform(CarryOver(source=str(root / "a")))


def test_cancelled_before_anything_is_copied(root: Path) -> None:
    with Session.open(root / "b") as session, pytest.raises(RequestCancelled):
        CarryOver(source=str(root / "a")).resolve(session.snapshot(), cancelled=lambda: True)
    assert not (root / "b/models").exists() or not list((root / "b/models").glob("*/*.png.tmp"))
    assert Scene.open(root / "b").objects.models == []


def test_script_names_folders_from_its_own(root: Path) -> None:
    path = root / "edits.json"
    path.write_text(json.dumps([{"edit": "carry_over", "source": "a"}, {"edit": "save"}]))
    with Session.open(root / "b") as session:
        lines = list(run_script(session, read_script(path, session.scene), path))
    assert lines[0] == "[0] Carry over from a"
    assert len(Scene.open(root / "b").labels.labels) == 2


def test_dialog_offers_the_scenes_beside_it_and_tells_the_result(root: Path) -> None:
    desk, shown = Desk(root / "b"), []

    def show(question: Question | None) -> None:
        shown.append(question)

    dialogs = Dialogs(desk.controller, show)
    desk.controller.subscribe(lambda e: dialogs.ask(e.text) if e.kind == "ask" else None)
    action = BY_ID["carry"]
    assert action.enabled(desk.controller)
    action.run(desk.controller)
    question = shown[-1]
    scenes = question.fields[0]
    assert [c.text for c in scenes.choices] == ["a (2 of 2 objects in common)", "Another folder"]
    assert scenes.value == str(root / "a")
    dialogs.answer(question.number, "carry", question.first_answers())
    desk.wait_until_idle()
    assert any("carried over from a by the board" in text for text in desk.messages)
    assert "Refine all comes next" in desk.messages[-1]
    assert [work_state(o) for o in desk.session.state.objects] == ["placed", "placed"]
    assert BY_ID["refine_all"].enabled(desk.controller)
    assert len(desk.session.steps) == 1
    desk.close()


def test_dialog_wants_a_folder_or_a_file(root: Path) -> None:
    desk, shown = Desk(root / "b"), []
    dialogs = Dialogs(desk.controller, shown.append)
    for answers, problem in (
        ({"scene": "", "folder": ""}, "name the folder of the other scene"),
        ({"scene": "", "folder": str(root / "none")}, "no scene here"),
        ({"by": "points"}, "name the file of points"),
    ):
        dialogs.ask("carry")
        question = next(q for q in reversed(shown) if q is not None)
        dialogs.answer(question.number, "carry", question.first_answers() | answers)
        desk.wait_until_idle()
        assert problem in desk.messages[-1]
    assert not desk.session.unsaved
    desk.close()
