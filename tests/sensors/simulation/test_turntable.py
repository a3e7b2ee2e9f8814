"""`std-sim turntable`: cameras and truth without rendering; photos in the long form."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from PIL import Image

from sensors.render.mitsuba_scene import appearance
from sensors.simulation.options import TurntableOptions
from sensors.simulation.turntable import make_turntable, read_turntable_truth, write_truth
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.poses.board_scale import Board, detect_board


@pytest.fixture
def mesh_file(tmp_path: Path) -> Path:
    """A box that lies off the origin of its frame, y up."""
    path = tmp_path / "box.ply"
    box = trimesh.creation.box((0.06, 0.12, 0.04)).apply_translation([0.3, 0.2, 0.1])
    box.export(path)
    return path


def test_object_stands_in_the_middle_of_every_view(mesh_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = TurntableOptions(mesh=mesh_file, out=out, up="y", views=9)
    table = write_truth(options)
    truth = read_turntable_truth(out)
    mesh = load_mesh(out / "truth/mesh.ply")
    from std_toolkit.geometry import SE3

    corners = SE3.from_matrix(truth.T_world_obj) @ mesh.vertices
    assert corners[:, 2].min() == pytest.approx(0, abs=2e-4)
    assert np.ptp(corners, axis=0) == pytest.approx([0.06, 0.04, 0.12])
    assert np.abs(corners[:, :2].mean(axis=0)).max() < 1e-9
    for index in range(9):
        uv = table.camera.project(truth.pose(index).inverse() @ corners)
        assert (uv > 0).all() and (uv < [1279, 719]).all()
        assert np.ptp(uv[:, 1]) > 250
    elevations = [np.rad2deg(np.arctan2(p.t[2], np.hypot(*p.t[:2]))) for p in table.poses]
    assert max(elevations[:5]) < min(elevations[5:])


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("seed", -1, "seed: must be at least 0"),
        ("seed", 2**63, "seed: must be at most"),
        ("elevations_deg", (1e308, 20.0), "elevations_deg: must be below 90"),
        ("elevations_deg", (20.0, -30.0), "elevations_deg: must be at least 0"),
        ("elevations_deg", (float("nan"), 20.0), "elevations_deg: must be at least 0"),
    ],
)
def test_what_no_camera_can_do_is_refused(field: str, value: Any, words: str) -> None:
    with pytest.raises(ToolkitError, match=words):
        TurntableOptions(mesh=Path("a.obj"), out=Path("o"), **{field: value})


def test_other_options_in_the_same_folder_are_refused(mesh_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    with pytest.raises(ToolkitError, match=r"contains files but no turntable\.json"):
        make_turntable(TurntableOptions(mesh=mesh_file, out=out))
    with pytest.raises(ToolkitError, match="views"):
        TurntableOptions(mesh=mesh_file, out=out, views=1)


def test_a_folder_goes_on_with_the_same_mesh_elsewhere(mesh_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_truth(TurntableOptions(mesh=mesh_file, out=out))
    (moved := tmp_path / "moved").mkdir()
    copy = Path(shutil.copy(mesh_file, moved))
    write_truth(TurntableOptions(mesh=copy, out=out))
    copy.write_bytes(copy.read_bytes() + b"\n")
    with pytest.raises(ToolkitError, match="mesh: these photos were begun with"):
        write_truth(TurntableOptions(mesh=copy, out=out))


@pytest.mark.long
@pytest.mark.parametrize("motion", ["walk", "turntable"])
def test_photos_show_the_board_where_the_truth_says(
    mesh_file: Path, tmp_path: Path, motion: str
) -> None:
    out = tmp_path / "out"
    options = TurntableOptions(
        mesh=mesh_file, out=out, up="y", views=3, width=640, height=360, motion=motion
    )  # type: ignore[arg-type]
    made, _ = make_turntable(options)
    assert made == 3
    assert make_turntable(options)[0] == 0  # all are there
    truth, board = read_turntable_truth(out), Board.read(out / "board.json")
    for index, name in enumerate(truth.photos):
        found = detect_board(out / "photos" / name, board=board)
        assert len(found.ids) >= 32
        uv = truth.camera.camera().project(truth.pose(index).inverse() @ found.xyz)
        assert np.median(np.linalg.norm(uv - found.uv, axis=1)) < 0.3
        mask = cv2.imread(str(out / "truth/masks" / Path(name).with_suffix(".png")), 0)
        assert 0.01 < (mask > 0).mean() < 0.5


@pytest.mark.parametrize("suffix", ["obj", "glb"])
def test_texture_on_a_box_keeps_all_pixels_of_its_texture(tmp_path: Path, suffix: str) -> None:
    lines = np.zeros((2048, 2048, 3), np.uint8)
    lines[:, ::2] = 255  # every second column: nothing of it is left at half the size
    box = trimesh.creation.box((0.06, 0.12, 0.04))
    box.visual = trimesh.visual.TextureVisuals(
        uv=box.vertices[:, :2] / 0.12 + 0.5,
        material=trimesh.visual.material.SimpleMaterial(image=Image.fromarray(lines)),
    )
    path = tmp_path / f"box.{suffix}"
    box.export(path)
    options = TurntableOptions(mesh=path, out=tmp_path / "out", up="y", views=2)
    look = appearance(write_truth(options).subject())
    assert look.image.shape == lines.shape
    assert np.abs(look.image.astype(int) - lines).max() <= 2
    assert np.ptp(look.uv.reshape(-1, 2), axis=0) == pytest.approx([0.5, 1.0])


@pytest.mark.parametrize("kind", ["vertex", "face"])
def test_a_mesh_with_colours_shows_each_of_them(tmp_path: Path, kind: str) -> None:
    box = trimesh.creation.box((0.06, 0.12, 0.04)).subdivide_to_size(0.003)
    rng = np.random.default_rng(0)
    colors = rng.integers(0, 256, (len(box.faces), 3), np.uint8)
    if kind == "face":
        box.visual.face_colors = colors
    else:  # each face in one colour
        box = trimesh.Trimesh(
            box.vertices[box.faces].reshape(-1, 3), np.arange(box.faces.size).reshape(-1, 3),
            vertex_colors=np.repeat(colors, 3, axis=0), process=False,
        )  # fmt: skip
    path = tmp_path / "box.ply"
    box.export(path)
    options = TurntableOptions(mesh=path, out=tmp_path / "out", up="y", views=2)
    subject = write_truth(options).subject()
    look = appearance(subject)
    h, w = look.image.shape[:2]
    u, v = look.uv.mean(axis=1).T
    shown = look.image[((1 - v) * h).astype(int), (u * w).astype(int)]
    assert np.abs(shown.astype(int) - colors).max() <= 2
    np.testing.assert_allclose(
        subject.mesh.vertices[subject.mesh.faces], np.asarray(box.vertices)[box.faces], atol=1e-6
    )
