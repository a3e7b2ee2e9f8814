"""Recordings through lenses that a scene does not keep: undistorted, or refused by name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera
from std_toolkit.importers.import_step import import_recording, write_recording
from std_toolkit.importers.importer import IMPORTERS
from std_toolkit.importers.options import ImportRequest
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.options import KnownCameras, PoseOptions
from std_toolkit.poses.pose_step import estimate_poses
from std_toolkit.scene import CameraModel, Scene

FISHEYE = (0.0313, 0.0052, 0.00066, 0.0001)
LENS = Camera(96, 72, 80.0, 80.0, 48.0, 35.0, FISHEYE, "fisheye")
RATIONAL = Camera(96, 72, 80.0, 80.0, 48.0, 35.0, (5.2, 3.1, 2e-4, 1e-4, 0.2, 5.5, 4.6, 0.9))
NUMBERS = {"fx": 80.0, "fy": 80.0, "cx": 48.0, "cy": 35.0}
NERF = {"fl_x": 80.0, "fl_y": 80.0, "cx": 48.5, "cy": 35.5, "w": 96, "h": 72}
NAMED = dict(zip(("k1", "k2", "k3", "k4"), FISHEYE, strict=True))


def seen(camera: Camera, pinhole: Camera) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Image whose red and green tell where the pinhole sees a ray, and depth of a slanted plane."""
    rays = camera.rays()
    uv = 20 + 2 * pinhole.project(rays)
    color = np.zeros((*rays.shape[:2], 3), np.uint8)
    color[..., :2] = np.clip(np.rint(np.nan_to_num(uv)), 0, 255)
    return color, (1 / (1.5 + 0.3 * rays[..., 0] - 0.2 * rays[..., 1])).astype(np.float32)


def record(folder: Path, camera: Camera) -> Path:
    color, depth = seen(camera, LENS.without_distortion())
    for name in ("0", "1"):
        write_color(folder / f"color/{name}.png", color)
        write_depth_png16(folder / f"depth/{name}.png", depth, scale=1e-4)
    return folder


def imported(folder: Path, **changes: Any) -> Scene:
    request = ImportRequest(
        source=folder, name="lens", color=str(folder / "color"), depth=str(folder / "depth"),
        depth_scale=1e-4, **changes,
    )  # fmt: skip
    return import_recording(request, folder / "scene")


def filed(folder: Path, document: Any) -> str:
    path = folder / "lens.json"
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    return str(path)


def check_images(scene: Scene, pinhole: Camera) -> None:
    """All four corners are within 0.1 px; depth is that of a pixel at most one away."""
    assert scene.camera(scene.frames[0]) == pinhole
    color, depth = seen(pinhole, LENS.without_distortion())
    found = scene.read_color(scene.frames[0]).astype(float)
    measured = scene.read_depth(scene.frames[1])
    assert measured is not None
    for rows in (slice(4, 16), slice(-16, -4)):
        for columns in (slice(4, 16), slice(-16, -4)):
            shift = (found - color)[rows, columns, :2].mean(axis=(0, 1)) / 2
            assert np.abs(shift).max() < 0.1
            step = np.abs(np.gradient(depth[rows, columns])).max()
            error = np.abs(measured - depth)[rows, columns]
            assert error.max() < 2 * step + 1e-4 and error.mean() < step


FISHEYE_FILES = {
    "list": {**NUMBERS, "model": "fisheye", "distortion": FISHEYE},
    "kannala-brandt of librealsense": {
        **NUMBERS, "model": "distortion.kannala_brandt4", "coeffs": [*FISHEYE, 0.0],
    },
    "nerfstudio": {"camera_model": "OPENCV_FISHEYE", **NERF, **NAMED},
    "instant-ngp": {"is_fisheye": True, **NERF, **NAMED},
    "kalibr": "camera_model: pinhole\ndistortion_model: equidistant\nintrinsics: [80, 80, 48, 35]\n"
    f"distortion_coeffs: {list(FISHEYE)}\n",
}  # fmt: skip


