"""Frames of the DREDS and STD layouts hold exactly what was drawn."""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import numpy as np
from dreds_on_disk import (
    BALLS,
    COLOR_SIZE,
    LABEL_SIZE,
    Drawn,
    coord_picture,
    dreds_camera,
    pose,
    std_camera,
    write_dreds_scene,
    write_equal,
    write_std_scene,
)

from benchmark.data.frame import DepthFrame, Instance, Material
from benchmark.data.splits import iterate, open_split
from std_toolkit.geometry.depth_maps import unproject_depth
from std_toolkit.io.images import write_png

INSTANCES = (
    Instance(1, 1, Material.TRANSPARENT, "bottle", "bottle_a"),
    Instance(2, 6, Material.SPECULAR, "mug", "mug_b"),
    Instance(3, 3, Material.DIFFUSE, "camera", "camera_c"),
    Instance(4, 0, Material.RAW, "other", "thing_d"),
)


def assert_holds(frame: DepthFrame, drawn: Drawn, *, depth_error_m: float = 0.0) -> None:
    np.testing.assert_array_equal(frame.color, drawn.color)
    np.testing.assert_array_equal(frame.mask, drawn.mask)
    np.testing.assert_allclose(frame.depth_raw, drawn.raw, atol=depth_error_m, rtol=0)
    np.testing.assert_allclose(frame.depth_true, drawn.true, atol=depth_error_m, rtol=0)
    assert frame.depth_raw.dtype == frame.depth_true.dtype == np.float32
    np.testing.assert_array_equal(frame.depth_raw == 0, drawn.raw == 0)
    assert frame.camera == drawn.camera


def test_frames_of_dreds(tmp_path: Path) -> None:
    drawn = write_dreds_scene(tmp_path / "DREDS-CatKnown/test/00007", frames=3)
    source = open_split("dreds-catknown-test", tmp_path)
    assert source.name == "dreds-catknown-test"
    assert list(map(str, source.keys())) == ["00007/0000", "00007/0001", "00007/0002"]
    for frame, one, key in zip(iterate(source), drawn, source.keys(), strict=True):
        assert_holds(frame, one)
        assert (frame.scene, frame.name) == key
        assert frame.instances == INSTANCES
        assert frame.nocs is None
        assert frame.color.shape[:2] == COLOR_SIZE[::-1]
        assert frame.depth_raw.shape == LABEL_SIZE[::-1]


def test_raw_depth_of_std_has_the_colours_size_and_truth_is_on_objects_only(tmp_path: Path) -> None:
    drawn = write_std_scene(tmp_path / "STD-CatKnown/train_0-5")
    source = open_split("std-catknown", tmp_path)
    for frame, one in zip(iterate(source), drawn, strict=True):
        assert_holds(frame, one)
        assert frame.depth_raw.shape == COLOR_SIZE[::-1]
        assert frame.depth_true.shape == LABEL_SIZE[::-1]
        np.testing.assert_array_equal(frame.depth_true > 0, frame.mask != 255)
        assert frame.camera == std_camera()
        assert frame.instances == INSTANCES[:3]


def test_half_floats_are_rounded_to_their_ids(tmp_path: Path) -> None:
    """Truncation, as the public loaders do it, gets ids wrong here."""
    folder = tmp_path / "DREDS-CatKnown/test/00000"
    write_dreds_scene(folder, frames=1, half=True, balls=())
    ids = np.full(LABEL_SIZE[::-1], 255, np.uint8)
    ids.ravel()[:255] = np.arange(255)
    stored = (ids / np.float32(255)).astype(np.float16)
    write_equal(folder / "0000_mask.exr", stored)
    lines = [f"{i} 0 00000000 thing 0.1 1 1 0 0 0 0 0 1 \n" for i in range(255)]
    (folder / "0000_meta.txt").write_text("".join(lines))
    frame = open_split("dreds-catknown-test", tmp_path).load(0)
    np.testing.assert_array_equal(frame.mask, ids)
    truncated = (stored.astype(np.float32) * 255).astype(np.int32)
    assert (truncated != ids).sum() > 100


def test_novel_sets_have_other_truth_short_lines_and_no_coordinates(tmp_path: Path) -> None:
    drawn = write_dreds_scene(
        tmp_path / "DREDS-CatNovel/00029", truth="_depth_0.exr", short_meta=True, half=True
    )
    source = open_split("dreds-catnovel", tmp_path)
    frame = source.load(1, nocs=True)
    # Half floats between 0.5 and 1 are 0.5 mm apart.
    assert_holds(frame, drawn[1], depth_error_m=2.5e-4)
    assert frame.nocs is None
    assert [(i.mask_id, i.class_id, i.material) for i in frame.instances] == [
        (i.mask_id, i.class_id, i.material) for i in INSTANCES
    ]
    assert {i.model for i in frame.instances} == {""}


