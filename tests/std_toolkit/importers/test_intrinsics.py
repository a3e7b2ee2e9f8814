from __future__ import annotations

import json

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.intrinsics import parse_distortion, read_intrinsics

K = [[640.9, 0, 642.9], [0, 640.2, 366.8], [0, 0, 1]]
FLAT = [x for row in K for x in row]
EXPECTED = (640.9, 640.2, 642.9, 366.8)

REALSENSE_DUMP = """
 Intrinsic of "Infrared 1" / 640x360 / {Y8}
  Width:      	640
  Height:     	360
  PPX:        	315.9
  PPY:        	186.6
  Fx:         	443.9
  Fy:         	443.9
  Distortion: 	Brown Conrady
  Coeffs:     	0  	0  	0  	0  	0

 Intrinsic of "Color" / 640x360 / {RGB8}
  Width:      	640
  Height:     	360
  PPX:        	312.5
  PPY:        	173.2
  Fx:         	454.4
  Fy:         	453.4
  Distortion: 	Inverse Brown Conrady
  Coeffs:     	0  	0  	0  	0  	0

 Intrinsic of "Color" / 1280x720 / {RGB8}
  Width:      	1280
  Height:     	720
  PPX:        	642.9
  PPY:        	366.8
  Fx:         	640.9
  Fy:         	640.2
  Distortion: 	Inverse Brown Conrady
  Coeffs:     	0  	0  	0  	0  	0
"""

FILES = {
    "K nested": json.dumps({"K": K}),
    "K flat": json.dumps({"cam_K": FLAT, "depth_scale": 1.0}),
    "bare matrix": json.dumps(K),
    "open3d, column by column": json.dumps(
        {"width": 1280, "height": 720,
         "intrinsic_matrix": [640.9, 0, 0, 0, 640.2, 0, 642.9, 366.8, 1]}
    ),
    "realsense json": json.dumps(
        {"width": 1280, "height": 720, "fx": 640.9, "fy": 640.2, "ppx": 642.9, "ppy": 366.8,
         "model": "distortion.inverse_brown_conrady", "coeffs": [0.0] * 5}
    ),
    "realsense json, sections": json.dumps(
        {"depth": {"fx": 1.0}, "color": {"fx": 640.9, "fy": 640.2, "cx": 642.9, "cy": 366.8}}
    ),
    "nerf, which counts pixels from the corner": json.dumps(
        {"fl_x": 640.9, "fl_y": 640.2, "cx": 643.4, "cy": 367.3, "w": 1280, "h": 720}
    ),
    "yaml scalars": "# Camera\nxres: 1280   # Width\nyres: 720\nfx: 640.9  # px\nfy: 640.2\n"
    "cx: 642.9\ncy: 366.8\n",
    "yaml list over two lines": "INTRINSICS: [640.9, 0.0, 642.9, 0.0, 640.2,\n"
    "  366.8, 0.0, 0.0, 1.0]\n",
    "ros": "image_width: 1280\nimage_height: 720\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: "
    + str(FLAT)
    + "\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n"
    "  data: [0, 0, 0, 0, 0]\n",
    "text 3x3": "\n".join(" ".join(f"{x:.18e}" for x in row) for row in K),
    "text 4x4": "640.9 0 642.9 0\n0 640.2 366.8 0\n0 0 1 0\n0 0 0 1\n",
    "text four numbers": "640.9, 640.2, 642.9, 366.8\n",
    "realsense dump": REALSENSE_DUMP,
}  # fmt: skip


@pytest.mark.parametrize("kind", FILES)
def test_formats(kind, tmp_path):
    path = tmp_path / "intrinsics.any"
    path.write_text(FILES[kind])
    found = read_intrinsics(str(path), size=(1280, 720))
    assert (found.fx, found.fy, found.cx, found.cy) == pytest.approx(EXPECTED)
    assert found.distortion == ()
    assert found.size in (None, (1280, 720))


def test_numbers_on_the_command_line():
    found = read_intrinsics("640.9,640.2, 642.9,366.8")
    assert (found.fx, found.fy, found.cx, found.cy) == EXPECTED
    assert parse_distortion("0.1,-0.2,0,0,0.01") == (0.1, -0.2, 0, 0, 0.01)
    with pytest.raises(ToolkitError, match="k1,k2"):
        parse_distortion("0.1;0.2")


def test_distortion_of_a_file(tmp_path):
    path = tmp_path / "k.json"
    path.write_text(json.dumps({"K": K, "distortion": [0.1, -0.2, 0.001, 0.002, 0.03]}))
    assert read_intrinsics(str(path)).distortion == (0.1, -0.2, 0.001, 0.002, 0.03)
    path.write_text("fx: 640\nfy: 640\ncx: 642\ncy: 366\nk1: 0.1\nk2: -0.2\n")
    assert read_intrinsics(str(path)).distortion == (0.1, -0.2, 0, 0, 0)


