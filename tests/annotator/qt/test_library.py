"""Meshes come into the library and onto the image."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from bench import Bench
from numpy.typing import NDArray
from PySide6.QtCore import QMimeData, Qt, QUrl
from PySide6.QtGui import QImage
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QDialog, QLabel, QRadioButton
from window_scene import write_box

from annotator.app import mesh_import
from annotator.app.mesh_folder import choose_folder
from annotator.qt.library_panel import MODEL_MIME
from annotator.qt.object_panel import OBJECT_MIME
from annotator.qt.question_dialog import QuestionDialog


def _dragged(mime: str, text: str) -> QMimeData:
    data = QMimeData()
    data.setData(mime, text.encode())
    return data


def _files(*paths: Path) -> QMimeData:
    data = QMimeData()
    data.setUrls([QUrl.fromLocalFile(str(p)) for p in paths])
    return data


def _idle(bench: Bench) -> None:
    bench.qtbot.waitUntil(lambda: bench.controller.task is None, timeout=20_000)


@pytest.mark.parametrize("slot", [0, 1])
def test_a_mesh_dropped_on_an_image_lands_under_the_pointer(bench: Bench, slot: int) -> None:
    place = bench.at((220, 120), slot)
    bench.drop(_dragged(MODEL_MIME, "ball"), bench.widget(slot), place)
    frame = bench.controller.view_frames[slot]
    # The ball of the scene had no pose: it is placed, and no second one is made.
    assert [o.name for o in bench.session.state.objects] == ["box_1", "ball_1"]
    assert bench.controller.selected == "ball_1"
    seen = bench.view(slot).recorded_camera.project(bench.pose("ball_1", frame).t)
    assert np.abs(seen - [220, 120]).max() < 45
    assert len(bench.session.steps) == 1


def test_another_mesh_of_the_same_kind_is_another_object_in_one_edit(bench: Bench) -> None:
    bench.drop(_dragged(MODEL_MIME, "box"), bench.widget(), bench.at((80, 120)))
    names = [o.name for o in bench.session.state.objects]
    assert names == ["box_1", "ball_1", "box"]
    assert bench.session.pose("box", 0) is not None
    bench.press("z", Qt.KeyboardModifier.ControlModifier)
    assert [o.name for o in bench.session.state.objects] == ["box_1", "ball_1"]


def test_an_object_dragged_from_the_list_keeps_how_it_is_turned(bench: Bench) -> None:
    before = bench.pose()
    bench.drop(_dragged(OBJECT_MIME, "box_1"), bench.widget(), bench.at((230, 150)))
    np.testing.assert_allclose(bench.pose().R, before.R, atol=1e-12)
    assert np.linalg.norm(bench.pose().t - before.t) > 0.02


def test_a_double_click_in_the_library_places_the_mesh(bench: Bench) -> None:
    meshes = bench.space.library.list
    item = next(meshes.item(i) for i in range(meshes.count()) if meshes.item(i).text() == "ball")
    place = meshes.visualItemRect(item).center()
    QTest.mouseClick(meshes.viewport(), Qt.MouseButton.LeftButton, pos=place)
    QTest.mouseDClick(meshes.viewport(), Qt.MouseButton.LeftButton, pos=place)
    assert bench.session.pose("ball_1", 0) is not None


def test_a_mesh_file_dropped_on_the_library_joins_it(bench: Bench, tmp_path: Path) -> None:
    bench.drop(_files(write_box(tmp_path / "brick.obj")), bench.space.library, bench.at((5, 5)))
    _idle(bench)
    assert bench.session.state.model("brick").size_m == pytest.approx([0.06, 0.04, 0.02])
    assert "60.0 x 40.0 x 20.0 mm" in bench.message()
    assert bench.questions == []


def test_a_mesh_in_millimetres_is_asked_about_and_stored_in_metres(
    bench: Bench, tmp_path: Path
) -> None:
    bench.answering("mm")
    bench.space.library.files_dropped.emit([write_box(tmp_path / "brick.obj", scale=1000)])
    _idle(bench)
    (question,) = bench.questions
    assert "brick.obj is not in metres" in question
    assert "60 × 40 × 20 m large" in question
    assert "As millimetres it is 60 × 40 × 20 mm." in question
    assert bench.session.state.model("brick").size_m == pytest.approx([0.06, 0.04, 0.02])


def test_declining_leaves_the_library_as_it_is(bench: Bench, tmp_path: Path) -> None:
    bench.answering("cancel")
    bench.space.library.files_dropped.emit([write_box(tmp_path / "brick.obj", scale=1000)])
    _idle(bench)
    assert [m.id for m in bench.session.state.models] == ["ball", "box"]
    assert not (bench.session.scene.root / "models" / "brick").exists()


def test_an_unreadable_mesh_is_a_message(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "broken.ply"
    path.write_bytes(b"ply\nnot really")
    bench.space.library.files_dropped.emit([path])
    _idle(bench)
    assert "broken.ply" in bench.message()
    assert [m.id for m in bench.session.state.models] == ["ball", "box"]


def test_an_empty_scene_tells_what_to_do_first(
    open_bench: Callable[..., Bench], tmp_path: Path
) -> None:
    from window_scene import write_window_scene

    from std_toolkit.scene import ObjectTable, Scene

    root = write_window_scene(tmp_path / "bare", labelled=False)
    Scene.open(root).save_objects(ObjectTable())
    bench = open_bench(root)
    assert bench.space.library.stack.currentIndex() == 1
    assert bench.space.objects.stack.currentIndex() == 1
    assert "Add mesh" in bench.space.status.hint.text()
    # What to do stands where one looks, and in the status line: the panels tell how things are.
    told = "\n".join(label.text() for label in bench.space.side.findChildren(QLabel))
    assert "Ctrl+M" not in told
    assert "onto the image" not in told
    bench.space.library.files_dropped.emit([write_box(tmp_path / "brick.obj")])
    _idle(bench)
    bench.qtbot.waitUntil(lambda: "Drag a mesh" in bench.space.status.hint.text())


def test_names_notes_and_materials_are_edits(bench: Bench) -> None:
    def type_name(dialog: QDialog) -> None:
        assert isinstance(dialog, QuestionDialog)
        QTest.keyClicks(dialog.widgets["name"], "cereal")
        QTest.keyClick(dialog.widgets["name"], Qt.Key.Key_Return)

    bench.in_dialog(type_name)
    bench.press(Qt.Key.Key_F2)
    assert bench.session.object("cereal").model == "box"
    assert bench.controller.selected == "cereal"
    panel = bench.space.objects
    panel.material.setCurrentText("specular")
    panel.material.activated.emit(panel.material.currentIndex())
    assert bench.session.object("cereal").material == "specular"
    bench.press("z", Qt.KeyboardModifier.ControlModifier)
    assert bench.session.object("cereal").material == "diffuse"
    bench.press(Qt.Key.Key_Delete, Qt.KeyboardModifier.ShiftModifier)
    assert [o.name for o in bench.session.state.objects] == ["ball_1"]


def test_a_note_is_kept_and_shown(bench: Bench) -> None:
    def write(dialog: QDialog) -> None:
        assert isinstance(dialog, QuestionDialog)
        QTest.keyClicks(dialog.widgets["note"], "look at the cap again")
        dialog.buttons["keep"].click()

    bench.in_dialog(write)
    bench.press(Qt.Key.Key_F3)
    assert bench.session.object("box_1").note == "look at the cap again"
    row = bench.space.objects.model.rows[0]
    assert row.noted
    assert "look at the cap again" in row.explanation
    assert "look at the cap again" in bench.space.pose.provenance.text()


def test_a_symmetry_is_set_for_the_mesh(bench: Bench) -> None:
    def choose(dialog: QDialog) -> None:
        assert isinstance(dialog, QuestionDialog)
        wanted = next(b for b in dialog.findChildren(QRadioButton) if "box" in b.text())
        wanted.setChecked(True)
        dialog.buttons["set"].click()

    bench.in_dialog(choose)
    bench.press(Qt.Key.Key_F4)
    symmetry = bench.session.state.model("box").symmetry
    assert len(symmetry.discrete) == 3
    bench.press("z", Qt.KeyboardModifier.ControlModifier)
    assert bench.session.state.model("box").symmetry.discrete == []


def test_meshes_are_named_after_their_folder_where_the_file_says_nothing(
    bench: Bench, tmp_path: Path
) -> None:
    (tmp_path / "006_mustard_bottle").mkdir()
    path = write_box(tmp_path / "006_mustard_bottle" / "textured.obj")
    bench.space.library.files_dropped.emit([path])
    _idle(bench)
    assert bench.session.state.models[0].id == "006_mustard_bottle"


def test_a_folder_dropped_on_the_library_is_listed_and_copied_from_when_placed(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    name = "006_mustard_bottle_with_a_long_name"
    folder = tmp_path / "meshes"
    for i, sub in enumerate((name, "brick")):
        (folder / sub).mkdir(parents=True)
        write_box(folder / sub / "textured.obj", scale=1 + i)
    panel = bench.space.library
    bench.drop(_files(folder), panel, bench.at((5, 5)))
    texts = [panel.list.item(i).text() for i in range(panel.list.count())]
    assert texts == ["ball", "box", name, "brick"]
    item = panel.list.item(2)
    assert name in item.toolTip()
    assert str(folder / name / "textured.obj") in item.toolTip()
    # Their pictures are drawn too; until then there is a smaller sign.
    bench.qtbot.waitUntil(lambda: item.icon().availableSizes()[0].width() >= 60, timeout=30_000)
    assert [m.id for m in bench.session.state.models] == ["ball", "box"]
    bench.drop(_dragged(MODEL_MIME, name), bench.widget(), bench.at((80, 120)))
    bench.qtbot.waitUntil(lambda: bench.controller.selected == name, timeout=20_000)
    assert bench.session.state.model(name).mesh == f"models/{name}/textured.obj"
    assert bench.questions == []
    remembered = choose_folder(None)
    assert remembered is not None and remembered.path == folder


def test_another_mesh_of_the_same_name_gets_a_number_and_the_same_one_does_not(
    bench: Bench, tmp_path: Path
) -> None:
    one = write_box(tmp_path / "brick.obj")
    (tmp_path / "other").mkdir()
    other = write_box(tmp_path / "other" / "brick.obj", scale=2)
    bench.space.library.files_dropped.emit([one, other])
    _idle(bench)
    bench.space.library.files_dropped.emit([one])
    _idle(bench)
    assert [m.id for m in bench.session.state.models] == ["ball", "box", "brick", "brick_2"]


def test_another_mesh_of_the_same_name_has_another_picture(bench: Bench, tmp_path: Path) -> None:
    """As when the first one was taken back."""
    path, panel = tmp_path / "brick.obj", bench.space.library

    def picture() -> NDArray[np.uint8] | None:
        """What the list shows of it."""
        found = panel.list.findItems("brick", Qt.MatchFlag.MatchExactly)
        if not found:
            return None
        image = found[0].icon().pixmap(60).toImage().convertToFormat(QImage.Format.Format_RGB888)
        return np.frombuffer(image.constBits(), np.uint8).copy()

    def add(extents: tuple[int, int, int]) -> NDArray[np.uint8]:
        trimesh.creation.box(extents).export(path)
        mesh_import.import_meshes(bench.controller, [mesh_import.NewMesh(path, "mm")])
        _idle(bench)
        # Until its picture is drawn there is a smaller sign.
        bench.qtbot.waitUntil(lambda: len(picture()) == 60 * 60 * 3, timeout=30_000)
        drawn = picture()
        assert drawn is not None
        return drawn

    lying = add((60, 40, 20))
    bench.controller.undo()
    assert picture() is None
    assert (add((20, 40, 60)) != lying).any()