def test_class_numbers_of_their_own_are_other(tmp_path: Path) -> None:
    folder = tmp_path / "STD-CatNovel/test_novel_0-1"
    write_std_scene(folder, frames=1)
    (folder / "0000_meta.txt").write_text("1 43 2 \n2 0 3 \n3 8 1 \n")
    frame = open_split("std-catnovel", tmp_path).load(0)
    assert [(i.class_id, i.category) for i in frame.instances] == [(0, ""), (0, ""), (0, "")]


def test_masks_may_be_png_in_dreds_too(tmp_path: Path) -> None:
    folder = tmp_path / "DREDS-CatKnown/val/01162"
    drawn = write_dreds_scene(folder, frames=1)
    (folder / "0000_mask.exr").unlink()
    write_png(folder / "0000_mask.png", np.repeat(drawn[0].mask[..., None], 3, axis=2))
    assert_holds(open_split("dreds-catknown-val", tmp_path).load(0), drawn[0])


def test_every_mark_of_missing_depth_is_zero(tmp_path: Path) -> None:
    folder = tmp_path / "DREDS-CatKnown/test/00000"
    write_dreds_scene(folder, frames=1)
    depth = np.full(LABEL_SIZE[::-1], 0.7, np.float32)
    depth[0, :6] = (-0.001, np.nan, np.inf, -np.inf, 0.0, 1e10)
    write_equal(folder / "0000_simDepthImage.exr", depth)
    write_equal(folder / "0000_depth_120.exr", depth)
    frame = open_split("dreds-catknown-test", tmp_path).load(0)
    expected = np.where(np.arange(depth.size).reshape(depth.shape) < 6, np.float32(0), 0.7)
    np.testing.assert_array_equal(frame.depth_raw, expected.astype(np.float32))
    np.testing.assert_array_equal(frame.depth_true, expected.astype(np.float32))


def test_coordinates_are_unflipped_and_fit_depth_and_camera(tmp_path: Path) -> None:
    drawn = write_std_scene(tmp_path / "STD-CatKnown/test_8")
    frame = open_split("std-catknown", tmp_path).load(1, nocs=True)
    assert frame.nocs is not None
    np.testing.assert_allclose(frame.nocs, drawn[1].nocs, atol=0.5 / 255 + 1e-6)
    assert not frame.nocs[frame.mask == 255].any()
    points = unproject_depth(frame.depth_true, frame.camera)
    for ball in BALLS[:3]:
        seen = frame.mask == ball.mask_id
        T_cam_obj = pose(ball, 1)
        placed = (frame.nocs[seen] - 0.5) * ball.diagonal @ T_cam_obj.R.T + T_cam_obj.t
        # 8 bits of 0.17 m along three axes
        assert np.linalg.norm(points[seen] - placed, axis=1).max() < 0.0007
    assert coord_picture(drawn[1]).dtype == np.uint8


def test_scoring_needs_neither_colour_nor_raw_depth(tmp_path: Path) -> None:
    folder = tmp_path / "STD-CatKnown/test_8"
    drawn = write_std_scene(folder, frames=1)
    (folder / "0000_color.png").unlink()
    (folder / "0000_depth_415.exr").unlink()
    frame = open_split("std-catknown", tmp_path).load(0, sensor=False)
    assert frame.color.shape == (0, 0, 3)
    assert frame.depth_raw.shape == (0, 0)
    np.testing.assert_array_equal(frame.depth_true, drawn[0].true)
    np.testing.assert_array_equal(frame.mask, drawn[0].mask)


def test_the_camera_fits_the_labels_and_has_its_middle_in_theirs(tmp_path: Path) -> None:
    write_dreds_scene(tmp_path / "DREDS-CatKnown/test/00000", frames=1, label_size=(640, 360))
    camera = open_split("dreds-catknown-test", tmp_path).load(0).camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (446.31, 446.31, 319.5, 179.5)
    assert camera == dreds_camera((640, 360))


def test_a_source_survives_pickling(tmp_path: Path) -> None:
    write_dreds_scene(tmp_path / "DREDS-CatKnown/test/00000")
    source = open_split("dreds-catknown-test", tmp_path)
    source.load(0)
    twin = pickle.loads(pickle.dumps(source))
    assert twin.keys() == source.keys()
    np.testing.assert_array_equal(twin.load(1).depth_raw, source.load(1).depth_raw)


def test_masks_by_material_are_those_of_the_pixels(tmp_path: Path) -> None:
    drawn = write_dreds_scene(tmp_path / "DREDS-CatKnown/test/00000", frames=1)
    frame = open_split("dreds-catknown-test", tmp_path).load(0)
    for material, ids in ((Material.TRANSPARENT, [1]), (Material.SPECULAR, [2])):
        np.testing.assert_array_equal(frame.mask_of(material), np.isin(drawn[0].mask, ids))
    both = frame.mask_of(Material.TRANSPARENT, Material.SPECULAR)
    np.testing.assert_array_equal(both, np.isin(drawn[0].mask, [1, 2]))
    np.testing.assert_array_equal(frame.mask_of(), drawn[0].mask != 255)
    assert cv2.countNonZero(both.view(np.uint8)) > 0