@pytest.mark.parametrize("kind", FISHEYE_FILES)
def test_a_fisheye_is_undistorted_to_a_pinhole_of_its_focal_length(
    kind: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = record(tmp_path, LENS)
    with caplog.at_level("INFO", "std_toolkit"):
        scene = imported(folder, intrinsics=filed(folder, FISHEYE_FILES[kind]))
    assert "undistorted to a pinhole of 61.9 x 48.5 degrees (same focal length)" in caplog.text
    check_images(scene, LENS.without_distortion())
    recorded = json.loads((scene.root / "scene.json").read_text())["recorded_lenses"]
    assert recorded == {"color": {"model": "fisheye", **NUMBERS, "distortion": list(FISHEYE)}}


def test_a_fisheye_of_a_file_of_camera_poses(tmp_path: Path) -> None:
    folder = record(tmp_path, LENS)
    rows = [{"file_path": f"{i}.png", "transform_matrix": np.eye(4).tolist()} for i in range(2)]
    cameras = filed(folder, {"camera_model": "OPENCV_FISHEYE", **NERF, **NAMED, "frames": rows})
    request = ImportRequest(
        source=folder, name="lens", color=str(folder / "color"), depth=str(folder / "depth"),
        depth_scale=1e-4, known=KnownCameras(cameras=Path(cameras), cameras_unit="m"),
    )  # fmt: skip
    recording = IMPORTERS.get("folder").read(request)
    assert recording.cameras == {"color": LENS}
    scene = write_recording(recording, tmp_path / "scene", name="lens")
    check_images(scene, LENS.without_distortion())


def test_a_lens_that_only_the_file_of_poses_states_is_no_secret(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    scene = imported(record(tmp_path, LENS), intrinsics="80,80,48,35")
    rows = [{"file_path": f"{i}.png", "transform_matrix": np.eye(4).tolist()} for i in range(2)]
    cameras = filed(tmp_path, {"is_fisheye": True, **NERF, **NAMED, "frames": rows})
    known = KnownCameras(cameras=Path(cameras), cameras_unit="m")
    with pytest.raises(ToolkitError, match="features"), caplog.at_level("INFO", "std_toolkit"):
        estimate_poses(scene, PoseOptions(known=known))
    assert "lens.json states a fisheye lens" in caplog.text


@pytest.mark.parametrize("camera", [LENS, RATIONAL], ids=["fisheye", "rational"])
def test_the_field_of_view_is_an_option(camera: Camera, tmp_path: Path) -> None:
    document = {**NUMBERS, "model": camera.model, "distortion": camera.distortion}
    folder = record(tmp_path, camera)
    scene = imported(folder, intrinsics=filed(folder, document), undistort_fov=50.0)
    f = 48 / np.tan(np.deg2rad(25))
    check_images(scene, Camera(96, 72, f, f, 48.0, 35.0))


def test_other_lenses_are_kept_as_they_are(tmp_path: Path) -> None:
    folder = record(tmp_path, RATIONAL)
    scene = imported(folder, intrinsics=filed(folder, {**NUMBERS, "D": RATIONAL.distortion}))
    assert scene.camera(scene.frames[0]) == RATIONAL
    copied = scene.color_path(scene.frames[0]).read_bytes()
    assert copied == (folder / "color/0.png").read_bytes()
    assert "recorded_lenses" not in (scene.root / "scene.json").read_text()


def test_pixels_that_the_lens_does_not_see_are_empty_and_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = record(tmp_path, LENS)
    document = {**NUMBERS, "model": "fisheye", "distortion": FISHEYE}
    with caplog.at_level("INFO", "std_toolkit"):
        scene = imported(folder, intrinsics=filed(folder, document), undistort_fov=100.0)
    assert "% of its pixels are empty" in caplog.text
    depth = scene.read_depth(scene.frames[0])
    assert depth is not None and depth[0, 0] == 0 and depth[35, 48] > 0
    assert (scene.read_color(scene.frames[0])[0, 0] == 0).all()


REFUSED: dict[str, tuple[Any, str]] = {
    "thin prism": ({**NUMBERS, "camera_model": "THIN_PRISM_FISHEYE"}, "camera_model.*(?i:thin)"),
    "division": ({**NUMBERS, "distortion_model": "division", "D": [0.1]}, "distortion_model"),
    "inverse": ({**NUMBERS, "model": "Inverse Brown Conrady", "D": [0.1] * 5}, "not supported"),
    "double sphere": ({**NUMBERS, "camera_model": "ds", "k1": 0.1}, "camera_model"),
    "no coefficients": ({**NUMBERS, "camera_model": "FISHEYE"}, "k1: .*missing"),
    "two coefficients": ({**NUMBERS, "model": "fisheye", "D": [0.1, 0.2]}, "needs 4 coefficients"),
    "five coefficients": ({**NUMBERS, "model": "fisheye", "D": [0.1] * 5}, "too many"),
    "k4 of nerfstudio": ({"camera_model": "OPENCV", **NERF, **NAMED}, "k4: .*nerfstudio"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_a_lens_without_a_model_is_refused_by_the_files_name(kind: str, tmp_path: Path) -> None:
    folder = record(tmp_path, LENS)
    document, words = REFUSED[kind]
    with pytest.raises(ToolkitError, match=words) as error:
        imported(folder, intrinsics=filed(folder, document))
    assert "lens.json" in str(error.value)
    assert not (folder / "scene").exists()


def test_images_without_distortion_have_nothing_to_undistort(tmp_path: Path) -> None:
    folder = record(tmp_path, LENS.without_distortion())
    with pytest.raises(ToolkitError, match="--undistort-fov: the images have no lens distortion"):
        imported(folder, intrinsics="80,80,48,35", undistort_fov=60.0)


def test_documents_of_scenes_state_no_fisheye() -> None:
    with pytest.raises(ToolkitError, match="needs a pinhole"):
        CameraModel.of(LENS)
