"""What cannot be opened, or lacks something, is told in the window."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from bench import Bench
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from window_scene import write_window_scene

from annotator.app.view_options import Mode
from annotator.session import Session
from std_toolkit.scene import Scene

OpenBench = Callable[..., Bench]
LEFT = Qt.MouseButton.LeftButton


def test_without_a_scene_the_start_page_offers_the_recent_ones(
    open_bench: OpenBench, root: Path
) -> None:
    first = open_bench(root)
    assert first.shell.windowTitle() == "bench · mk · std-annotate[*]"
    first.leave()
    bench = open_bench()
    page = bench.shell.start_page
    assert page is not None
    assert page.recent.count() == 1
    assert page.recent.item(0).text().startswith(root.name)
    place = page.recent.visualItemRect(page.recent.item(0)).center()
    QTest.mouseClick(page.recent.viewport(), LEFT, pos=place)
    assert bench.session.scene.info.name == "bench"


def test_a_second_session_is_told_who_holds_the_scene(open_bench: OpenBench, root: Path) -> None:
    with Session.open(root, annotator="anna") as held:
        bench = open_bench()
        assert not bench.open(root)
        page = bench.shell.start_page
        assert page is not None
        assert page.problem.isVisible()
        assert "another process is annotating" in page.problem.text.text().lower()
        assert "anna" in page.problem.text.text()
        QTest.mouseClick(page.problem.look, LEFT)
        bench.settle()
        assert not bench.session.writable
        assert held.writable


def test_a_scene_that_is_free_again_opens_on_the_next_try(
    open_bench: OpenBench, root: Path
) -> None:
    bench = open_bench()
    with Session.open(root):
        assert not bench.open(root)
    page = bench.shell.start_page
    assert page is not None
    QTest.mouseClick(page.problem.again, LEFT)
    assert bench.session.writable


def test_a_folder_that_cannot_be_written_opens_for_looking(
    open_bench: OpenBench, root: Path
) -> None:
    # A file in the place of the folder for locks and journals: not even root can write there.
    (root / ".std").write_text("")
    bench = open_bench()
    assert not bench.open(root)
    page = bench.shell.start_page
    assert page is not None
    assert "cannot write" in page.problem.text.text().lower()
    QTest.mouseClick(page.problem.look, LEFT)
    bench.settle()
    before = bench.pose().flat()
    bench.press(Qt.Key.Key_Right)
    bench.drag(bench.on_object(), bench.on_object() / 10)
    assert bench.pose().flat() == before
    assert bench.space.status.saved.text() == "read-only"
    assert not bench.space.commands.actions["save"].isEnabled()
    assert not bench.space.pose.position[0].isEnabled()


def test_a_damaged_document_is_named(open_bench: OpenBench, root: Path) -> None:
    (root / "labels.json").write_text('{"labels": [{"object": "one"}]}')
    bench = open_bench()
    assert not bench.open(root)
    page = bench.shell.start_page
    assert page is not None
    assert "labels.json" in page.problem.text.text()
    assert not page.problem.look.isVisible()


def test_no_scene_there_is_told(open_bench: OpenBench, tmp_path: Path) -> None:
    bench = open_bench()
    assert not bench.open(tmp_path)
    page = bench.shell.start_page
    assert page is not None
    assert "scene.json" in page.problem.text.text()


def test_a_missing_image_is_told_in_its_view_and_the_others_go_on(
    open_bench: OpenBench, root: Path
) -> None:
    scene = Scene.open(root)
    scene.color_path(scene.frame(1)).unlink()
    bench = open_bench(root)
    bench.press(Qt.Key.Key_Right, Qt.KeyboardModifier.ControlModifier)
    assert bench.controller.frame == 1
    bench.settle()
    before = bench.pose(frame=1)
    bench.press(Qt.Key.Key_Right)
    assert bench.pose(frame=1).t[0] == pytest.approx(before.t[0] + 0.001)
    bench.press(Qt.Key.Key_Right, Qt.KeyboardModifier.ControlModifier)
    assert bench.controller.frame == 2


def test_a_scene_without_depth_has_no_cloud_but_everything_else(
    open_bench: OpenBench, tmp_path: Path
) -> None:
    bench = open_bench(write_window_scene(tmp_path / "flat", depth=False))
    bench.press(Qt.Key.Key_Tab)
    assert bench.controller.mode is Mode.CLOUD
    bench.settle()
    before = bench.pose()
    bench.press(Qt.Key.Key_Right)
    assert bench.pose().t[0] == pytest.approx(before.t[0] + 0.001)
    bench.press(Qt.Key.Key_Tab)
    assert bench.controller.mode is Mode.IMAGE


def test_a_scene_without_camera_poses_is_labelled_frame_by_frame(
    open_bench: OpenBench, tmp_path: Path
) -> None:
    bench = open_bench(write_window_scene(tmp_path / "loose", posed=False))
    texts = [m.text for m in bench.space.banner.messages]
    assert any("each frame is labelled on its own" in t for t in texts)
    assert not bench.space.commands.actions["propagate"].isEnabled()
    assert bench.session.pose("box_1", 3) is None
    bench.controller.show_frame(3)
    assert "no pose" in bench.space.pose.provenance.text()
