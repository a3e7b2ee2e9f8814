"""What the panels and the status line tell, and what they do not."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest
import trimesh
from bench import Bench
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from annotator.app import mesh_import
from annotator.app.object_summary import summarize
from annotator.session import AddObject
from annotator.session.residuals import FrameResidual
from std_toolkit.checks.measure.ranking import PoseRank
from std_toolkit.labels.texture.comparison import TextureComparison


@pytest.mark.parametrize("alone", [True, False])
def test_what_cannot_be_stopped_has_no_button_for_it(bench: Bench, alone: bool) -> None:
    go_on = threading.Event()
    status = bench.space.status
    bench.controller.start("Work", lambda _: go_on.wait(20), lambda _: None, alone=alone)
    bench.qtbot.waitUntil(status.progress.isVisible)
    assert status.cancel.isVisible() is not alone
    bench.qtbot.waitUntil(lambda: status.hint.text().startswith("Work is running"))
    go_on.set()
    bench.qtbot.waitUntil(lambda: not status.progress.isVisible())
    assert not status.cancel.isVisible()


def test_residuals_alone_are_not_called_a_fit(bench: Bench) -> None:
    """A median in depth is forgiving, and in clutter any contour lies near an edge."""
    c, panel = bench.controller, bench.space.evidence
    c.residuals["box_1"] = [
        FrameResidual(0, 900, edge_px=1.4, edge_chance_px=1.6, depth_mm=-10.0),
        FrameResidual(1, 900, edge_px=None, depth_mm=-12.0),
    ]
    panel.refresh()
    assert panel.reason.text().startswith("Not judged yet")
    row = summarize(c)[0]
    assert row.badge == "11 mm"
    assert "check the contour by eye" in row.explanation
    c.residuals["box_1"][0] = FrameResidual(0, 900, edge_px=0.6, edge_chance_px=4.0, depth_mm=-2.0)
    c.residuals["box_1"][1] = FrameResidual(1, 900, edge_px=0.7, edge_chance_px=4.0)
    c.ranks["box_1"] = PoseRank(200, 200, (0, 1), (0, 1), -0.1, 0.6)
    c.textures["box_1"] = TextureComparison("fits", None, "", 0.6, float("nan"), 2)
    panel.refresh()
    assert panel.reason.text().startswith("Not judged yet")
    assert summarize(c)[0].grade != "fits"


def test_without_an_object_there_is_no_material(bench: Bench) -> None:
    panel = bench.space.objects
    assert panel.material.currentText() == "diffuse"
    bench.controller.select(None)
    assert panel.material.currentText() == ""
    assert not panel.material.isEnabled()
    bench.controller.select("ball_1")
    assert panel.material.currentText() == "transparent"


def test_thumbnails_stand_in_even_columns(bench: Bench, tmp_path: Path) -> None:
    files = []
    for name in ("a", "a_mesh_with_a_long_name", "b"):
        trimesh.creation.box((0.06, 0.04, 0.02 * (1 + len(files)))).export(tmp_path / f"{name}.ply")
        files.append(mesh_import.NewMesh(tmp_path / f"{name}.ply"))
    mesh_import.import_meshes(bench.controller, files)
    meshes = bench.space.library.list
    bench.qtbot.waitUntil(lambda: meshes.count() == 5, timeout=20_000)

    def drawn() -> bool:
        """The pictures are there, which are larger than the signs in their places."""
        widths = {meshes.item(i).icon().pixmap(60).width() for i in range(meshes.count())}
        return widths == {60}

    bench.qtbot.waitUntil(drawn, timeout=30_000)
    bench.settle()
    boxes = [meshes.visualItemRect(meshes.item(i)) for i in range(meshes.count())]
    rows = {b.top() for b in boxes}
    for top in rows:
        lefts = [b.center().x() for b in boxes if b.top() == top]
        assert len(set(np.diff(lefts))) <= 1


def test_pictures_are_not_begun_anew_with_every_edit(bench: Bench, tmp_path: Path) -> None:
    asked = []
    start_aside = bench.controller.start_aside

    def noted(key: str, *args: object, **options: object) -> None:
        asked.append(key)
        start_aside(key, *args, **options)  # type: ignore[arg-type]

    bench.controller.start_aside = noted  # type: ignore[method-assign]
    path = tmp_path / "brick.ply"
    trimesh.creation.box((0.06, 0.04, 0.02)).export(path)
    mesh_import.import_meshes(bench.controller, [mesh_import.NewMesh(path)])
    bench.qtbot.waitUntil(lambda: bench.space.library.list.count() == 3, timeout=20_000)
    # The pictures of the opening may have been asked for in between, too.
    bench.qtbot.waitUntil(lambda: "Thumbnails" in asked, timeout=20_000)
    before = asked.count("Thumbnails")
    for _ in range(3):
        bench.controller.nudge(shift=(1, 0, 0))
    assert asked.count("Thumbnails") == before


def test_the_tip_of_an_object_has_its_whole_name(bench: Bench) -> None:
    """The row cuts names that are wider than the panel."""
    objects = bench.space.objects.list.model()
    tip = objects.data(objects.index(0, 0), Qt.ItemDataRole.ToolTipRole)
    assert tip.startswith("box_1 (box)\n")


def test_a_long_list_of_objects_is_searched(bench: Bench) -> None:
    panel = bench.space.objects
    assert not panel.search.isVisible()
    known = [r.name for r in panel.model.rows]
    for k in range(2, 9):
        bench.session.apply(AddObject(object=f"box_{k}", model="box", material="specular"))
    bench.settle()
    assert panel.search.isVisible()
    colours = {r.name: panel.model.color(r) for r in panel.model.rows}
    bench.controller.select("box_1")
    QTest.keyClicks(panel.search, "specular not")
    shown = [r.name for r in panel.model.rows]
    assert shown == [f"box_{k}" for k in range(2, 9)]
    assert {r.name: panel.model.color(r) for r in panel.model.rows}.items() <= colours.items()
    # The selection stays, though it is not shown.
    assert bench.controller.selected == "box_1"
    assert panel.material.isEnabled()
    panel.search.clear()
    assert [r.name for r in panel.model.rows] == [*known, *shown]
    panel.search.setText("nothing of this name")
    assert panel.model.rows == []
