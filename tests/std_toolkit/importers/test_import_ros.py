"""Recordings of ROS, written by an independent package and read back."""

from __future__ import annotations

import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags")

from std_toolkit.cli.main import main
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera, undistort_image
from std_toolkit.importers import ros_importer
from std_toolkit.importers.foreign_files import is_ros_recording
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.importer import detect_format
from std_toolkit.importers.options import ImportRequest
from std_toolkit.importers.ros_images import pair_stamps
from std_toolkit.io.bounded_bags import LARGEST_MESSAGE_BYTES
from std_toolkit.io.images import read_color, write_png
from std_toolkit.scene.scene import Scene
from tests.std_toolkit.importers.ros_on_disk import (
    COLOR,
    DEPTH,
    SIZE,
    K,
    RosWriter,
    color_image,
    compressed_depth,
    depth_mm,
    write_recording,
)

INFO = "/camera/color/camera_info"


def imported(source: Path, **options: str) -> Scene:
    request = ImportRequest(source=source, name="bag", **options)
    return import_recording(request, source.parent / "scene")


def check_scene(scene: Scene, frames: int = 4) -> None:
    assert len(scene.frames) == frames
    for i, frame in enumerate(scene.frames):
        assert np.array_equal(scene.read_color(frame), color_image(i))
        assert np.array_equal(scene.read_depth(frame), depth_mm(i) * np.float32(0.001))
    assert scene.camera(scene.frames[0]).K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist() == list(K)
    assert scene.camera(scene.frames[0]).distortion == ()
    assert scene.frames[1].timestamp == pytest.approx(100.1)


@pytest.mark.parametrize("kind", ["mcap folder", "mcap file", "sqlite3 folder", "db3 file", "bag"])
def test_every_kind_of_recording_is_read(kind: str, tmp_path: Path) -> None:
    storage = "sqlite3" if kind.startswith(("sqlite3", "db3")) else "mcap"
    path = tmp_path / ("rec.bag" if kind == "bag" else "rec")
    write_recording(path, storage=storage)
    if kind.endswith("file"):
        path = next(path.glob(f"*.{kind.partition(' ')[0]}"))
    assert detect_format(path) == "ros"
    check_scene(imported(path))
    assert not [p for p in path.parent.iterdir() if p.name.startswith(".")], "a workspace is left"


def test_the_command_imports_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recording(tmp_path / "rec")
    words = ["import", str(tmp_path / "rec"), "--out", str(tmp_path / "scene")]
    assert main(words) == 0
    assert "4" in capsys.readouterr().out
    check_scene(Scene.open(tmp_path / "scene"))


def test_compressed_images(tmp_path: Path) -> None:
    """JPEG stays as it is; compressed depth loses nothing, or what its quantisation loses."""
    _, jpeg = cv2.imencode(".jpg", color_image(0)[..., ::-1])
    with RosWriter(tmp_path / "rec") as out:
        out.info(INFO, 100)
        out.compressed(f"{COLOR}/compressed", 100, "rgb8; jpeg compressed bgr8", bytes(jpeg))
        data = compressed_depth(depth_mm(0))
        out.compressed(f"{DEPTH}/compressedDepth", 100, "16UC1; compressedDepth png", data)
    scene = imported(tmp_path / "rec")
    frame = scene.frames[0]
    assert scene.color_path(frame).read_bytes() == bytes(jpeg)
    assert np.array_equal(scene.read_depth(frame), depth_mm(0) * np.float32(0.001))


