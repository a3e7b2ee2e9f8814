"""Nothing that was edited is lost: saving, closing, recovering, and others who write meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bench import Bench
from PySide6.QtCore import Qt

from annotator.session import Session
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.labels.entry.label import set_pose
from std_toolkit.scene import Scene

Key = Qt.Key
CONTROL = Qt.KeyboardModifier.ControlModifier
OpenBench = Callable[..., Bench]


def test_saved_labels_are_there_when_the_scene_is_opened_again(
    bench: Bench, open_bench: OpenBench, root: Path
) -> None:
    assert bench.space.status.saved.text() == "saved"
    bench.press(Key.Key_Right)
    bench.press("d")
    bench.qtbot.waitUntil(lambda: bench.session.object("box_1").status == "done", timeout=30_000)
    bench.qtbot.waitUntil(lambda: "not saved" in bench.space.status.saved.text())
    assert bench.shell.isWindowModified()
    bench.press("s", CONTROL)
    bench.qtbot.waitUntil(lambda: bench.space.status.saved.text() == "saved")
    assert "Saved: labels of box_1" in bench.message()
    pose = bench.pose().flat()
    bench.leave()
    label = Scene.open(root).labels.of(1)
    assert label is not None
    assert label.T_cam_obj == pose
    assert label.annotator == "mk"
    again = open_bench(root)
    assert again.questions == []
    assert again.pose().flat() == pose
    assert again.session.object("box_1").status == "done"


def test_closing_with_unsaved_edits_asks_and_keeps_them_for_next_time(
    bench: Bench, open_bench: OpenBench, root: Path
) -> None:
    bench.press(Key.Key_Right)
    bench.press(Key.Key_Down)
    pose = bench.pose().flat()
    bench.leave("keep")
    assert "2 edits are not saved" in bench.questions[0]
    assert Scene.open(root).labels.of(1).T_cam_obj != pose  # type: ignore[union-attr]

    again = open_bench()
    again.answering("recover")
    assert again.open(root)
    assert "2 edits by mk" in again.questions[0]
    assert again.pose().flat() == pose
    again.press("z", CONTROL)
    again.press("z", CONTROL)
    assert again.session.undoable is None


def test_closing_can_save_or_be_called_off(bench: Bench, open_bench: OpenBench, root: Path) -> None:
    bench.press(Key.Key_Right)
    bench.answering("cancel")
    assert not bench.shell.close()
    assert bench.shell.isVisible()
    bench.press(Key.Key_Right)
    pose = bench.pose().flat()
    bench.answering("save")
    assert bench.shell.close()
    assert open_bench(root).pose().flat() == pose


def test_discarded_edits_are_kept_aside(bench: Bench, open_bench: OpenBench, root: Path) -> None:
    before = bench.pose().flat()
    bench.press(Key.Key_Right)
    bench.leave("keep")
    files = {p for p in (root / ".std").rglob("*") if p.is_file()}
    again = open_bench()
    again.answering("discard")
    assert again.open(root)
    assert again.pose().flat() == before
    assert len({p for p in (root / ".std").rglob("*") if p.is_file()}) >= len(files)


def test_deciding_later_leaves_everything_as_it_is(
    bench: Bench, open_bench: OpenBench, root: Path
) -> None:
    bench.press(Key.Key_Right)
    pose = bench.pose().flat()
    bench.leave("keep")
    again = open_bench()
    again.answering("cancel")
    assert not again.open(root)
    assert again.shell.start_page is not None
    again.answering("recover")
    assert again.open(root)
    assert again.pose().flat() == pose


@pytest.mark.parametrize("answer", ["mine", "theirs"])
def test_a_conflict_is_decided_by_the_person(
    bench: Bench, open_bench: OpenBench, root: Path, answer: str
) -> None:
    bench.press(Key.Key_Right)
    mine = bench.pose().flat()
    other = Scene.open(root)
    with other.lock():
        T = SE3.from_matrix(mine)
        theirs = SE3(T.R, T.t + np.array([0, 0.05, 0]))
        set_pose(other, "box_1", 0, theirs, annotator="other")
    bench.answering("cancel")
    bench.press("s", CONTROL)
    assert "box_1" in bench.questions[0]
    assert bench.session.unsaved
    bench.answering(answer)
    bench.press("s", CONTROL)
    assert not bench.session.unsaved
    expected = mine if answer == "mine" else theirs.flat()
    assert Scene.open(root).labels.of(1).T_cam_obj == pytest.approx(expected)  # type: ignore[union-attr]
    assert bench.pose().flat() == pytest.approx(expected)


def test_propagation_carries_the_labels_and_reports(bench: Bench, root: Path) -> None:
    bench.press(Key.Key_Right)
    bench.answering("go")
    bench.press("p", CONTROL)
    bench.qtbot.waitUntil(
        lambda: bench.controller.task is None and "Carried" in bench.message(), timeout=20_000
    )
    assert "ball_1" not in bench.questions[0]
    assert "Not marked as done yet: box_1" in bench.questions[0]
    label = Scene.open(root).labels.of(1)
    assert label is not None and label.T_world_obj is not None
    expected = bench.session.T_world_obj("box_1")
    assert expected is not None
    assert label.T_world_obj == pytest.approx(expected.flat())


def test_an_edit_while_propagating_is_refused(bench: Bench) -> None:
    import threading

    go_on = threading.Event()
    before = bench.pose().flat()
    bench.controller.start("Propagate", lambda _: go_on.wait(10), lambda _: None, alone=True)
    bench.press(Key.Key_Right)
    assert bench.pose().flat() == before
    assert "wait until it is done" in bench.message()
    assert not bench.shell.close()
    go_on.set()
    bench.qtbot.waitUntil(lambda: bench.controller.task is None)
    bench.press(Key.Key_Right)
    assert bench.pose().flat() != before


def test_the_scene_is_nobody_else_s_before_its_labels_are_propagated(
    bench: Bench, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import threading

    from std_toolkit.labels import propagate

    go_on, real = threading.Event(), propagate.propagate_labels

    def held(scene: Scene, *args: object) -> object:
        assert go_on.wait(30)
        return real(scene, *args)  # type: ignore[arg-type]

    monkeypatch.setattr(propagate, "propagate_labels", held)
    bench.answering("go")
    bench.press("p", CONTROL)
    bench.qtbot.waitUntil(lambda: bench.controller.task is not None)
    for _ in range(2):  # who is told to wait tries again
        assert not bench.shell.close()
        assert "wait until it is done" in bench.message()
        with pytest.raises(ToolkitError, match="another process is annotating"):
            Session.open(root, annotator="next")
    go_on.set()
    bench.qtbot.waitUntil(lambda: bench.controller.task is None, timeout=20_000)
    assert bench.shell.close()
    with Session.open(root, annotator="next") as session:
        assert session.recovery is None
    label = Scene.open(root).labels.of(1)
    assert label is not None and label.T_world_obj is not None


def test_closing_while_something_is_computed_is_safe(bench: Bench, root: Path) -> None:
    import time

    ended = []

    def work(task: object) -> None:
        while not task.cancelled:  # type: ignore[attr-defined]
            time.sleep(0.01)
        ended.append(True)

    bench.controller.start("Refine box_1", work, lambda _: ended.append("finished"))
    bench.qtbot.waitUntil(lambda: bench.space.status.progress.isVisible())
    assert bench.shell.close()
    assert ended == [True]
    with Session.open(root, annotator="next") as session:
        assert session.writable
