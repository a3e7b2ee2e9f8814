"""Pictures of meshes for the library."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scene_on_disk import write_scene

from annotator.app.placing import standing_axis
from annotator.session import Session
from annotator.session.requests import ImportMesh
from annotator.views import thumbnails as module
from annotator.views.thumbnails import PAPER, cached_thumbnail, model_picture, thumbnail
from std_toolkit.io.images import read_color


def can() -> trimesh.Trimesh:
    return trimesh.creation.cylinder(0.033, 0.1)


def test_a_mesh_fills_its_picture() -> None:
    picture = thumbnail(can(), 64)
    assert picture.shape == (64, 64, 3) and picture.dtype == np.uint8
    drawn = (picture != PAPER).any(axis=2)
    rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
    assert rows.min() > 0 and rows.max() < 63
    assert rows.max() - rows.min() > 40
    assert abs(rows.mean() - 31.5) < 2 and abs(columns.mean() - 31.5) < 2


def test_its_sides_can_be_told_apart() -> None:
    picture = thumbnail(trimesh.creation.box((0.1, 0.1, 0.1)), 96).astype(int)
    drawn = picture[(picture != PAPER).any(axis=2)].mean(axis=1)
    _, count = np.unique(drawn.round(-1), return_counts=True)
    assert (count > 0.1 * len(drawn)).sum() >= 3


@pytest.mark.slow
def test_many_faces_are_merged_and_look_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = trimesh.creation.icosphere(5, 0.05)
    paint = np.where(mesh.vertices[:, 2:] > 0, [[255, 40, 40]], [[40, 40, 255]])
    mesh.visual.vertex_colors = paint.astype(np.uint8)
    monkeypatch.setattr(module, "_MOST_FACES", 1000)
    monkeypatch.setattr(module, "_CELLS", 32)
    coarse = module.few_faces(mesh)
    assert len(coarse.faces) < len(mesh.faces) / 2
    off = np.abs(thumbnail(coarse, 48).astype(int) - thumbnail(mesh, 48))
    assert np.median(off) < 3 and off.mean() < 8


def test_it_is_drawn_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = cached_thumbnail(tmp_path, can(), 48)
    monkeypatch.setattr(module, "thumbnail", lambda *_: pytest.fail("drawn again"))
    assert (cached_thumbnail(tmp_path, can(), 48) == first).all()


def test_another_mesh_or_size_has_its_own(tmp_path: Path) -> None:
    cached_thumbnail(tmp_path, can(), 48)
    other = cached_thumbnail(tmp_path, trimesh.creation.box((0.1, 0.1, 0.02)), 48)
    large = cached_thumbnail(tmp_path, can(), 64)
    assert (other != cached_thumbnail(tmp_path, can(), 48)).any()
    assert large.shape == (64, 64, 3)
    assert len(list(tmp_path.rglob("*.png"))) == 3


def test_a_damaged_one_is_drawn_anew(tmp_path: Path) -> None:
    first = cached_thumbnail(tmp_path, can(), 48)
    (file,) = tmp_path.rglob("*.png")
    file.write_bytes(b"no picture")
    assert (cached_thumbnail(tmp_path, can(), 48) == first).all()
    assert (read_color(file) == first).all()


def test_another_axis_has_a_picture_of_its_own(tmp_path: Path) -> None:
    upright = cached_thumbnail(tmp_path, can(), 48)
    lying = cached_thumbnail(tmp_path, can(), 48, 0)
    assert (upright != lying).any()
    assert (cached_thumbnail(tmp_path, can(), 48) == upright).all()


def test_its_background_and_its_clay_are_grey() -> None:
    picture = thumbnail(can(), 48).astype(int)
    assert np.ptp(picture, axis=2).max() == 0


def test_a_box_stands_as_the_round_meshes_of_its_library_do(tmp_path: Path) -> None:
    """As it is placed: its own shape does not tell."""
    session = Session.open(write_scene(tmp_path / "scene").root)
    box, y_up = tmp_path / "carton.ply", tmp_path / "can.ply"
    mesh = trimesh.creation.box((0.11, 0.16, 0.05))
    mesh.export(box)
    turned = can()
    turned.vertices = np.roll(turned.vertices, -1, axis=1)
    turned.export(y_up)
    session.perform(ImportMesh(mesh=str(box)))
    model = session.state.model("carton")
    assert standing_axis(session, model) == 2
    session.perform(ImportMesh(mesh=str(y_up)))
    assert standing_axis(session, model) == standing_axis(session, session.state.model("can")) == 1
    picture = model_picture(session.snapshot(), model, 48)
    assert picture is not None
    assert (picture == thumbnail(mesh, 48, 1)).all()
    session.close()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_may_only_be_read_is_no_obstacle(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    assert cached_thumbnail(tmp_path, can(), 32).shape == (32, 32, 3)


def test_a_folder_that_cannot_be_made_is_no_obstacle(tmp_path: Path) -> None:
    (tmp_path / ".std").write_text("a file where the folder would be")
    assert cached_thumbnail(tmp_path, can(), 32).shape == (32, 32, 3)
