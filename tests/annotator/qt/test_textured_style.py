"""The window draws meshes with their texture, without being asked."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from bench import Bench
from window_scene import BOX_SIZE

from annotator.app.view_options import Gizmo

RED, GREEN = (220, 30, 30), (30, 190, 40)


def paint_box(root: Path) -> None:
    """Give the box a red upper and a green lower half."""
    mesh = trimesh.creation.box(BOX_SIZE).subdivide().subdivide()
    upper = np.asarray(mesh.vertices)[:, 1] > 0
    mesh.visual.vertex_colors = np.where(upper[:, None], RED, GREEN).astype(np.uint8)
    mesh.export(root / "models" / "box" / "box.ply")


def shares(bench: Bench, slot: int) -> tuple[float, float]:
    """Shares of reddish and of greenish pixels in a view."""
    picture = bench.view(slot).screenshot().astype(int)
    red = picture[..., 0] - picture[..., 1:].max(axis=2)
    green = picture[..., 1] - picture[..., [0, 2]].max(axis=2)
    return float((red > 40).mean()), float((green > 40).mean())


def test_a_textured_mesh_is_drawn_so_and_key_4_brings_it_back(
    open_bench: Callable[..., Bench], root: Path
) -> None:
    paint_box(root)
    bench = open_bench(root)
    bench.controller.set_tool(gizmo=Gizmo.OFF)  # its handles are red and green
    actions = bench.space.commands.actions
    assert actions["style_textured"].isChecked()
    for slot in range(len(bench.space.views.tiles)):
        red, green = shares(bench, slot)
        assert red > 0.004 and green > 0.004, slot
    bench.press("1")
    bench.qtbot.waitUntil(actions["style_solid"].isChecked)
    bench.settle()
    assert max(shares(bench, 1)) < 0.002
    bench.press("4")
    bench.qtbot.waitUntil(actions["style_textured"].isChecked)
    bench.settle()
    assert min(shares(bench, 1)) > 0.004


def test_the_view_for_points_and_the_library_show_it(
    open_bench: Callable[..., Bench], root: Path
) -> None:
    paint_box(root)
    bench = open_bench(root)
    bench.controller.select("box_1")
    bench.space.tabs.setCurrentWidget(bench.space.points)
    bench.settle()
    bench.qtbot.wait(200)
    picker = bench.space.points.picker.view
    picture = picker.screenshot().astype(int)
    assert ((picture[..., 0] - picture[..., 1]) > 60).mean() > 0.02
    assert ((picture[..., 1] - picture[..., 0]) > 40).mean() > 0.02
