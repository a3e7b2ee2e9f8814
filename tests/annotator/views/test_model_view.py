"""A mesh alone: turned, zoomed, clicked on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import pyvista
import trimesh

from annotator.views import ModelView
from annotator.views.layers import BACKGROUND
from annotator.views.meshes import make_shape


class Bench:
    def __init__(self) -> None:
        self.clicked: list[tuple[float, float, float]] = []
        self.plotter = pyvista.Plotter(off_screen=True, window_size=(300, 240))
        self.view = ModelView(self.plotter, on_click=self.clicked.append)
        self.mesh = trimesh.creation.box((0.06, 0.08, 0.12))
        self.view.show(make_shape(self.mesh))

    def event(self, name: str, x: float, y: float) -> None:
        interactor = self.plotter.iren.interactor
        interactor.SetEventInformation(int(x), int(239 - y), 0, 0, "\0", 0, None)
        interactor.InvokeEvent(f"{name}Event")

    def drag(self, x: float, y: float, dx: float, dy: float, button: str = "Left") -> None:
        self.event(f"{button}ButtonPress", x, y)
        self.event("MouseMove", x + dx / 2, y + dy / 2)
        self.event("MouseMove", x + dx, y + dy)
        self.event(f"{button}ButtonRelease", x + dx, y + dy)


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.view.close()
    bench.plotter.close()


def drawn(bench: Bench) -> np.ndarray:
    paper = (255 * np.array(BACKGROUND)).round()
    return np.abs(bench.view.screenshot() - paper).max(axis=2) > 3


def test_it_is_seen_whole_and_upright(bench: Bench) -> None:
    mask = drawn(bench)
    assert 0.1 < mask.mean() < 0.7
    assert not (mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any())
    up = bench.view.R_eye_obj @ [0, 0, 1.0]
    assert up[1] < -0.8


def test_a_click_gives_the_point_of_the_surface(bench: Bench) -> None:
    bench.event("LeftButtonPress", 150, 120)
    bench.event("LeftButtonRelease", 150, 120)
    (point,) = bench.clicked
    # On a side of the box.
    assert np.abs(np.abs(point) / [0.03, 0.04, 0.06]).max() == pytest.approx(1, abs=1e-5)
    seen = bench.view.screen.project(bench.view.T_eye_obj @ np.array(point))
    assert seen == pytest.approx([150.5, 120.5], abs=1e-4)


def test_a_click_beside_it_gives_nothing(bench: Bench) -> None:
    bench.event("LeftButtonPress", 4, 4)
    bench.event("LeftButtonRelease", 4, 4)
    assert bench.clicked == []


def test_dragging_turns_it_and_clicks_nothing(bench: Bench) -> None:
    before = bench.view.R_eye_obj
    bench.drag(150, 120, 40, 0)
    turn = bench.view.R_eye_obj @ before.T
    assert (turn @ [0, 0, -1.0])[0] == pytest.approx(np.sin(40 * np.pi / 240))
    assert bench.clicked == []


def test_the_wheel_comes_closer_to_what_is_under_the_pointer(bench: Bench) -> None:
    at = np.array([170.5, 90.5])
    point = bench.view.point_at(at)
    assert point is not None
    bench.event("MouseMove", 170, 90)
    for _ in range(4):
        bench.event("MouseWheelForward", 170, 90)
    assert bench.view.zoom > 1.5
    seen = bench.view.screen.project(bench.view.T_eye_obj @ point)
    assert seen == pytest.approx(at, abs=1e-6)


def test_the_other_buttons_shift_it(bench: Bench) -> None:
    before = bench.view.screen
    bench.drag(150, 120, 25, -10, button="Middle")
    after = bench.view.screen
    assert (after.cx - before.cx, after.cy - before.cy) == pytest.approx((25, -10))


def test_points_are_marked(bench: Bench) -> None:
    plain = bench.view.screenshot()
    point = bench.view.point_at(np.array([150.5, 120.5]))
    assert point is not None
    bench.view.set_points([point])
    marked = bench.view.screenshot()
    changed = np.argwhere((plain != marked).any(axis=2))
    assert np.abs(changed - [120, 150]).max(axis=1).min() <= 2
    bench.view.set_points([], pending=point)
    assert (bench.view.screenshot() != marked).any()


def test_another_mesh_is_seen_from_its_front_again(bench: Bench) -> None:
    bench.drag(150, 120, 60, 30)
    bench.view.show(make_shape(trimesh.creation.cylinder(0.03, 0.1)))
    assert (bench.view.R_eye_obj @ [0, 0, 1.0])[1] < -0.8
    bench.view.show(None)
    assert not drawn(bench).any()
