"""Layouts of data sets and apps that are recognised without --color and --depth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.importer import detect_format
from std_toolkit.importers.layouts import find_layout
from std_toolkit.importers.options import ImportRequest
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.scene import Scene

W, H = 64, 48
OPEN3D = {"width": W, "height": H, "intrinsic_matrix": [60, 0, 0, 0, 60, 0, 31.5, 23.5, 1]}
RECORD3D = {"w": W, "h": H, "K": [60, 0, 0, 0, 60, 0, 31.5, 23.5, 1]}
REPLICA = {"camera": {"w": W, "h": H, "fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5, "scale": 6553.5}}
MATRIX = "60 0 31.5 0\n0 60 23.5 0\n0 0 1 0\n0 0 0 1\n"
STAMPS = ("1305031102.175304", "1305031102.208637")


def image(path: Path, scale: float = 0.001) -> None:
    if "depth" in str(path.name) or path.parent.name == "depth":
        write_depth_png16(path, np.full((H, W), 0.7), scale=scale)
    else:
        write_color(path, np.full((H, W, 3), 80, np.uint8))


def write(root: Path, kind: str) -> Path:
    scale = {"tum": 0.0002, "icl-nuim": 0.0002, "replica": 1 / 6553.5}.get(kind, 0.001)
    colors, depths = {
        "tum": ([f"rgb/{s}.png" for s in STAMPS], [f"depth/{s}.png" for s in STAMPS]),
        "icl-nuim": (["rgb/0.png", "rgb/1.png"], ["depth/0.png", "depth/1.png"]),
        "redwood": (["image/0001.jpg", "image/0002.jpg"], ["depth/0001.png", "depth/0002.png"]),
        "replica": (["results/frame000000.jpg"], ["results/depth000000.png"]),
        "scannet": (["color/0.jpg", "color/1.jpg"], ["depth/0.png", "depth/1.png"]),
        "7scenes": (["frame-000000.color.png"], ["frame-000000.depth.png"]),
        "record3d": (["rgb/0.jpg"], ["depth/0.png"]),
        "separate": (["color/0.jpg"], ["depth/0.png"]),
    }[kind]
    for name in (*colors, *depths):
        image(root / name, scale)
    texts = {
        "tum": {
            "rgb.txt": "".join(f"{s} rgb/{s}.png\n" for s in STAMPS),
            "depth.txt": "".join(f"{s} depth/{s}.png\n" for s in STAMPS),
            "groundtruth.txt": f"{STAMPS[0]} 0 0 0 0 0 0 1\n",
            "camera.yaml": "fx: 60\nfy: 60\ncx: 31.5\ncy: 23.5\n",
        },
        "icl-nuim": {
            "associations.txt": "0 depth/0.png 0 rgb/0.png\n1 depth/1.png 1 rgb/1.png\n",
            "livingRoom0.gt.freiburg": "1 0 0 0 0 0 0 1\n",
            "camera.yaml": "K: [60, 0, 31.5, 0, -60, 23.5, 0, 0, 1]\n",
        },
        "redwood": {"camera_intrinsic.json": json.dumps(OPEN3D)},
        "replica": {"cam_params.json": json.dumps(REPLICA), "traj.txt": "1 0 0 0\n"},
        "scannet": {"intrinsic/intrinsic_color.txt": MATRIX, "pose/0.txt": MATRIX},
        "7scenes": {"camera-intrinsics.txt": MATRIX, "frame-000000.pose.txt": MATRIX},
        "record3d": {"metadata.json": json.dumps(RECORD3D)},
        "separate": {"intrinsics.json": json.dumps(RECORD3D)},
    }[kind]
    for name, text in texts.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return root


KINDS = ["tum", "icl-nuim", "redwood", "replica", "scannet", "7scenes", "record3d", "separate"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_layout_is_imported(kind: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    root = write(tmp_path / "rec", kind)
    assert detect_format(root) == "folder"
    with caplog.at_level("INFO", "std_toolkit"):
        scene = import_recording(ImportRequest(source=root, name="s"), tmp_path / "scene")
    assert f"layout: {kind}" in caplog.text
    camera = scene.camera(scene.frames[0])
    assert (camera.fx, camera.cx, camera.cy) == (60, 31.5, 23.5)
    depth = scene.read_depth(scene.frames[0])
    assert depth is not None and np.allclose(depth, 0.7, atol=2e-4)
    layout = find_layout(root)
    assert layout is not None
    if layout.poses is not None:
        assert f"--cameras {layout.poses}" in caplog.text


def test_icl_nuim_has_published_intrinsics(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    root = write(tmp_path / "rec", "icl-nuim")
    (root / "camera.yaml").unlink()
    for name in ("rgb/0.png", "rgb/1.png"):
        write_color(root / name, np.full((480, 640, 3), 80, np.uint8))
    for name in ("depth/0.png", "depth/1.png"):
        write_depth_png16(root / name, np.full((480, 640), 0.7), scale=0.0002)
    with caplog.at_level("INFO", "std_toolkit"):
        scene = import_recording(ImportRequest(source=root, name="s"), tmp_path / "scene")
    camera = scene.camera(scene.frames[0])
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (481.2, 480, 319.5, 239.5)
    assert "gt.freiburg --cameras-convention camera-to-world-unity" in caplog.text


def test_times_of_tum_stay_with_the_frames(tmp_path: Path) -> None:
    root = write(tmp_path / "rec", "tum")
    scene = import_recording(ImportRequest(source=root, name="s"), tmp_path / "scene")
    assert [f.timestamp for f in Scene.open(scene.root).frames] == [float(s) for s in STAMPS]


def test_a_layout_without_intrinsics_asks_for_them(tmp_path: Path) -> None:
    root = write(tmp_path / "rec", "separate")
    (root / "intrinsics.json").unlink()
    with pytest.raises(ToolkitError, match="--intrinsics"):
        import_recording(ImportRequest(source=root, name="s"), tmp_path / "scene")
    request = ImportRequest(source=root, name="s", intrinsics="60,60,31.5,23.5")
    assert len(import_recording(request, tmp_path / "scene").frames) == 1


def test_other_folders_are_none(tmp_path: Path) -> None:
    (tmp_path / "color").mkdir()
    assert find_layout(tmp_path) is None
    with pytest.raises(ToolkitError, match="cannot detect the format"):
        detect_format(tmp_path)


def test_folders_of_tum_have_its_unit_as_options_too(tmp_path: Path) -> None:
    root = write(tmp_path / "rec", "tum")
    request = ImportRequest(
        source=root / "rgb", name="s", color=str(root / "rgb"), depth=str(root / "depth"),
        intrinsics="60,60,31.5,23.5",
    )  # fmt: skip
    scene = import_recording(request, tmp_path / "scene")
    assert scene.info.depth_scale == 0.0002


def test_the_intrinsics_of_bundlefusion_are_in_info_txt(tmp_path: Path) -> None:
    root = write(tmp_path / "rec", "7scenes")
    (root / "camera-intrinsics.txt").unlink()
    matrix = "60 0 31.5 0 0 60 23.5 0 0 0 1 0 0 0 0 1"
    (root / "info.txt").write_text(
        f"m_colorWidth = {W}\nm_colorHeight = {H}\nm_depthShift = 1000.0\n"
        f"m_calibrationColorIntrinsic = {matrix}\nm_calibrationDepthIntrinsic = {matrix}\n"
    )
    scene = import_recording(ImportRequest(source=root, name="s"), tmp_path / "scene")
    camera = scene.camera(scene.frames[0])
    assert (camera.fx, camera.cx, camera.cy) == (60, 31.5, 23.5)
