"""Lenses in the files of other programs: read, or refused by the key's name; none is dropped."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.intrinsics import read_intrinsics
from std_toolkit.poses.camera_file import read_cameras

K = [60, 0, 31.5, 0, 60, 23.5, 0, 0, 1]
FIVE = (-0.28, 0.07, 2e-4, 1.7e-5, 0.0)
FOUR = FIVE[:4]
# The order of Camera2: k1 k2 k3 p1 p2.
ANDROID = [FIVE[i] for i in (0, 1, 4, 2, 3)]
EIGHT = (0.46, -2.45, 6e-4, -2e-4, 1.42, 0.34, -2.27, 1.35)
KB4 = (0.03, 0.005, 6e-4, 1e-4)
NUMBERS = {"fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5}
NAMED = dict(zip(("k1", "k2", "p1", "p2"), FOUR, strict=True))
FISH = dict(zip(("k1", "k2", "k3", "k4"), KB4, strict=True))


def lines(**values: object) -> str:
    return "".join(f"{key}: {value}\n" for key, value in values.items())


def dotted(prefix: str, **values: object) -> str:
    return "".join(f"{prefix}.{key}: {value}\n" for key, value in values.items())


def opencv_matrix(name: str, values: object, rows: int = 3, columns: int = 3) -> str:
    return (
        f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n"
        f"   data: {list(values)}\n"  # type: ignore[call-overload]
    )


ROS = lines(image_width=64, image_height=48) + (
    f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {K}\ndistortion_model: plumb_bob\n"
)
BLOCK = "distortion_coefficients:\n  rows: 1\n  cols: 5\n  data:\n" + "".join(
    f"  - {x}\n" for x in FIVE
)
ECHO = (
    "height: 48\nwidth: 64\ndistortion_model: plumb_bob\nd:\n"
    + "".join(f"- {x}\n" for x in FIVE)
    + "k:\n"
    + "".join(f"- {x}\n" for x in K)
    + "binning_x: 0\n---\n"
)
KALIBR = {
    "camera_model": "pinhole", "distortion_coeffs": list(FOUR), "distortion_model": "radtan",
    "intrinsics": [60, 60, 31.5, 23.5], "resolution": [64, 48],
}  # fmt: skip

READ: dict[str, tuple[str, str, tuple[float, ...]]] = {
    "ros, list of lines": (ROS + BLOCK, "opencv", FIVE),
    "ros2 topic echo": (ECHO, "opencv", FIVE),
    "ros2 topic echo, a region in halves": (
        ECHO.replace("height: 48\nwidth: 64", "height: 200\nwidth: 300")
        .replace("d:\n", "roi:\n  x_offset: 7\n  y_offset: 5\n  height: 96\n  width: 128\nd:\n")
        .replace(f"{K[0]}\n", "120\n").replace(f"- {K[4]}\n", "- 120\n")
        .replace("31.5", "70.5").replace("23.5", "52.5")
        .replace("binning_x: 0", "binning_x: 2\nbinning_y: 2"), "opencv", FIVE),
    "ros2 topic echo, two messages": (ECHO + ECHO, "opencv", FIVE),
    "kalibr": (f"cam0:\n  {lines(**KALIBR).strip().replace(chr(10), chr(10) + '  ')}\n",
               "opencv", FOUR),
    "kalibr equidistant": (
        lines(**{**KALIBR, "distortion_model": "equidistant", "distortion_coeffs": list(KB4)}),
        "fisheye", KB4,
    ),
    "opencv": (
        "%YAML:1.0\n---\n" + opencv_matrix("camera_matrix", K)
        + opencv_matrix("distCoeffs", FIVE, 1, 5), "opencv", FIVE,
    ),
    "opencv json": (json.dumps({
        "cameraMatrix": {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": K},
        "distCoeffs": {"type_id": "opencv-matrix", "rows": 1, "cols": 5, "data": FIVE}}),
        "opencv", FIVE,
    ),
    "opencv xml": (
        '<?xml version="1.0"?>\n<opencv_storage><Camera_Matrix type_id="opencv-matrix"><rows>3'
        "</rows><cols>3</cols><dt>d</dt><data>6.0e+01 0. 3.15e+01 0. 60. 23.5 0. 0. 1.</data>"
        "</Camera_Matrix><Distortion_Coefficients><rows>5</rows><cols>1</cols><data>-0.28 0.07 "
        "0.0002 1.7e-05 0.</data></Distortion_Coefficients></opencv_storage>", "opencv", FIVE,
    ),
    "six k": (json.dumps({**NUMBERS, **dict(zip(
        ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), EIGHT, strict=True))}), "opencv", EIGHT),
    "nested list": (json.dumps({"camera_matrix": np.reshape(K, (3, 3)).tolist(),
                                "dist_coeff": [FIVE]}), "opencv", FIVE),
    "mtx and dist": (json.dumps({"mtx": K, "dist": [FIVE]}), "opencv", FIVE),
    "a section of its own": (json.dumps({"intrinsics": NUMBERS, "distortion": NAMED}),
                             "opencv", FIVE),
    "a section that names the model": (json.dumps(
        {"K": K, "distortion": {"model": "equidistant", "coefficients": KB4}}), "fisheye", KB4),
    "radial and tangential": (json.dumps(
        {"K": K, "RadialDistortion": FIVE[:2], "TangentialDistortion": FIVE[2:4]}),
        "opencv", FOUR),
    "orb-slam2": ("%YAML:1.0\n\n" + dotted("Camera", **NUMBERS, **NAMED, width=64, height=48)
                  + "DepthMapFactor: 5000.0\nViewer.PointSize: 2\n", "opencv", FIVE),
    "orb-slam3 fisheye": (
        '%YAML:1.0\nCamera.type: "KannalaBrandt8"\n' + dotted("Camera1", **NUMBERS, **FISH),
        "fisheye", KB4),
    "vins": ("%YAML:1.0\n---\nmodel_type: PINHOLE\ndistortion_parameters:\n"
             + "".join(f"   {k}: {v}\n" for k, v in NAMED.items()) + "projection_parameters:\n"
             + "".join(f"   {k}: {v}\n" for k, v in NUMBERS.items()), "opencv", FIVE),
    "vins, which counts from k2": (
        "model_type: KANNALA_BRANDT\nprojection_parameters:\n  k2: 0.03\n  k3: 0.005\n"
        "  k4: 0.0006\n  k5: 0.0001\n  mu: 60\n  mv: 60\n  u0: 31.5\n  v0: 23.5\n",
        "fisheye", KB4),
    "basalt": (json.dumps({"value0": {"intrinsics": [
        {"camera_type": "kb4", "intrinsics": {**NUMBERS, **FISH}}]}}), "fisheye", KB4),
    "print of librealsense": ("[ 64x48  p[31.5 23.5]  f[60 60]  Brown Conrady "
                              "[-0.28 0.07 0.0002 1.7e-05 0] ]", "opencv", FIVE),
    "librealsense without distortion": (json.dumps({
        "fx": 60, "fy": 60, "ppx": 31.5, "ppy": 23.5, "model": "distortion.inverse_brown_conrady",
        "coeffs": [0.0] * 5}), "opencv", ()),
    "oak": (json.dumps({"cameraData": [[0, {
        "cameraType": 0, "distortionCoeff": [*FIVE, *[0.0] * 9], "lensPosition": 135,
        "intrinsicMatrix": np.reshape(K, (3, 3)).tolist()}]]}), "opencv", (*FIVE, 0, 0, 0)),
    "colmap": ("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 OPENCV 64 48 60 60 32 24 "
               "-0.28 0.07 0.0002 1.7e-05\n", "opencv", FOUR),
    "colmap, radial fisheye": ("1 SIMPLE_RADIAL_FISHEYE 64 48 60 32 24 0.01\n", "fisheye",
                               (0.01, 0, 0, 0)),
    "transforms of each frame": (json.dumps({"frames": 2 * [
        {"file_path": "a", "fl_x": 60, "fl_y": 60, "cx": 32, "cy": 24, **NAMED}]}),
        "opencv", FIVE),
    "angle of view": (json.dumps({"camera_angle_x": 2 * np.arctan(32 / 60), "frames": []}),
                      "opencv", ()),
    "record3d, column by column": (json.dumps(
        {"w": 64, "h": 48, "K": [60, 0, 0, 0, 60, 0, 31.5, 23.5, 1]}), "opencv", ()),
    "scannet": ("colorHeight = 48\ncolorWidth = 64\nfx_color = 60.0\nfx_depth = 57.0\n"
                "fy_color = 60.0\nfy_depth = 57.0\nmx_color = 31.5\nmx_depth = 31\n"
                "my_color = 23.5\nmy_depth = 23\nsceneType = Apartment\n", "opencv", ()),
    "utf-16": (lines(**NUMBERS), "opencv", ()),
    "byte order mark": ("\ufeff" + json.dumps(NUMBERS), "opencv", ()),
    "a device is no lens": (json.dumps({"K": K, "model": "Intel RealSense D435"}), "opencv", ()),
    "zeros say nothing": (json.dumps({"K": K, "my_distortion_thing": [0, 0, 0]}), "opencv", ()),
    "a number of librealsense for its model": (json.dumps(
        {**NUMBERS, "model": 5, "coeffs": [*KB4, 0]}), "fisheye", KB4),
    "record3d, each frame": (json.dumps(
        {"w": 64, "h": 48, "K": [60, 0, 0, 0, 60, 0, 31.5, 23.5, 1],
         "perFrameIntrinsicCoeffs": [[60, 60, 31.5, 23.5]]}), "opencv", ()),
    "matlab counts pixels from 1": (json.dumps(
        {"IntrinsicMatrix": [[60, 0, 0], [0, 60, 0], [32.5, 24.5, 1]], "ImageSize": [48, 64],
         "RadialDistortion": FIVE[:2], "TangentialDistortion": FIVE[2:4]}), "opencv", FOUR),
    "matlab's cameraIntrinsics, too": (json.dumps(
        {"FocalLength": [60, 60], "PrincipalPoint": [32.5, 24.5], "ImageSize": [48, 64],
         "RadialDistortion": FIVE[:2], "TangentialDistortion": FIVE[2:4]}), "opencv", FOUR),
    "y up, as ICL-NUIM": (json.dumps({"K": [60, 0, 31.5, 0, -60, 23.5, 0, 0, 1]}), "opencv", ()),
    "numbers as text": (json.dumps({k: str(v) for k, v in {**NUMBERS, **NAMED}.items()}),
                        "opencv", FIVE),
    "a list as text": (
        lines(**NUMBERS, dist='"-0.28, 0.07, 0.0002, 1.7e-05, 0.0"'), "opencv", FIVE),
    "a print of numpy": (
        "[[60.   0.  31.5]\n [ 0.  60.  23.5]\n [ 0.   0.   1. ]]\n", "opencv", ()),
    "height before width": (json.dumps({**NUMBERS, "image_size": [48, 64]}), "opencv", ()),
    "android": (json.dumps({**NUMBERS, "lensDistortion": ANDROID}), "opencv", FIVE),
    "android, constant": (json.dumps({**NUMBERS, "LENS_DISTORTION": ANDROID}), "opencv", FIVE),
    "android, dotted": (json.dumps({**NUMBERS, "android.lens.distortion": ANDROID}),
                        "opencv", FIVE),
    "android, snake": (json.dumps({**NUMBERS, "lens_distortion": ANDROID,
                                   "lens_pose_rotation": [0, 0, 0, 1]}), "opencv", FIVE),
    "android, zeros": (json.dumps({**NUMBERS, "lensDistortion": [0.0] * 5}), "opencv", ()),
    "snake, in OpenCV's order": (json.dumps({**NUMBERS, "lens_distortion": FIVE}),
                                 "opencv", FIVE),
    "camel, four of OpenCV": (json.dumps({**NUMBERS, "lensDistortion": FIVE[:4]}),
                              "opencv", FOUR),
    "ost.txt of ROS's camera_calibration": (
        "# oST version 5.0 parameters\n\n[image]\n\nwidth\n64\n\nheight\n48\n\n[narrow_stereo]\n\n"
        "camera matrix\n60.0 0.0 31.5\n0.0 60.0 23.5\n0.0 0.0 1.0\n\ndistortion\n"
        "-0.28 0.07 0.0002 1.7e-05 0.0\n\nrectification\n1.0 0.0 0.0\n0.0 1.0 0.0\n0.0 0.0 1.0\n\n"
        "projection\n55.0 0.0 30.0 0.0\n0.0 56.0 22.0 0.0\n0.0 0.0 1.0 0.0\n", "opencv", FIVE),
    "info.txt of BundleFusion": (
        "m_sensorName = StructureSensor\nm_colorWidth = 64\nm_colorHeight = 48\n"
        "m_depthWidth = 32\nm_depthHeight = 24\nm_depthShift = 1000.0\n"
        "m_calibrationColorIntrinsic = 60 0 31.5 0 0 60 23.5 0 0 0 1 0 0 0 0 1\n"
        "m_calibrationColorExtrinsic = 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n"
        "m_calibrationDepthIntrinsic = 30 0 15 0 0 30 11 0 0 0 1 0 0 0 0 1\n", "opencv", ()),
    "matlab's cameraParameters": (json.dumps(
        {"IntrinsicMatrix": [[60, 0, 0], [0, 60, 0], [32.5, 24.5, 1]],
         "NumRadialDistortionCoefficients": 2, "EstimateTangentialDistortion": True,
         "RadialDistortion": FIVE[:2], "TangentialDistortion": FIVE[2:4]}), "opencv", FOUR),
    "distances are no distortion": (json.dumps({"K": K, "distance": 0.7, "max_dist": 3}),
                                    "opencv", ()),
}  # fmt: skip


@pytest.mark.parametrize("kind", READ)
def test_read(kind: str, tmp_path: Path) -> None:
    text, model, distortion = READ[kind]
    path = tmp_path / "lens.file"
    path.write_bytes(text.encode("utf-16" if kind == "utf-16" else "utf-8"))
    found = read_intrinsics(str(path), size=(64, 48))
    assert (found.fx, found.fy, found.cx, found.cy) == pytest.approx((60, 60, 31.5, 23.5))
    assert (found.model, found.distortion) == (model, pytest.approx(distortion))
    assert found.size in (None, (64, 48))


TWO = "".join(dotted(f"Camera{i}", **{**NUMBERS, "fx": 60 + i}, k1=-0.28) for i in (1, 2))
REFUSED: dict[str, tuple[str, str]] = {
    "android's former convention": (
        json.dumps({**NUMBERS, "lensRadialDistortion": [1, *ANDROID]}), "lensRadialDistortion"),
    "android's former convention, constant": (
        json.dumps({**NUMBERS, "LENS_RADIAL_DISTORTION": [1, *ANDROID]}), "LENS_RADIAL_DIST"),
    "android's former convention, dotted": (
        json.dumps({**NUMBERS, "android.lens.radialDistortion": [1, *ANDROID]}),
        "lensRadialDistortion"),
    "an unknown key": (json.dumps({"K": K, "my_distortion_thing": FIVE}), "my_distortion_thing"),
    "omni": (lines(**{**KALIBR, "camera_model": "omni", "distortion_coeffs": [0, 0, 0, 0],
                      "intrinsics": [1.2, 60, 60, 31.5, 23.5]}), "camera_model.*omni"),
    "double sphere": (json.dumps({"intrinsics": [
        {"camera_type": "ds", "intrinsics": {**NUMBERS, "xi": -0.2}}]}), "camera_type.*ds"),
    "xi": (json.dumps({**NUMBERS, "xi": 0.3}), "xi"),
    "orthophoto": (json.dumps({**NUMBERS, "camera_model": "ORTHOPHOTO"}), "camera_model"),
    "meshroom": (json.dumps({"intrinsics": [{"type": "radial3", "focalLength": 33.75,
        "principalPoint": [0, 0], "distortionParams": [-0.2, 0.1, 0.01]}]}), "type.*radial3"),
    "scaramuzza": (json.dumps({**NUMBERS, "camera_model": "scaramuzza"}), "camera_model"),
    "inverse": ("[ 64x48  p[31.5 23.5]  f[60 60]  Inverse Brown Conrady [0.1 0 0 0 0] ]", "model"),
    "thin prism": ("1 THIN_PRISM_FISHEYE 64 48 60 60 32 24 0 0 0 0 0 0 0 0\n", "THIN_PRISM"),
    "nerfstudio's longer polynomial": (json.dumps(
        {**NUMBERS, "camera_model": "OPENCV", **FISH}), "k4"),
    "distorted, but how": (json.dumps({"K": K, "distorted": True}), "distorted"),
    "a fisheye by number": (json.dumps({"K": K, "cameraType": 1, "distortionCoeff": FOUR}),
                            "cameraType.*stated by a number"),
    "a number of librealsense": (json.dumps({**NUMBERS, "model": 2, "coeffs": FIVE}),
                                 "model.*inverse brown conrady"),
    "polynomial of instant-ngp": (json.dumps({**NUMBERS, "ftheta_p0": 0.1}), "ftheta_p0"),
    "latitude and longitude": (json.dumps({**NUMBERS, "latlong": True}), "latlong"),
    "centre of distortion": (json.dumps({**NUMBERS, **NAMED, "codx": 0.1}), "codx"),
    "two spellings": (json.dumps({"K": K, "k": FOUR}), "K and k differ only"),
    "no matrix": (json.dumps({**NUMBERS, "k": FOUR}), "k: is no camera matrix beside fx"),
    "decimal commas": (lines(**NUMBERS, dist='"-0,28, 0,07, 0,0002, 0,00002"'), "dist: looks like"),
    "a lens in a section of its own": (json.dumps({"camera": NUMBERS, "optics": NAMED}), "optics"),
    "numbers without names": (json.dumps({"K": K, "distortion": {"0": -0.28, "1": 0.07}}),
                              "distortion: looks like"),
    "that of another image": (json.dumps({"calibration": {"K": K}, "undistortion": NAMED}),
                              "undistortion: looks like"),
    "two lenses beside one camera": (json.dumps(
        {"camera": {"K": K}, "a_dist": NAMED, "b_dist": {**NAMED, "k1": 0.1}}), "a_dist"),
    "two statements": (json.dumps({"K": K, "D": FIVE, "k1": 0.1}), "k1.*contradicts D"),
    "two lists": (json.dumps({"K": K, "D": FIVE, "dist": EIGHT}), "different distortions"),
    "tangential of a fisheye": (json.dumps(
        {**NUMBERS, "is_fisheye": True, **FISH, "p1": 0.1}), "p1.*fisheye"),
    "two cameras": (TWO, "2 cameras.*--camera NAME: Camera1, Camera2"),
    "cameras of a scene": (json.dumps({"0": {"cam_K": K}, "1": {"cam_K": [61, *K[1:]]}}),
                           "2 cameras.*0, 1"),
    "an alias": ("a: &x [1, 2]\nK: *x\n", "aliases"),
    "a doctype": ("<!DOCTYPE a [<!ENTITY b 'c'>]><a><fx>1</fx></a>", "DOCTYPE"),
    "a model behind numbers of its own": (lines(
        model_type="MEI", projection_parameters={"gamma1": 60, "u0": 31}), "model_type.*MEI"),
    "no camera": (json.dumps({"CalibrationInformation": {}}), "fx.*'CalibrationInformation'"),
    "k1 alone": (json.dumps({**NUMBERS, "dist": [-0.28]}), "needs 4, 5 or 8 coefficients"),
    "deep": ("K: " + "[" * 60 + "]" * 60, "nested deeper"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_refused_by_name(kind: str, tmp_path: Path) -> None:
    text, words = REFUSED[kind]
    path = tmp_path / "lens.file"
    path.write_text(text)
    with pytest.raises(ToolkitError, match=words) as error:
        read_intrinsics(str(path), size=(64, 48))
    assert "lens.file" in str(error.value)


def test_one_of_several_cameras(tmp_path: Path) -> None:
    path = tmp_path / "stereo.yaml"
    path.write_text(TWO)
    assert read_intrinsics(str(path), camera="Camera2").fx == 62
    with pytest.raises(ToolkitError, match=r"--camera: no such camera.*Camera1, Camera2"):
        read_intrinsics(str(path), camera="Camera3")
    first = opencv_matrix("M1", K) + opencv_matrix("D1", FIVE, 1, 5)
    second = opencv_matrix("M2", [61, *K[1:]]) + opencv_matrix("D2", FOUR, 1, 4)
    path.write_text(first + second)
    found = read_intrinsics(str(path), camera="2")
    assert (found.fx, found.distortion) == (61, FOUR)


def test_other_cameras_may_have_any_lens(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    other = {**NUMBERS, "camera_model": "omni", "xi": 1.8}
    path.write_text(json.dumps({"cam0": other, "cam1": {**NUMBERS, **NAMED}}))
    assert read_intrinsics(str(path), camera="cam1").distortion == FIVE
    for camera in (None, "cam0"):
        with pytest.raises(ToolkitError, match=r"cam0.camera_model.*omni"):
            read_intrinsics(str(path), camera=camera)


def test_cameras_of_a_list_have_their_names(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    rows = [{"camera_id": n, **NUMBERS, "fx": fx} for n, fx in (("left", 60), ("right", 61))]
    path.write_text(json.dumps({"cameras": rows}))
    assert read_intrinsics(str(path), camera="right").fx == 61


def test_each_camera_has_the_lens_of_its_name(tmp_path: Path) -> None:
    path = tmp_path / "zed.conf"
    camera = "fx=60\nfy=60\ncx=31.5\ncy=23.5\n"
    path.write_text(
        f"[LEFT_CAM_HD]\n{camera}[RIGHT_CAM_HD]\n{camera}[LEFT_DISTO]\nk1=0.1\nk2=0\n"
        "[RIGHT_DISTO]\nk1=-0.2\nk2=0\n"
    )
    for name, k1 in (("LEFT_CAM_HD", 0.1), ("RIGHT_CAM_HD", -0.2)):
        assert read_intrinsics(str(path), camera=name).distortion == (k1, 0, 0, 0, 0)


@pytest.mark.parametrize(
    "size", [{"image_size": [66, 50]}, {"resolution": "66x50"}, {"shape": [50, 66, 3]}]
)
def test_the_size_that_a_file_states(size: dict[str, object], tmp_path: Path) -> None:
    path = tmp_path / "k.json"
    path.write_text(json.dumps({**NUMBERS, **size}))
    assert read_intrinsics(str(path)).size == (66, 50)


def test_the_colour_camera_is_taken_of_colour_and_depth(tmp_path: Path) -> None:
    path = tmp_path / "both.json"
    path.write_text(json.dumps({"depth": {**NUMBERS, "fx": 57}, "color": NUMBERS}))
    assert read_intrinsics(str(path)).fx == 60
    assert read_intrinsics(str(path), camera="depth").fx == 57


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"K": K}, "lens.json: it states no distortion"),
        ({**NUMBERS, "fy": -60}, "fy is -60: y points up, axes are left-handed; 60 is taken"),
        ({"K": K, "D": [0, 0, 0, 0]}, "no distortion (D is 0)"),
        ({"K": K, "D": FIVE}, "opencv lens -0.28 0.07 0.0002 1.7e-05 0 (from D)"),
    ],
)
def test_what_was_read_is_said(
    fields: dict[str, object], words: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "lens.json"
    path.write_text(json.dumps(fields))
    with caplog.at_level("INFO", "std_toolkit"):
        read_intrinsics(str(path))
    assert words in caplog.text


@pytest.mark.parametrize(
    ("fields", "unit"),
    [
        ({**NUMBERS, "depth_scale": 0.1, "width": 64, "height": 48}, 1e-4),  # BOP's camera.json
        ({"camera": {**NUMBERS, "scale": 6553.5}}, 1 / 6553.5),
        ({"K": K, "depth_scale": 1000}, 0.001),
        ({"K": K, "depth_scale": 0.00025}, 0.00025),
        ({"K": K, "depth_scale": "0.00025"}, 0.00025),
        ({"K": K, "depth_unit_scale_factor": 0.0002}, 0.0002),
        ({"K": K, "depthShift": 4000}, 0.00025),
        ({"color": NUMBERS, "depth": {**NUMBERS, "scale": 0.00025}}, 0.00025),
        ({"K": K, "scale": 1.0}, None),
        ({"K": K}, None),
    ],
)
def test_the_unit_of_depth_that_a_file_states(
    fields: dict[str, object], unit: float | None, tmp_path: Path
) -> None:
    path = tmp_path / "k.json"
    path.write_text(json.dumps(fields))
    assert read_intrinsics(str(path)).depth_scale == (None if unit is None else pytest.approx(unit))


def test_an_array_of_numpy(tmp_path: Path) -> None:
    np.save(tmp_path / "K.npy", np.reshape(K, (3, 3)).astype(float))
    assert read_intrinsics(str(tmp_path / "K.npy")).cx == 31.5


def test_half_a_pixel_is_counted_once(tmp_path: Path) -> None:
    """`--intrinsics transforms.json` and `--cameras transforms.json` have one principal point."""
    row = {"file_path": "0.png", "transform_matrix": np.eye(4).tolist()}
    lens = {"fl_x": 60, "fl_y": 60, "cx": 32, "cy": 24, "w": 64, "h": 48, **NAMED}
    (tmp_path / "transforms.json").write_text(json.dumps({**lens, "frames": [row]}))
    one = read_intrinsics(str(tmp_path / "transforms.json"))
    two = read_cameras(tmp_path / "transforms.json").lens()
    assert two is not None and (one.cx, one.cy) == (two.cx, two.cy) == (31.5, 23.5)
    assert one.distortion[:4] == two.distortion[:4] == FOUR


def test_intrinsics_replace_those_that_a_file_of_poses_lacks(tmp_path: Path) -> None:
    row = {"file_path": "0.png", "transform_matrix": np.eye(4).tolist()}
    (tmp_path / "t.json").write_text(json.dumps({"fl_x": 60, "fl_y": 60, "frames": [row]}))
    filed = read_cameras(tmp_path / "t.json")
    assert len(filed.matrices) == 1
    with pytest.raises(ToolkitError, match="incomplete"):
        filed.lens()
    omni = {"fl_x": 60, "fl_y": 60, "cx": 32, "cy": 24, "camera_model": "OMNI", "frames": [row]}
    (tmp_path / "t.json").write_text(json.dumps(omni))
    with pytest.raises(ToolkitError, match=r"camera_model.*OMNI"):
        read_cameras(tmp_path / "t.json").lens()


def test_intrinsics_of_each_image_are_named_where_one_is_wanted(tmp_path: Path, caplog) -> None:
    document = {"w": 64, "h": 48, "K": K, "perFrameIntrinsicCoeffs": [[60, 60, 31.5, 23.5]] * 2}
    path = tmp_path / "metadata.json"
    path.write_text(json.dumps(document))
    read_intrinsics(str(path))
    assert "image to image" not in caplog.text
    document["perFrameIntrinsicCoeffs"][1] = [61, 61, 31.5, 23.5]
    path.write_text(json.dumps(document))
    read_intrinsics(str(path))
    assert "metadata.json: the intrinsics change from image to image" in caplog.text


def test_the_order_of_android_is_printed(tmp_path: Path, caplog) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({**NUMBERS, "lensDistortion": [0.1, 0.2, 0.3, 0.4, 0.5]}))
    with caplog.at_level("INFO", "std_toolkit"):
        assert read_intrinsics(str(path)).distortion == (0.1, 0.2, 0.4, 0.5, 0.3)
    assert "(from lensDistortion, in Android's order k1 k2 k3 p1 p2)" in caplog.text


def test_both_angles_of_view(tmp_path: Path) -> None:
    path = tmp_path / "transforms.json"
    x, y = 2 * np.arctan(32 / 60), 2 * np.arctan(24 / 50)
    path.write_text(json.dumps({"camera_angle_x": x, "camera_angle_y": y, "frames": []}))
    found = read_intrinsics(str(path), size=(64, 48))
    assert (found.fx, found.fy) == (pytest.approx(60), pytest.approx(50))
    path.write_text(json.dumps({"camera_angle_x": x, "camera_angle_y": 4, "frames": []}))
    with pytest.raises(ToolkitError, match="camera_angle_y: must be an angle"):
        read_intrinsics(str(path), size=(64, 48))


def test_the_depth_unit_of_a_scene_of_bop(tmp_path: Path) -> None:
    path = tmp_path / "scene_camera.json"
    path.write_text(json.dumps({str(i): {"cam_K": K, "depth_scale": 0.1} for i in range(2)}))
    assert read_intrinsics(str(path), size=(64, 48)).depth_scale == pytest.approx(1e-4)