def test_depth_in_metres(tmp_path: Path) -> None:
    """As float, and quantised by inverse depth; NaN is a hole."""
    metres = depth_mm(0) * np.float32(0.001)
    for name, quantised in (("plain", False), ("quantised", True)):
        with RosWriter(tmp_path / name / "rec") as out:
            out.info(INFO, 100)
            out.image(COLOR, 100, color_image(0)[..., ::-1], "bgr8")
            if quantised:
                data = compressed_depth(metres, quantised=True)
                out.compressed(f"{DEPTH}/compressedDepth", 100, "32FC1; compressedDepth png", data)
            else:
                values = np.where(metres > 0, metres, np.float32(np.nan))
                out.image(DEPTH, 100, values, "32FC1", big_endian=True)
        scene = imported(tmp_path / name / "rec")
        read = scene.read_depth(scene.frames[0])
        assert np.array_equal(read > 0, metres > 0)
        assert np.abs(read - metres).max() < (2e-4 if quantised else 1e-7)
        assert np.array_equal(scene.read_color(scene.frames[0]), color_image(0))


def test_yuv_and_bayer_have_the_right_channels(tmp_path: Path) -> None:
    flat = np.full((SIZE[1], SIZE[0], 3), (200, 40, 90), np.uint8)
    # BT.601: luma from 16 to 235.
    weights = [[65.481, 128.553, 24.966], [-37.797, -74.203, 112], [112, -93.786, -18.214]]
    yuv = np.rint(flat / 255 @ np.array(weights).T + (16, 128, 128)).astype(np.uint8)
    yuyv = np.stack([yuv[..., 0], np.where(np.arange(SIZE[0]) % 2, yuv[..., 2], yuv[..., 1])], -1)
    bayer = flat[..., 1].copy()
    bayer[::2, ::2], bayer[1::2, 1::2] = flat[::2, ::2, 0], flat[1::2, 1::2, 2]
    for name, pixels, encoding in (
        ("yuyv", yuyv, "yuv422_yuy2"),
        ("uyvy", yuyv[..., ::-1], "yuv422"),
        ("bayer", bayer, "bayer_rggb8"),
    ):
        with RosWriter(tmp_path / name / "rec") as out:
            out.info(INFO, 100)
            out.image(COLOR, 100, np.ascontiguousarray(pixels.astype(np.uint8)), encoding)
            out.image(DEPTH, 100, depth_mm(0), "16UC1")
        scene = imported(tmp_path / name / "rec")
        middle = scene.read_color(scene.frames[0])[32, 48].astype(int)
        assert np.abs(middle - (200, 40, 90)).max() <= 4, encoding


def test_images_without_a_partner_are_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with RosWriter(tmp_path / "rec") as out:
        out.info(INFO, 100)
        for i in range(6):
            out.image(COLOR, 100 + i / 10, color_image(i), "rgb8")
            if i != 2:
                out.image(DEPTH, 100.03 + i / 10, depth_mm(i), "16UC1")
    scene = imported(tmp_path / "rec")
    assert [f.timestamp for f in scene.frames] == pytest.approx([100, 100.1, 100.3, 100.4, 100.5])
    assert np.array_equal(scene.read_depth(scene.frames[2]), depth_mm(3) * np.float32(0.001))
    assert "1 images without a partner" in caplog.text


def test_pairs_use_each_image_once() -> None:
    assert pair_stamps([0, 1, 2, 3], [0.1, 2.1]) == [(0, 0), (2, 1)]
    assert pair_stamps([0.0], [5.0]) == [(0, 0)]
    assert pair_stamps([0, 1, 2], [10, 11, 12]) == []


def test_a_choice_of_topics(tmp_path: Path) -> None:
    with RosWriter(tmp_path / "rec") as out:
        for camera in ("/left", "/right"):
            out.info(f"{camera}/camera_info", 100)
            shift = 7 * (camera == "/right")
            out.image(f"{camera}/image_raw", 100, color_image(shift), "rgb8")
            out.image(f"{camera}/depth", 100, depth_mm(shift), "16UC1")
    with pytest.raises(ToolkitError, match="--color TOPIC"):
        imported(tmp_path / "rec")
    scene = imported(tmp_path / "rec", color="/right/image_raw", depth="/right/depth")
    assert np.array_equal(scene.read_color(scene.frames[0]), color_image(7))
    shutil.rmtree(tmp_path / "scene")
    with pytest.raises(ToolkitError, match=r"no such topic .* /left/depth"):
        imported(tmp_path / "rec", color="/right/image_raw", depth="/middle")


