"""The real recordings that come with this project, where they are."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.importer import detect_format
from std_toolkit.importers.options import ImportRequest
from std_toolkit.io.exr import read_exr
from std_toolkit.io.images import read_depth, read_mask

pytestmark = pytest.mark.real

# Raw depth inside the mask, nearest to 126x224: share of valid pixels, RMSE, REL, MAE.
CLEARGRASP = {
    "000000080": (54.9, 0.0604, 0.0998, 0.0500),
    "000000123": (76.6, 0.0216, 0.0240, 0.0161),
    "000000130": (25.0, 0.0299, 0.0345, 0.0223),
}


@pytest.mark.slow
def test_tabletop_colour_with_json_intrinsics(test_data, tmp_path):
    folder = test_data / "tabletop_board_rgb"
    request = ImportRequest(
        source=folder,
        name="tabletop",
        color=str(folder / "color"),
        intrinsics=str(folder / "cam_intrinsics.json"),
    )
    scene = import_recording(request, tmp_path / "scene", link="sym")
    assert len(scene.frames) == 76
    assert scene.frames[1].name == "000002"
    assert scene.camera(scene.frames[0]).fx == pytest.approx(640.8987426757812)


def test_realsense_frames_from_one_folder_with_yaml_intrinsics(test_data, tmp_path):
    folder = str(test_data / "realsense_ycb_frames")
    request = ImportRequest(
        source=folder, name="rs", color=folder, depth=folder, intrinsics=f"{folder}/meta.yml"
    )
    scene = import_recording(request, tmp_path / "scene")
    assert [f.name for f in scene.frames] == [f"{i:06d}" for i in range(5)]
    for frame in scene.frames:
        depth = scene.read_depth(frame)
        assert 0.13 < (depth == 0).mean() < 0.19
        assert 0.5 < np.median(depth[depth > 0]) < 1.2


def test_d415_pair_with_the_cameras_own_dump(test_data, tmp_path):
    folder = test_data / "d415_stereo_pair"
    request = ImportRequest(
        source=folder,
        name="pair",
        color=f"{folder}/*_rgb.png",
        depth=f"{folder}/*_depth.png",
        intrinsics=str(folder / "intrinsics.txt"),
    )
    scene = import_recording(request, tmp_path / "scene")
    assert scene.camera(scene.frames[0]).fx == pytest.approx(454.445556640625)


@pytest.mark.slow
def test_kinect_frames_with_plain_text_intrinsics(test_data, tmp_path):
    folder = str(test_data / "kinect_kitchen")
    request = ImportRequest(
        source=folder,
        name="kitchen",
        color=folder,
        depth=folder,
        intrinsics=f"{folder}/camera-intrinsics.txt",
    )
    scene = import_recording(request, tmp_path / "scene", link="hard")
    assert len(scene.frames) == 64
    assert scene.frames[0].name == "frame-000000"


@pytest.mark.slow
def test_cleargrasp_captures(test_data, tmp_path):
    """The figures of the data's own description come out of the imported scene."""
    folder = test_data / "cleargrasp_real/real-val"
    assert detect_format(folder) == "cleargrasp"
    scene = import_recording(ImportRequest(source=folder, name="cg"), tmp_path / "scene")
    assert [f.name for f in scene.frames] == sorted(CLEARGRASP)
    camera = scene.camera(scene.frames[0])
    assert (camera.fx, camera.cx, camera.cy) == (921, 642, 359)
    for frame in scene.frames:
        raw = scene.read_depth(frame)
        truth = read_depth(scene.root / f"reference/depth/{frame.name}.exr", scale=None)
        mask = read_mask(scene.root / f"reference/mask/{frame.name}.png")
        assert set(np.unique(mask)) == {0, 1}
        assert (scene.root / f"reference/color/{frame.name}.jpg").is_file()
        assert set(read_exr(scene.root / f"reference/normals/{frame.name}.exr")) == set("RGB")
        small = [
            cv2.resize(x, (224, 126), interpolation=cv2.INTER_NEAREST) for x in (raw, truth, mask)
        ]
        inside = (small[1] > 0) & (small[2] > 0)
        valid = inside & (small[0] > 0)
        p, g = small[0][valid].astype(float), small[1][valid].astype(float)
        share, rmse, rel, mae = CLEARGRASP[frame.name]
        assert 100 * valid.sum() / inside.sum() == pytest.approx(share, abs=0.1)
        assert np.sqrt(((p - g) ** 2).mean()) == pytest.approx(rmse, abs=1e-4)
        assert (np.abs(p - g) / g).mean() == pytest.approx(rel, abs=1e-4)
        assert np.abs(p - g).mean() == pytest.approx(mae, abs=1e-4)
