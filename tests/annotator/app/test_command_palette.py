"""The list of commands: what it finds for a word, and what it says of what cannot be done."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from desk_without_window import Desk
from scene_on_disk import write_scene

from annotator.app.action_table import BY_ID, available_actions
from annotator.app.command_palette import MOST, SELF, commands, run
from annotator.app.dialogs import Dialogs
from std_toolkit.errors import ToolkitError


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    write_scene(tmp_path / "scene")
    desk = Desk(tmp_path / "scene")
    Dialogs(desk.controller, lambda _: None)
    yield desk
    desk.close()


def test_every_action_is_found_by_its_title_with_keys_and_menu(desk: Desk) -> None:
    for action in available_actions(desk.controller.dialogs):
        title = action.title if action.label is None else action.label(desk.controller)
        found = [r for r in commands(desk.controller, title) if r.target == action.id]
        if action.id == SELF:
            assert found == []
            continue
        (row,) = found
        assert row.title == title
        assert row.where.split("/")[0] == action.menu
        assert all(key in row.keys for key in action.keys)


def test_what_begins_with_the_word_comes_first(desk: Desk) -> None:
    titles = [r.title for r in commands(desk.controller, "re")]
    assert titles[0].startswith("Re")
    assert titles.index("Refine all objects") < titles.index("More transparent")
    assert [r.target for r in commands(desk.controller, "ALL refine")] == ["refine_all"]
    assert commands(desk.controller, "no such thing") == []
    assert len(commands(desk.controller)) <= MOST


def test_what_cannot_be_done_says_why(desk: Desk) -> None:
    def why(id: str) -> str:
        (row,) = [r for r in commands(desk.controller, BY_ID[id].title) if r.target == id]
        return row.problem

    c = desk.controller
    assert why("refine") == "no object is selected"
    assert why("undo") == "there is no edit to take back"
    c.select("box_1")
    assert why("refine") == ""
    c.nudge(shift=(1, 0, 0))
    BY_ID["unplace"].run(c)
    assert why("refine") == "box_1 has no pose in frame 0"
    assert why("solve_points") == "no points of box_1 are clicked in frame 0"
    # What is greyed out in a menu has a reason, and nothing else has.
    for action in available_actions(c.dialogs):
        assert action.enabled(c) == (action.problem(c) == "")


def test_objects_are_selected_and_frames_shown(desk: Desk) -> None:
    c = desk.controller
    (row,) = commands(c, "select box")
    assert (row.kind, row.title, row.where) == ("object", "Select box_1", "Objects")
    run(c, row.kind, row.target)
    assert c.selected == "box_1"
    last = c.session.scene.frames[-1].id
    row = commands(c, f"frame {last}")[0]
    assert row.title == f"Frame {last}"
    run(c, row.kind, row.target)
    assert c.frame == last
    assert commands(c, f"frame {last}")[0].problem == "it is in the main view"


def test_running_what_is_gone_or_cannot_be_done_changes_nothing(desk: Desk) -> None:
    c = desk.controller
    with pytest.raises(ToolkitError):
        run(c, "object", "nobody")
    for frame in ("99999", "-3", "x"):
        with pytest.raises(ToolkitError):
            run(c, "frame", frame)
    run(c, "action", "no such action")
    run(c, "action", "refine")
    assert desk.messages == ["Refine: no object is selected."]
    assert len(c.session.steps) == 0
