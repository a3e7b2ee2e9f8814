"""A folder of meshes that scenes share: its names, how it is remembered, and what is copied."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from scene_on_disk import write_scene
from test_dialogs import Asker

from annotator.app import dialogs, placing
from annotator.app.mesh_folder import MeshFolder, choose_folder
from annotator.app.tasks import Task
from annotator.options import AnnotateOptions
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import load_mesh


def write_mesh(path: Path, *, size: float = 0.05) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box((size, size, 2 * size)).export(path)
    return path


def write_folder(root: Path) -> Path:
    """Meshes as data sets have them: alone, one folder each, several files each."""
    for name in (
        "mug.stl",
        "006_mustard_bottle/textured.obj",
        "006_mustard_bottle/nontextured.ply",
        "003_cracker_box/google_16k/textured.obj",
        "002_master_chef_can/google_16k/textured.obj",
        "bowl/shape.ply",
        "plate/shape.ply",
        "cups/red.ply",
        "cups/red.glb",
        "cups/blue.ply",
        "a/b/c/too_deep.ply",
        ".hidden/secret.ply",
    ):
        write_mesh(root / name)
    (root / "readme.txt").write_text("not a mesh")
    return root


@pytest.fixture(autouse=True)
def own_configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def asker(tmp_path: Path) -> Iterator[Asker]:
    write_scene(tmp_path / "scene")
    asker = Asker(tmp_path / "scene")
    asker.desk.controller.subscribe(
        lambda e: asker.dialogs.ask(e.text) if e.kind == "ask" else None
    )
    yield asker
    asker.desk.close()


def test_meshes_have_the_names_of_their_folders_where_the_files_say_nothing(
    tmp_path: Path,
) -> None:
    folder = MeshFolder.read(write_folder(tmp_path / "meshes"))
    assert {m.name: str(m.path.relative_to(folder.path)) for m in folder.meshes} == {
        "002_master_chef_can": "002_master_chef_can/google_16k/textured.obj",
        "003_cracker_box": "003_cracker_box/google_16k/textured.obj",
        "006_mustard_bottle": "006_mustard_bottle/textured.obj",
        "blue": "cups/blue.ply",
        "bowl": "bowl/shape.ply",
        "mug": "mug.stl",
        "plate": "plate/shape.ply",
        "red": "cups/red.glb",
    }


def test_a_folder_is_remembered_until_it_is_forgotten(tmp_path: Path) -> None:
    assert choose_folder(None) is None
    write_mesh(tmp_path / "meshes" / "mug.ply")
    given = choose_folder(str(tmp_path / "meshes"))
    assert given is not None
    assert choose_folder(None) == given
    assert choose_folder("none") is None
    assert choose_folder(None) is None


def test_a_remembered_folder_that_is_gone_does_not_stop_the_program(tmp_path: Path) -> None:
    path = write_mesh(tmp_path / "meshes" / "mug.ply")
    assert choose_folder(str(path.parent)) is not None
    path.unlink()
    assert choose_folder(None) is None
    (tmp_path / "config" / "std-toolkit" / "meshes.json").write_text("[")
    assert choose_folder(None) is None


def test_a_folder_without_meshes_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match=r"nowhere.*does not exist"):
        choose_folder(str(tmp_path / "nowhere"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(ToolkitError, match=r"empty.*contains no mesh") as refused:
        choose_folder(str(tmp_path / "empty"))
    assert "\n" not in str(refused.value)
    assert choose_folder(None) is None
    with pytest.raises(ToolkitError, match="--meshes needs a window"):
        AnnotateOptions(scene=tmp_path, script=tmp_path / "edits.json", meshes="none")


def test_a_mesh_is_copied_into_the_scene_when_it_is_placed(asker: Asker, tmp_path: Path) -> None:
    desk, c = asker.desk, asker.desk.controller
    before = [m.id for m in desk.session.state.models]
    asker.dialogs.add_meshes([write_folder(tmp_path / "meshes")])
    assert "8 meshes" in desk.messages[-1]
    assert [m.id for m in desk.session.state.models] == before
    assert not (desk.session.scene.root / "models" / "006_mustard_bottle").exists()
    assert placing.drop_model(c, "006_mustard_bottle", 0, (60.0, 50.0))
    desk.wait(lambda: c.selected == "006_mustard_bottle")
    assert desk.session.pose("006_mustard_bottle", 0) is not None
    assert desk.session.state.model("006_mustard_bottle").mesh.endswith("/textured.obj")
    assert {m.id for m in desk.session.state.models} - {*before} == {"006_mustard_bottle"}
    # A second one is another object of the same model.
    assert placing.add_object(c, "006_mustard_bottle")
    assert desk.session.object("006_mustard_bottle_2").model == "006_mustard_bottle"
    assert asker.shown == []


def test_a_mesh_is_placed_while_something_is_computed(asker: Asker, tmp_path: Path) -> None:
    desk, c = asker.desk, asker.desk.controller
    asker.dialogs.add_meshes([write_folder(tmp_path / "meshes")])
    c.start("Refine box_1", until_cancelled, lambda _: None)
    assert placing.drop_model(c, "006_mustard_bottle", 0, (60.0, 50.0))
    desk.wait(lambda: c.selected == "006_mustard_bottle")
    assert desk.session.pose("006_mustard_bottle", 0) is not None
    assert c.task is not None and c.task.title == "Refine box_1"
    assert not any("still running" in m for m in desk.messages)
    c.cancel()
    desk.wait_until_idle()


def until_cancelled(task: Task) -> None:
    """A computation that ends when it is cancelled."""
    while not task.cancelled:
        time.sleep(0.01)


def test_the_unit_is_asked_for_before_a_mesh_is_placed(asker: Asker, tmp_path: Path) -> None:
    desk, c = asker.desk, asker.desk.controller
    write_mesh(tmp_path / "meshes" / "mug.stl", size=60)
    asker.dialogs.add_meshes([tmp_path / "meshes"])
    placing.add_object(c, "mug")
    desk.wait(lambda: len(asker.shown) == 1)
    asker.answer("mm")
    desk.wait(lambda: c.selected == "mug")
    assert desk.session.state.model("mug").size_m == pytest.approx([0.06, 0.06, 0.12])


@pytest.mark.slow
def test_decimation_is_offered_for_many_faces(
    asker: Asker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dialogs, "MANY_FACES", 1000)
    monkeypatch.setattr(dialogs, "FEWER_FACES", 400)
    desk, path = asker.desk, write_painted_ball(tmp_path / "ball.obj")
    for pressed, faces, kind in (("keep", 1280, "texture"), ("fewer", 400, "vertex")):
        count = len(asker.shown)
        asker.dialogs.add_meshes([path])
        desk.wait(lambda count=count: len(asker.shown) > count)
        question = asker.shown[-1]
        assert question.title == "ball.obj has 1,280 faces"
        assert "texture becomes colours of the vertices" in question.text
        asker.answer(pressed)
        name = "ball" if pressed == "keep" else "ball_2"
        desk.wait(lambda name=name: any(m.id == name for m in desk.session.state.models))
        mesh = desk.session.mesh(name)
        assert (len(mesh.faces), mesh.visual.kind) == (faces, kind)
        assert desk.session.state.model(name).size_m == pytest.approx([0.1] * 3, rel=0.03)
    colors = np.asarray(
        load_mesh(desk.session.scene.root / "models/ball_2/ball.ply").visual.vertex_colors
    )
    above = mesh.vertices[:, 2] > 0.02
    assert colors[above, 0].min() > 200 > 50 > colors[above, 2].max()
    below = mesh.vertices[:, 2] < -0.02
    assert colors[below, 2].min() > 200 > 50 > colors[below, 0].max()


def write_painted_ball(path: Path) -> Path:
    """A ball of 1,280 faces with a texture: red above, blue below."""
    ball = trimesh.creation.icosphere(3, 0.05)
    pixels = np.zeros((64, 64, 3), np.uint8)
    pixels[:32], pixels[32:] = (255, 0, 0), (0, 0, 255)
    x, y, z = (ball.vertices / 0.05).T
    uv = np.stack([np.arctan2(y, x) / (2 * math.pi) + 0.5, (z + 1) / 2], axis=1)
    material = trimesh.visual.material.SimpleMaterial(image=Image.fromarray(pixels))
    ball.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    ball.export(path)
    return path
