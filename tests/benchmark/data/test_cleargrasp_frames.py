"""Captures and rendered images of ClearGrasp, as written and as captured."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from dreds_on_disk import write_cleargrasp_real, write_cleargrasp_synthetic

from benchmark.data.frame import Instance, Material
from benchmark.data.splits import iterate, open_split
from std_toolkit.io.images import write_png

# Raw depth inside the mask at 224x126 nearest, of the data's own description: share of valid
# pixels, RMSE, REL, MAE.
REAL = {
    "000000080": (54.9, 0.0604, 0.0998, 0.0500),
    "000000123": (76.6, 0.0216, 0.0240, 0.0161),
    "000000130": (25.0, 0.0299, 0.0345, 0.0223),
}


def test_captures(tmp_path: Path) -> None:
    drawn = write_cleargrasp_real(tmp_path / "real-val/d435", frames=2)
    frames = list(iterate(open_split("cleargrasp-real-known", tmp_path)))
    for frame, one in zip(frames, drawn, strict=True):
        np.testing.assert_array_equal(frame.depth_raw, one.raw)
        np.testing.assert_array_equal(frame.depth_true, one.true)
        np.testing.assert_array_equal(frame.mask, one.mask)
        assert frame.instances == (Instance(1, 0, Material.TRANSPARENT),)
        assert frame.camera == one.camera
        # JPEG of noise: the same picture, not the same numbers.
        assert np.abs(frame.color.astype(int) - one.color).mean() < 60
    assert [f.key for f in frames] == ["d435-000000000/000000000", "d435-000000001/000000001"]


def test_without_intrinsics_the_field_of_view_of_the_cameras_is_taken(
    tmp_path: Path, caplog
) -> None:
    write_cleargrasp_real(tmp_path / "real-test/d415", frames=1, intrinsics=False)
    with caplog.at_level(logging.WARNING):
        camera = open_split("cleargrasp-real-novel", tmp_path).load(0).camera
    assert "no camera_intrinsics.yaml" in caplog.text
    width = 2 * camera.fx * np.tan(np.radians(69.4) / 2)
    assert width == pytest.approx(128)
    assert camera.cx == 63.5


def test_intrinsics_may_lie_above_the_folder(tmp_path: Path) -> None:
    drawn = write_cleargrasp_real(tmp_path / "real-test/d415", frames=1)
    shutil.move(tmp_path / "real-test/d415/camera_intrinsics.yaml", tmp_path / "real-test")
    assert open_split("cleargrasp-real-novel", tmp_path).load(0).camera == drawn[0].camera


def test_rendered_images_have_raw_depth_with_holes(tmp_path: Path) -> None:
    drawn = write_cleargrasp_synthetic(tmp_path / "synthetic-val/cup-val", frames=2)
    for frame, one in zip(
        iterate(open_split("cleargrasp-synthetic", tmp_path)), drawn, strict=True
    ):
        np.testing.assert_array_equal(frame.depth_true, one.true)
        np.testing.assert_array_equal(frame.mask, one.mask)
        inside = one.mask == 1
        assert not frame.depth_raw[inside].any()
        np.testing.assert_array_equal(frame.depth_raw[~inside], one.true[~inside])
        assert frame.camera.fx == pytest.approx(one.camera.fx)
        assert frame.scene == "cup-val"


def test_rendered_masks_may_have_the_short_name(tmp_path: Path) -> None:
    folder = tmp_path / "synthetic-val/cup-val"
    drawn = write_cleargrasp_synthetic(folder, frames=1)
    (folder / "segmentation-masks/000000000-segmentation-mask.png").unlink()
    (folder / "json-files/000000000-masks.json").unlink()
    write_png(
        folder / "segmentation-masks/000000000-mask.png", (drawn[0].mask == 1).astype(np.uint8)
    )
    frame = open_split("cleargrasp-synthetic", tmp_path).load(0)
    np.testing.assert_array_equal(frame.mask, drawn[0].mask)
    assert 2 * np.degrees(np.arctan(32 / frame.camera.fx)) == pytest.approx(69.4)


@pytest.mark.real
def test_real_captures_have_the_figures_of_their_description(test_data: Path) -> None:
    source = open_split("cleargrasp-real-known", test_data / "cleargrasp_real")
    assert [k.name for k in source.keys()] == sorted(REAL)  # noqa: SIM118 - no dictionary
    for frame in iterate(source):
        assert frame.color.shape == (720, 1280, 3)
        assert (frame.camera.fx, frame.camera.cx, frame.camera.cy) == (921, 642, 359)
        raw, true, mask = (
            cv2.resize(x, (224, 126), interpolation=cv2.INTER_NEAREST)
            for x in (frame.depth_raw, frame.depth_true, frame.mask_of().view(np.uint8))
        )
        inside = (true > 0) & (mask > 0)
        p, g = (x[inside & (raw > 0)].astype(float) for x in (raw, true))
        share, rmse, rel, mae = REAL[frame.name]
        assert round(100 * len(p) / inside.sum(), 1) == share
        assert round(np.sqrt(((p - g) ** 2).mean()), 4) == rmse
        assert round((np.abs(p - g) / g).mean(), 4) == rel
        assert round(np.abs(p - g).mean(), 4) == mae