def test_a_lens_is_kept_and_rectified_images_have_none(tmp_path: Path) -> None:
    for name, topic in (("raw", COLOR), ("rect", "/camera/color/image_rect_color")):
        with RosWriter(tmp_path / name / "rec") as out:
            out.info(INFO, 100, d=(0.1, -0.05, 0.001, 0.002, 0))
            out.image(topic, 100, color_image(0), "rgb8")
            out.image(DEPTH, 100, depth_mm(0), "16UC1")
        scene = imported(tmp_path / name / "rec")
        camera = scene.camera(scene.frames[0])
        assert bool(camera.distortion) == (name == "raw")
        assert camera.fx == (K[0] if name == "raw" else K[0] + 2)


@pytest.mark.parametrize(
    ("k", "full", "region", "binning", "wanted"),
    [
        ((160, 162, 95, 63.5), (192, 128), (0, 0, 0, 0), (2, 2), (80, 81, 47.25, 31.5)),
        ((80, 81, 57, 52.5), (300, 200), (10, 20, 96, 64), (1, 0), K),
        ((80, 81, 37, 41), (300, 200), (10, 20, 96, 64), (0, 0), (80, 81, 27, 21)),
        ((160, 81, 104, 52), (300, 300), (10, 20, 193, 64), (2, 1), (80, 81, 46.75, 32)),
        (K, SIZE, (10, 20, 50, 40), (2, 2), K),  # stated, but the images are whole
    ],
)
def test_a_region_and_binning_of_the_camera(
    k: Any, full: Any, region: Any, binning: Any, wanted: Any, tmp_path: Path, caplog: Any
) -> None:
    with RosWriter(tmp_path / "rec") as out:
        out.info(INFO, 100, k=k, size=full, region=region, binning=binning)
        out.image(COLOR, 100, color_image(0), "rgb8")
    with caplog.at_level("INFO", "std_toolkit"):
        scene = imported(tmp_path / "rec")
    camera = scene.camera(scene.frames[0])
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx(wanted)
    assert f"binning {max(1, binning[0])}x" in caplog.text
    assert ("not applied" in caplog.text) == (full == SIZE)


def test_a_region_that_leaves_another_image_is_refused(tmp_path: Path) -> None:
    for region, words in (
        ((0, 0, 40, 30), "40x30"),
        ((290, 0, 40, 30), r"camera_info.roi: the region"),
    ):
        folder = tmp_path / str(region[0]) / "rec"
        with RosWriter(folder) as out:
            out.info(INFO, 100, size=(300, 200), region=region)
            out.image(COLOR, 100, color_image(0), "rgb8")
        with pytest.raises(ToolkitError, match=words):
            imported(folder)


def test_a_fisheye_is_undistorted(tmp_path: Path) -> None:
    with RosWriter(tmp_path / "rec") as out:
        out.info(INFO, 100, d=(0.1, -0.05, 0.001, 0.002), model="equidistant")
        out.image(COLOR, 100, color_image(0), "rgb8")
        out.image(DEPTH, 100, depth_mm(0), "16UC1")
    scene = imported(tmp_path / "rec")
    camera = scene.camera(scene.frames[0])
    recorded = scene.info.recorded_lenses["color"]
    assert (recorded.model, recorded.distortion) == ("fisheye", [0.1, -0.05, 0.001, 0.002])
    assert (camera.fx, camera.distortion) == (K[0], ())
    lens = Camera(*SIZE, *K, (0.1, -0.05, 0.001, 0.002), "fisheye")
    expected = undistort_image(depth_mm(0), lens, interpolation=cv2.INTER_NEAREST)
    assert np.allclose(scene.read_depth(scene.frames[0]), expected / 1000)


