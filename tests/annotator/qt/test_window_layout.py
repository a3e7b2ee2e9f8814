"""How the window is divided, and what it remembers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from bench import Bench
from PySide6.QtCore import QPoint, Qt
from PySide6.QtTest import QTest

OpenBench = Callable[..., Bench]


def test_everything_fits_into_1280_by_720(bench: Bench) -> None:
    assert (bench.shell.width(), bench.shell.height()) == (1280, 720)
    area = bench.shell.rect()
    space = bench.space
    for part in (
        space.toolbar,
        space.objects.list,
        space.evidence.reason,
        space.pose.copy_button,
        space.frame_bar.strip,
        space.status.saved,
        *(tile.view for tile in space.views.tiles),
    ):
        assert part.isVisible()
        corner = part.mapTo(bench.shell, QPoint(part.width() - 1, part.height() - 1))
        assert area.contains(corner), part
    # The main view has more than half of the width.
    assert bench.widget().width() > 0.5 * bench.shell.width()
    assert bench.widget().width() > 2.5 * bench.widget(1).width()


def test_the_side_views_look_from_elsewhere(bench: Bench) -> None:
    frames = bench.controller.view_frames
    assert frames[0] == 0
    assert len(set(frames)) == 4
    # The far end of the arc is among them.
    assert 5 in frames


def test_messages_leave_the_views_their_size(bench: Bench) -> None:
    size = bench.widget().size()
    bench.controller.tell("The mug runs into the bowl.", "warning")
    bench.controller.tell("Something failed.", "error")
    bench.settle()
    assert bench.space.banner.isVisible()
    assert bench.widget().size() == size
    QTest.mouseClick(bench.space.banner.messages[0].close_button, Qt.MouseButton.LeftButton)
    assert [m.text for m in bench.space.banner.messages] == ["Something failed."]


def test_messages_that_come_one_after_the_other_can_all_be_read(bench: Bench) -> None:
    for text in ("Click a point on the mesh first.", "5 of 5 points fit. " * 20):
        bench.controller.tell(text, "warning")
        bench.settle()
    banner = bench.space.banner
    for message in banner.messages:
        assert message.height() >= message.heightForWidth(message.width())
    assert banner.messages[1].height() > banner.messages[0].height()


def test_the_same_message_is_told_once(bench: Bench) -> None:
    for _ in range(3):
        bench.controller.tell("Select an object first.", "warning")
    assert [m.text for m in bench.space.banner.messages] == ["Select an object first."]


def test_a_click_in_the_strip_shows_that_frame(bench: Bench) -> None:
    strip = bench.space.frame_bar.strip
    place = QPoint(round(strip.x_of(3)), strip.height() // 2)
    QTest.mouseClick(strip, Qt.MouseButton.LeftButton, pos=place)
    bench.qtbot.waitUntil(lambda: bench.controller.frame == 3)
    assert bench.space.frame_bar.number.value() == 3
    assert bench.space.frame_bar.label.text() == "4 of 6 · 000003"


def test_side_views_can_look_at_other_frames(bench: Bench) -> None:
    from PySide6.QtWidgets import QToolButton

    tile = bench.space.views.tiles[1]
    before = bench.controller.view_frames[1]
    later = tile.corner.findChildren(QToolButton)[1]
    QTest.mouseClick(later, Qt.MouseButton.LeftButton)
    assert bench.controller.view_frames[1] == before + 1
    assert bench.controller.frame == 0


def test_the_window_comes_back_as_it_was_left(bench: Bench, open_bench: OpenBench) -> None:
    split = bench.space.views.split
    split.moveSplitter(500, 1)
    bench.settle()
    width = bench.widget().width()
    bench.leave()
    again = open_bench(bench_root(bench))
    assert abs(again.widget().width() - width) <= 2


def bench_root(bench: Bench) -> Path:
    """The scene that was open in a window, which is the latest of the recent ones."""
    from annotator.qt.settings import recent_scenes

    assert bench.shell.controller is None
    return recent_scenes()[0]


def test_a_broken_memory_is_no_trouble(open_bench: OpenBench, root: Path) -> None:
    from annotator.qt.settings import recent_file

    recent_file().parent.mkdir(parents=True)
    recent_file().write_text("{not json")
    recent_file().with_name("window.json").write_text('["list"]')
    assert open_bench(root).session.scene.info.name == "bench"


def test_one_key_shows_the_view_in_hand_alone(bench: Bench) -> None:
    tiles = bench.space.views.tiles
    whole = tiles[0].width() + tiles[1].width()
    bench.press("f")
    assert [t.isVisible() for t in tiles] == [True, *[False] * (len(tiles) - 1)]
    bench.press("f")
    assert all(t.isVisible() for t in tiles)
    bench.click(bench.widget(2).rect().topLeft() + bench.at((10, 10), 2), 2)
    narrow = tiles[2].width()
    bench.press("f")
    bench.settle()
    assert [t.slot for t in tiles if t.isVisible()] == [2]
    assert tiles[2].width() > 0.95 * whole > 2 * narrow
    bench.press("f")
    bench.settle()
    assert abs(tiles[2].width() - narrow) < 8


def test_side_views_are_as_wide_as_their_images(bench: Bench) -> None:
    """A wide image would leave bars above and below in a column of a fixed width."""
    area = bench.space.views
    camera = bench.session.scene.camera(bench.session.scene.frames[0])
    tile = area.tiles[1]
    wanted = min(max(tile.height() * camera.width / camera.height, 260), 0.34 * area.width())
    assert tile.width() == pytest.approx(wanted, abs=8)