def test_the_realsense_colour_stream_of_the_images_size_is_taken(tmp_path):
    path = tmp_path / "dump.txt"
    path.write_text(REALSENSE_DUMP)
    assert read_intrinsics(str(path), size=(640, 360)).fx == 454.4
    with pytest.raises(ToolkitError, match="640x360, 1280x720"):
        read_intrinsics(str(path), size=(848, 480))


REFUSED = {
    "not there": (None, "no such intrinsics file"),
    "empty": ("", "no intrinsics found"),
    "binary": (b"\x89PNG\xff\xfe", "not text"),
    "broken json": ('{"K": [[1, 2', "not valid JSON"),
    "deep json": ('{"K": ' + "[" * 100000, "not valid JSON"),
    "no camera": ('{"a": 1}', "incomplete"),
    "strings": ('{"K": [["a", 0, 1], [0, 1, 1], [0, 0, 1]]}', "finite number"),
    "nan": ('{"fx": NaN, "fy": 1, "cx": 1, "cy": 1}', "finite number"),
    "nan text": ("nan 0 1\n0 1 1\n0 0 1", "finite number"),
    "booleans": ('{"fx": true, "fy": 1, "cx": 1, "cy": 1}', "finite number"),
    "too few": ("1 2 3", "9 numbers"),
    "skewed": ("500 3 320\n0 500 240\n0 0 1", "skewed"),
    "a projection": ("500 0 320\n0 500 240\n0 0 2", "not a camera matrix"),
    "foreign lens": (
        '{"fx": 1, "fy": 1, "ppx": 1, "ppy": 1, "model": "F-Theta", "coeffs": [1,1,1,1]}',
        "distortion model",
    ),
    "prose": ("take the usual ones", "no intrinsics found"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_refused(kind, tmp_path):
    content, problem = REFUSED[kind]
    path = tmp_path / "k"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        path.write_text(content)
    with pytest.raises(ToolkitError, match=problem) as error:
        read_intrinsics(str(path))
    assert "\n" not in str(error.value)
    assert "k" in str(error.value)


@pytest.mark.parametrize("size", [(640, 480), (640, 360), (2560, 1440), (1920, 1080), (720, 1280)])
def test_intrinsics_of_another_image_size_are_refused(size):
    with pytest.raises(ToolkitError, match="image"):
        read_intrinsics("640.9,640.2,642.9,366.8").camera(size, path="--intrinsics")


def test_a_declared_size_must_be_the_images_own(tmp_path):
    path = tmp_path / "k.json"
    path.write_text(json.dumps({"K": K, "width": 1280, "height": 800}))
    with pytest.raises(ToolkitError, match="1280x800 images, these are 1280x720"):
        read_intrinsics(str(path)).camera((1280, 720), path=str(path))


def test_cropped_images_on_request():
    given = read_intrinsics("600,600,400,200")
    with pytest.raises(ToolkitError, match="--off-centre"):
        given.camera((600, 480), path="k")
    assert given.camera((600, 480), path="k", off_centre=True).cx == 400


def test_arrays_of_numpy_by_name(tmp_path) -> None:
    """`np.savez("calib.npz", mtx=mtx, dist=dist)` after OpenCV's calibrateCamera."""
    K = np.array([[60.0, 0, 31], [0, 61, 24], [0, 0, 1]])
    np.savez(tmp_path / "calib.npz", mtx=K, dist=[[-0.28, 0.07, 0.0002, 1.7e-05, 0.01]], rms=0.3)
    found = read_intrinsics(str(tmp_path / "calib.npz"))
    assert (found.fx, found.fy, found.cx, found.cy) == (60, 61, 31, 24)
    assert found.distortion == (-0.28, 0.07, 0.0002, 1.7e-05, 0.01)
    (tmp_path / "calib.pkl").write_bytes(b"\x80\x04N.")
    with pytest.raises(ToolkitError, match=r"calib.pkl: files of pickle.*\.npz"):
        read_intrinsics(str(tmp_path / "calib.pkl"))


def test_a_size_in_words_is_width_and_height(tmp_path) -> None:
    path = tmp_path / "k.json"
    path.write_text('{"fx": 60, "fy": 61, "cx": 31, "cy": 24, "resolution": "128x96"}')
    assert read_intrinsics(str(path)).size == (128, 96)


@pytest.mark.parametrize("text", ["-300,-300,160,120", "0,300,160,120", "300,0,160,120"])
def test_focal_lengths_that_no_camera_has(text) -> None:
    with pytest.raises(ToolkitError, match="--intrinsics: focal lengths must be positive"):
        read_intrinsics(text)