@pytest.mark.parametrize("fault", ["unaligned", "no info", "fisheye", "no images", "short", "mono"])
def test_what_cannot_be_used_is_named(fault: str, tmp_path: Path) -> None:
    with RosWriter(tmp_path / "rec") as out:
        if fault != "no info":
            model = "thin_prism_fisheye" if fault == "fisheye" else "plumb_bob"
            out.info(INFO, 100, d=(0.1, 0, 0, 0), model=model)
        if fault != "no images":
            encoding = "mono8" if fault == "mono" else "rgb8"
            pixels = color_image(0)[..., 0] if fault == "mono" else color_image(0)
            out.image(COLOR, 100, pixels, encoding)
            frame = "depth_optical" if fault == "unaligned" else "color_optical"
            depth = depth_mm(0)[:, :40] if fault == "short" else depth_mm(0)
            out.image("/camera/depth/image", 100, depth, "16UC1", frame=frame)
    words = {
        "unaligned": "align_depth",
        "no info": "camera_info of the colour camera.*--intrinsics",
        "fisheye": "distortion_model.*image_rect_color",
        "no images": "no images.*camera_info",
        "short": "another size",
        "mono": "no topic with color images",
    }
    with pytest.raises(ToolkitError, match=words[fault]):
        imported(tmp_path / "rec")
    assert not (tmp_path / "scene").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["rec"]


