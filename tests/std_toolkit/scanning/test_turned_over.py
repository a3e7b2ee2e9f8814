"""Photos of an object turned over: the motion between both positions, and what names a photo."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

pytest.importorskip("manifold3d")

from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, rotation_angle, so3_exp
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.io.images import write_color
from std_toolkit.scanning.masks.object_masks import both_positions
from std_toolkit.scanning.options import ScanOptions
from std_toolkit.scanning.photos.photos import Photos
from std_toolkit.scanning.photos.posed_photos import PosedPhotos
from std_toolkit.scanning.photos.views import View
from std_toolkit.scanning.surface.depth_maps import depth_maps
from std_toolkit.scanning.surface.measured_surface import (
    Side,
    Surface,
    fused_surface,
    measure_side,
    side_surface,
)
from std_toolkit.scanning.surface.turned_over import find_turn
from tests.std_toolkit.scanning.ball import CENTRE, look_at, paint

CAMERA = Camera(240, 180, 390, 390, 119.5, 89.5)
# Upside down, turned, and put down elsewhere.
OVER = SE3(so3_exp(np.array([0, 0, 0.7])) @ so3_exp(np.array([np.pi, 0, 0])), np.zeros(3))


def dented_block() -> trimesh.Trimesh:
    """80 x 50 x 60 mm on z = 0; the middle of its underside is 8 mm deep, a step is on its top."""
    block = trimesh.creation.box((0.08, 0.05, 0.06)).apply_translation([0, 0, 0.03])
    dent = trimesh.creation.box((0.05, 0.03, 0.016))
    step = trimesh.creation.box((0.03, 0.02, 0.03)).apply_translation([0.03, 0.02, 0.06])
    return trimesh.boolean.difference([block, dent, step], engine="manifold")


def painted(points: Array) -> Array:
    return paint(CENTRE + points)


def plain(points: Array) -> Array:
    return np.full((len(points), 3), 150.0)


def photos(
    mesh: trimesh.Trimesh, T_world_obj: SE3, color: Callable[[Array], Array], count: int = 14
) -> list[View]:
    """Photos from two heights with exact masks, drawn by ray casting."""
    vertices = T_world_obj @ np.asarray(mesh.vertices)
    caster = RayCaster(vertices, mesh.faces)
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    views = []
    for n in range(count):
        a = 2 * np.pi * n / count
        eye = middle + np.array([0.22 * np.cos(a), 0.22 * np.sin(a), (0.09, 0.2)[n % 2]])
        T = look_at(eye, middle)
        rays = np.concatenate(
            [np.broadcast_to(eye, (*CAMERA.rays().shape[:2], 3)), CAMERA.rays() @ T.R.T], axis=-1
        )
        hits = caster.cast(rays)
        mask = np.isfinite(hits.distance)
        image = np.full((*mask.shape, 3), 12, np.uint8)
        points = rays[mask][:, :3] + hits.distance[mask][:, None] * rays[mask][:, 3:]
        image[mask] = color(T_world_obj.inverse() @ points)
        views.append(View(f"{n:03d}.png", image, CAMERA, T, mask))
    return views


def side(views: list[View], folder: Path) -> Side:
    posed = PosedPhotos(
        views=views, corners=np.zeros((0, 3)), points=np.zeros((0, 3)), on_table=True, facts={},
        warnings=[], digest="", photos=Photos((), (), (240, 180), 1.0),
    )  # fmt: skip
    folder.mkdir()
    return measure_side(OPTIONS, posed, views, depth_maps, folder, 1, lambda _: None)


OPTIONS = ScanOptions(photos=Path("a"), out=Path("o"), voxels=70, faces=6000, neighbours=4)


def standing(mesh: trimesh.Trimesh, turn: SE3) -> SE3:
    """The turned mesh on the table."""
    low = (turn @ np.asarray(mesh.vertices)).min(axis=0)[2]
    return SE3(np.eye(3), np.array([0.03, -0.02, -low])) @ turn


def positions(
    mesh: trimesh.Trimesh, T: SE3, color: Callable[[Array], Array], folder: Path
) -> tuple[list[Side], list[Surface]]:
    """The mesh as it is and moved, each photographed from all sides, and its surface."""
    sides = [
        side(photos(mesh, motion, color), folder / name)
        for name, motion in (("a", SE3.identity()), ("b", T))
    ]
    return sides, [side_surface(s, 70, 1) for s in sides]


def errors(off: SE3) -> tuple[float, float]:
    """Degrees and metres, in the middle of the block, by which a motion is off the identity."""
    middle = np.array([0, 0, 0.03])
    return float(np.degrees(rotation_angle(off.R))), float(np.linalg.norm(off @ middle - middle))


@pytest.mark.slow
def test_the_turn_is_found_by_features_and_the_underside_is_real(tmp_path: Path) -> None:
    mesh = dented_block()
    T = standing(mesh, OVER)
    (first, second), (surface, other) = positions(mesh, T, painted, tmp_path)
    turn = find_turn(first, surface, second, other)
    assert turn.by == "features"
    degrees, away = errors(turn.T_first_second @ T)
    assert degrees < 0.5
    assert away < 0.0005
    assert turn.residual_m < 0.0005
    dent = np.array([[x, y, 0.008] for x in (-0.012, 0, 0.012) for y in (-0.006, 0, 0.006)])
    sides = [(first, SE3.identity()), (second, turn.T_first_second)]
    alone, both = (fused_surface(OPTIONS, s, {}, 1) for s in (sides[:1], sides))
    assert np.median(RayCaster(alone.vertices, alone.faces).distance(dent)) > 0.006
    assert np.median(RayCaster(both.vertices, both.faces).distance(dent)) < 0.001


@pytest.mark.long  # `test_repeated_turns` has it in short
def test_a_plain_block_is_ambiguous_and_another_object_refused(tmp_path: Path) -> None:
    block = trimesh.creation.box((0.08, 0.05, 0.06)).apply_translation([0, 0, 0.03])
    (first, second), (surface, other) = positions(block, standing(block, OVER), plain, tmp_path)
    turn = find_turn(first, surface, second, other)
    assert turn.by == "shape"
    assert turn.ambiguous
    ball = trimesh.creation.icosphere(3, radius=0.03).apply_translation([0, 0, 0.03])
    third = side(photos(ball, SE3.identity(), plain), tmp_path / "c")
    with pytest.raises(ToolkitError, match=r"no turn of the object.*photograph the same object"):
        find_turn(first, surface, third, side_surface(third, 70, 1))


@pytest.mark.long
def test_a_plain_block_with_a_step_is_found_by_its_outlines(tmp_path: Path) -> None:
    mesh = dented_block()
    T = standing(mesh, OVER)
    (first, second), (surface, other) = positions(mesh, T, plain, tmp_path)
    turn = find_turn(first, surface, second, other)
    assert turn.by == "shape"
    assert not turn.ambiguous
    assert not turn.doubted
    degrees, away = errors(turn.T_first_second @ T)
    assert degrees < 1.0
    assert away < 0.001


def folders(tmp_path: Path) -> ScanOptions:
    for name, stems in (("photos", ("1", "2")), ("over", ("2", "3"))):
        (tmp_path / name).mkdir()
        for stem in stems:
            write_color(tmp_path / name / f"{stem}.jpg", np.zeros((8, 8, 3), np.uint8))
    return ScanOptions(photos=tmp_path / "photos", flipped=tmp_path / "over", out=tmp_path / "out")


def test_a_photo_of_either_folder_is_named(tmp_path: Path) -> None:
    options = replace(folders(tmp_path), board=tmp_path / "board.json")
    first, second = both_positions(replace(options, pick="3.jpg:1,2", box="photos/2.jpg:1,2,3,4"))
    assert (first.pick, first.box) == (None, "2.jpg:1,2,3,4")
    assert (second.pick, second.box) == ("3.jpg:1,2", None)
    with pytest.raises(ToolkitError, match=r"both folders.*over/2.jpg:5,6"):
        both_positions(replace(options, pick="2.jpg:5,6"))
    with pytest.raises(ToolkitError, match="no folder has this photo"):
        both_positions(replace(options, pick="9.jpg:5,6"))
    with pytest.raises(ToolkitError, match="subfolders photos and over"):
        both_positions(replace(options, masks=tmp_path / "none"))


def test_two_folders_are_different_and_not_for_revolve(tmp_path: Path) -> None:
    options = folders(tmp_path)
    with pytest.raises(ToolkitError, match="second folder is the first"):
        replace(options, flipped=options.photos)
    with pytest.raises(ToolkitError, match=r"--revolve.*takes one folder"):
        replace(options, revolve=True)
    same = replace(options, flipped=tmp_path / "again" / "photos")
    assert same.labels()[1] == "again/photos"