@pytest.mark.parametrize("kind", ["mcap", "db3"])
def test_a_damaged_recording_is_refused(kind: str, tmp_path: Path) -> None:
    write_recording(tmp_path / "rec", storage="mcap" if kind == "mcap" else "sqlite3")
    whole = next((tmp_path / "rec").glob(f"*.{kind}"))
    data = whole.read_bytes()
    cut = tmp_path / f"cut.{kind}"
    for size in (0, 7, len(data) // 3, len(data) - 9):
        cut.write_bytes(data[:size])
        with pytest.raises(ToolkitError):
            import_recording(
                ImportRequest(source=cut, name="x"), tmp_path / "out", format_name="ros"
            )
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_pipe_in_a_recording_is_not_waited_for(storage: str, tmp_path: Path) -> None:
    write_recording(tmp_path / "rec", storage=storage)
    file = next(p for p in (tmp_path / "rec").iterdir() if p.suffix in (".mcap", ".db3"))
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(ToolkitError, match="pipe or device") as refused:
        imported(tmp_path / "rec")
    assert str(refused.value.path) == str(file)


def test_a_message_larger_than_an_image_is_not_read(tmp_path: Path) -> None:
    write_recording(tmp_path / "rec", storage="sqlite3")
    file = next((tmp_path / "rec").glob("*.db3"))
    size = LARGEST_MESSAGE_BYTES + 2**20
    with closing(sqlite3.connect(file)) as database:
        (topic,) = database.execute("SELECT id FROM topics WHERE name = ?", (COLOR,)).fetchone()
        database.execute(
            "UPDATE messages SET data = zeroblob(?) WHERE rowid = "
            "(SELECT max(rowid) FROM messages WHERE topic_id = ?)", (size, topic)
        )  # fmt: skip
        database.commit()
    with pytest.raises(ToolkitError, match=r"a message of 129 MB at .* at most 128 MB") as refused:
        imported(tmp_path / "rec")
    assert (refused.value.path, refused.value.field) == (str(file), COLOR)


def test_a_large_message_of_mcap_is_refused(tmp_path: Path, monkeypatch) -> None:
    write_recording(tmp_path / "rec", storage="mcap")
    monkeypatch.setattr(ros_importer, "LARGEST_MESSAGE_BYTES", 10_000)
    with pytest.raises(ToolkitError, match=r"color/image_raw: a message of 0 MB"):
        imported(tmp_path / "rec")


def test_a_view_without_end_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "rec.db3"
    with closing(sqlite3.connect(path)) as database:
        database.execute(
            "CREATE VIEW topics AS WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) "
            "SELECT x AS id, 'a' AS name, 'b' AS type FROM n"
        )
    assert is_ros_recording(path)
    with pytest.raises(ToolkitError, match="has a view") as refused:
        imported(path)
    assert refused.value.value == "topics"


def test_other_folders_are_no_recordings_of_ros(tmp_path: Path) -> None:
    assert not is_ros_recording(tmp_path)
    (tmp_path / "metadata.yaml").write_text("a: 1\n")
    assert not is_ros_recording(tmp_path)
    write_png(tmp_path / "color.png", np.zeros((4, 4), np.uint8))
    assert not is_ros_recording(tmp_path / "color.png")
    assert read_color(tmp_path / "color.png").shape == (4, 4, 3)


@pytest.mark.parametrize("encoding", ["8UC3", "mono8", "rgb16"])
def test_a_colour_topic_that_is_not_taken_is_named_with_its_encoding(
    encoding: str, tmp_path: Path
) -> None:
    pixels = color_image(0)[..., 0] if encoding == "mono8" else color_image(0)
    with RosWriter(tmp_path / "rec") as out:
        out.info(INFO, 100)
        out.image(COLOR, 100, pixels.astype(np.uint16) if encoding == "rgb16" else pixels, encoding)
        out.image(DEPTH, 100, depth_mm(0), "16UC1")
    with pytest.raises(ToolkitError, match=rf"{COLOR} \({encoding}\)"):
        imported(tmp_path / "rec")


def test_grey_images_are_colour_on_request(tmp_path: Path) -> None:
    with RosWriter(tmp_path / "rec") as out:
        out.info(INFO, 100)
        out.image(COLOR, 100, color_image(0)[..., 0], "mono8")
        out.image(DEPTH, 100, depth_mm(0), "16UC1")
    scene = imported(tmp_path / "rec", color=COLOR)
    image = scene.read_color(scene.frames[0])
    assert (image == color_image(0)[..., :1]).all()


def test_depth_of_64_bits(tmp_path: Path) -> None:
    with RosWriter(tmp_path / "rec") as out:
        out.info(INFO, 100)
        out.image(COLOR, 100, color_image(0), "rgb8")
        out.image(DEPTH, 100, depth_mm(0).astype(np.float64) / 1000, "64FC1")
    scene = imported(tmp_path / "rec")
    assert np.allclose(scene.read_depth(scene.frames[0]), depth_mm(0) / 1000, atol=1e-6)


def test_a_depth_topic_of_an_unknown_encoding_is_not_dropped(tmp_path: Path) -> None:
    with RosWriter(tmp_path / "rec") as out:
        out.info(INFO, 100)
        out.image(COLOR, 100, color_image(0), "rgb8")
        out.image("/camera/depth/image", 100, depth_mm(0).astype(np.int32), "32SC1")
    with pytest.raises(ToolkitError, match=r"/camera/depth/image \(32SC1\)"):
        imported(tmp_path / "rec")


def test_floating_point_millimetres_name_the_topic_and_can_be_stated(tmp_path: Path) -> None:
    with RosWriter(tmp_path / "rec") as out:
        out.info(INFO, 100)
        out.image(COLOR, 100, color_image(0), "rgb8")
        out.image(DEPTH, 100, depth_mm(0).astype(np.float32), "32FC1")
    with pytest.raises(ToolkitError, match=rf"rec: {DEPTH}: .*--depth-scale 0.001") as error:
        imported(tmp_path / "rec")
    assert ".tmp" not in str(error.value)
    scene = imported(tmp_path / "rec", depth_scale=0.001)
    assert np.allclose(scene.read_depth(scene.frames[0]), depth_mm(0) / 1000, atol=1e-6)
