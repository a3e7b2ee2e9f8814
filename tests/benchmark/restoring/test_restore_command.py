"""`std-restore`: what it reads and writes, trusted pixels, resume after a kill, one-line errors."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from restore_cases import SIZE, K, sensor_depth, write_folder, write_methods

from benchmark.cli.bench import main as bench
from benchmark.cli.restore import main
from std_toolkit.geometry import Camera, undistort_image
from std_toolkit.importers.intrinsics import read_intrinsics
from std_toolkit.io.exr import read_exr
from std_toolkit.io.images import image_size, read_color, read_png
from std_toolkit.scene.scene import Scene
from tests.scene_on_disk import write_scene

REPOSITORY = Path(__file__).resolve().parents[3]


def restore(*words: object) -> int:
    return main([*map(str, words), "--engine", "serial", "--quiet"])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_folder(tmp_path / "rec")


@pytest.fixture
def method(tmp_path: Path) -> str:
    return write_methods(tmp_path) + ":FromBehind"


def test_a_folder_is_restored_at_the_cameras_size(folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert restore(folder, "--out", out, "--intrinsics", K, "--depth-scale", 0.001) == 0
    assert "3 frames; of the pixels" in capsys.readouterr().out
    record = json.loads((out / "restore.json").read_text())
    assert record["setup"]["backend"] == "onnx" and record["setup"]["size"] == [224, 126]
    for index in range(3):
        name = f"{index:04d}.png"
        raw, found = read_png(folder / "depth" / name), read_png(out / "depth" / name)
        changed = read_png(out / "changed" / name)
        assert found.dtype == np.uint16 and image_size(out / "confidence" / name) == SIZE
        # As measured, to the last unit; holes are filled.
        assert np.array_equal(changed > 0, raw != found)
        assert (found > 0).all() and 0.5 < ((raw > 0) & (changed == 0)).mean() < 1
        told = json.loads((out / f"frames/{index:04d}.json").read_text())
        assert told["unit"] == 0.001 and told["empty"] == 0
        assert told["measured"] == pytest.approx((raw > 0).mean(), abs=1e-6)
        assert told["kept"] + told["replaced"] == pytest.approx(told["measured"], abs=2e-6)


def test_what_a_method_trusts_stays_and_the_rest_is_its_own(folder, tmp_path, method):
    out = tmp_path / "out"
    assert restore(folder, "--out", out, "--intrinsics", K, "--method", method) == 0
    raw, found = (read_png(f / "depth/0000.png") for f in (folder, out))
    trusted = read_png(out / "confidence/0000.png") >= 128
    assert trusted[:, :40].all() and not trusted[:, 56:].any()
    assert ((found == raw) | (raw == 0))[:, :40].mean() > 0.97
    assert (found > 0).all()


def test_a_fisheye_is_undistorted_before_it_is_restored(folder, tmp_path, method):
    """Beside restored depth are the colour and the intrinsics that it belongs to."""
    lens = Camera(*SIZE, 96, 96, 47.5, 35.5, (0.1, 0.02, 0.0, 0.0), "fisheye")
    document = {"K": lens.K.tolist(), "model": "fisheye", "D": lens.distortion}
    (folder / "intrinsics.json").write_text(json.dumps(document))
    out = tmp_path / "out"
    assert restore(folder, "--out", out, "--method", method) == 0
    raw = undistort_image(
        read_png(folder / "depth/0000.png"), lens, interpolation=cv2.INTER_NEAREST
    )
    found = read_png(out / "depth/0000.png")
    assert ((found == raw) | (raw == 0))[:, :40].mean() > 0.97
    color = read_color(out / "color/0000.png")
    assert np.array_equal(color, undistort_image(read_color(folder / "color/0000.png"), lens))
    read = read_intrinsics(str(out / "intrinsics.json"), size=SIZE).camera(SIZE, path="k")
    assert read == lens.without_distortion()
    # Another field of view is other work, not a resumed run.
    before = (out / "frames/0000.json").read_text()
    assert restore(folder, "--out", out, "--method", method, "--undistort-fov", 50) == 0
    assert (out / "frames/0000.json").read_text() != before
    assert json.loads((out / "intrinsics.json").read_text())["fx"] > 96


def test_a_scene_keeps_its_correction(tmp_path, method):
    scene = write_scene(tmp_path / "scene", labelled=False)
    info = json.loads((scene.root / "scene.json").read_text()) | {"depth_correction": 1.01}
    (scene.root / "scene.json").write_text(json.dumps(info))
    out = tmp_path / "out"
    assert restore(scene.root, "--out", out, "--method", method) == 0
    frame = Scene.open(scene.root).frames[0]
    record = json.loads((out / f"frames/{frame.name}.json").read_text())
    assert record["unit"] == pytest.approx(0.00101)
    units = read_png(out / f"depth/{frame.name}.png")
    assert np.array_equal(units, read_png(scene.root / str(frame.depth)))


def test_exr_stays_exr_unless_asked(tmp_path, method):
    folder = write_folder(tmp_path / "rec", 1, exr=True)
    given = ("--intrinsics", K, "--method", method)
    assert restore(folder, "--out", tmp_path / "same", *given) == 0
    depth = read_exr(tmp_path / "same/depth/0000.exr")["Y"]
    changed = read_png(tmp_path / "same/changed/0000.png") > 0
    assert depth.dtype == np.float32 and np.array_equal(changed, depth != sensor_depth())
    assert restore(folder, "--out", tmp_path / "png", *given, "--format", "png") == 0
    found = read_png(tmp_path / "png/depth/0000.png") * 0.001
    assert np.abs(found - depth).max() <= 0.0005 + 1e-6


def test_one_pair_with_points_and_picture(folder, tmp_path, method):
    out = tmp_path / "out"
    pair = ("--color", folder / "color/0001.png", "--depth", folder / "depth/0001.png")
    given = ("--out", out, "--intrinsics", K, "--method", method)
    assert restore(*pair, *given, "--points", "--pictures") == 0
    depth = read_png(out / "depth/0001.png") * np.float32(0.001)
    cloud = trimesh.load(out / "points/0001.ply")
    assert len(cloud.vertices) == (depth > 0).sum()
    assert np.abs(np.sort(cloud.vertices[:, 2]) - np.sort(depth[depth > 0])).max() < 1e-6
    assert read_color(out / "pictures/0001.jpg").shape[1] == 4 * SIZE[0] + 3 * 4


def test_several_recordings_have_a_folder_each(tmp_path, method):
    for name in ("a", "b"):
        write_folder(tmp_path / name, 1)
    given = ("--out", tmp_path / "out", "--intrinsics", K, "--method", method)
    assert restore(tmp_path / "a", tmp_path / "b", *given) == 0
    assert all((tmp_path / f"out/{name}/depth/0000.png").is_file() for name in ("a", "b"))


def test_what_is_done_is_kept_and_a_changed_image_done_again(folder, tmp_path, method, capsys):
    out = tmp_path / "out"
    given = (folder, "--out", out, "--intrinsics", K, "--method", method)
    assert restore(*given) == 0
    times = {p: p.stat().st_mtime_ns for p in sorted((out / "depth").iterdir())}
    (folder / "depth/0001.png").write_bytes((folder / "depth/0002.png").read_bytes())
    assert restore(*given) == 0
    new = [p.name for p, then in times.items() if p.stat().st_mtime_ns != then]
    assert new == ["0001.png"]
    capsys.readouterr()
    assert restore(*given, "--set", "pause=0.001") == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and "setup.settings" in told and "another --out" in told


def test_a_damaged_frame_does_not_stop_the_others(folder, tmp_path, method, capsys):
    (folder / "depth/0001.png").write_bytes((folder / "depth/0001.png").read_bytes()[:-40])
    out = tmp_path / "out"
    assert restore(folder, "--out", out, "--intrinsics", K, "--method", method) == 1
    told = capsys.readouterr()
    assert "2 frames" in told.out and "rec/0001" in told.err
    assert len(list((out / "depth").iterdir())) == 2


@pytest.mark.slow
def test_killed_and_run_again(folder, tmp_path):
    """The method is found by its file, in worker processes too, without PYTHONPATH to it."""
    write_methods(tmp_path)
    code = "import sys; sys.path.pop(0); from benchmark.cli.restore import main; sys.exit(main())"
    words = [
        *(sys.executable, "-c", code, str(folder), "--out", "out", "--intrinsics", K),
        *("--method", "my_methods.py:FromBehind", "--workers", "2", "--quiet", "--set"),
    ]
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    write_folder(folder, 12)
    running = subprocess.Popen(
        [*words, "pause=0.3"], cwd=tmp_path, env=environment, start_new_session=True
    )
    records = tmp_path / "out/frames"
    end = time.monotonic() + 60
    while not list(records.glob("[0-9]*.json")) and time.monotonic() < end:
        time.sleep(0.02)
    running.send_signal(signal.SIGKILL)
    running.wait()
    done = {p: p.stat().st_mtime_ns for p in records.glob("[0-9]*.json")}
    assert 0 < len(done) < 12
    again = subprocess.run(
        [*words, "pause=0.3"], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert again.returncode == 0, again.stderr
    assert "12 frames" in again.stdout
    # A worker may have ended the frame that it was at after the kill; none is done twice.
    assert all(p.stat().st_mtime_ns == then for p, then in done.items())
    assert len(list((tmp_path / "out/depth").glob("*.png"))) == 12
    assert not list((tmp_path / "out").rglob(".*.tmp*"))


@pytest.mark.long
def test_on_ray(folder, tmp_path, method):
    pytest.importorskip("ray")
    out = tmp_path / "out"
    words = [str(folder), "--out", str(out), "--intrinsics", K, "--method", method]
    assert main([*words, "--engine", "ray", "--workers", "2"]) == 0
    assert len(list((out / "depth").iterdir())) == 3


@pytest.mark.slow
def test_a_file_of_librealsense(tmp_path):
    pytest.importorskip("pyrealsense2")
    bag, out = REPOSITORY / "tests/data/software_device.bag", tmp_path / "out"
    assert restore(bag, "--out", out, "--method", "nearest") == 0
    scene = Scene.open(out / "recordings/software_device")
    frames = [f.name for f in scene.frames if f.depth is not None]
    assert frames and [p.stem for p in sorted((out / "depth").iterdir())] == sorted(frames)


CASES = {
    "nothing": (["--out", "OUT"], "SOURCES: needed"),
    "both": (["REC", "--color", "REC/color", "--depth", "REC/depth", "--out", "OUT"], "not both"),
    "no folder": (["REC/nothing", "--out", "OUT"], "no such file or folder"),
    "a video": (["FILE", "--out", "OUT"], "not a recording that std-restore reads"),
    "empty": (["EMPTY", "--out", "OUT"], "neither a scene.json nor the folders color/ and depth/"),
    "above": (["ABOVE", "--out", "OUT"], "holds recordings and is none itself"),
    "no intrinsics": (["REC", "--out", "OUT"], "need intrinsics"),
    "other intrinsics": (["REC", "--out", "OUT", "--intrinsics", "9,9,640,360"], "another image"),
    "unit": (["REC", "--out", "OUT", "--intrinsics", K, "--depth-scale", "1"], "0.001"),
    "method": (["REC", "--out", "OUT", "--intrinsics", K, "--method", "swin"], "known: raw"),
    "mask": (["REC", "--out", "OUT", "--intrinsics", K, "--method", "MY:Masked"], "needs a mask"),
    "answer": (["REC", "--out", "OUT", "--intrinsics", K, "--method", "MY:Odd"], "a view of"),
    "weights": (
        ["REC", "--out", "OUT", "--intrinsics", K, "--weights", "REC/x.onnx"],
        "no such file of weights",
    ),
    "no graph": (
        ["REC", "--out", "OUT", "--intrinsics", K, "--size", "320x240", "--backend", "onnx"],
        "swindrnet has them at 224x126",
    ),
    "setting": (
        ["REC", "--out", "OUT", "--intrinsics", K, "--method", "nearest", "--set", "a"],
        "expected NAME=VALUE",
    ),
    "foreign folder": (["REC", "--out", "REC", "--intrinsics", K], "another --out"),
}


@pytest.mark.parametrize("case", CASES)
def test_wrong_input_is_one_line(case, tmp_path, capsys):
    write_folder(tmp_path / "rec", 1)
    write_folder(tmp_path / "above/rec", 1)
    (tmp_path / "empty").mkdir()
    (tmp_path / "video.mp4").touch()
    places = {
        **{"REC": tmp_path / "rec", "OUT": tmp_path / "out", "EMPTY": tmp_path / "empty"},
        **{"ABOVE": tmp_path / "above", "FILE": tmp_path / "video.mp4"},
        **{"MY": write_methods(tmp_path)},
    }
    words, told = CASES[case]
    words = [
        word.replace(key, str(path), 1) if word.startswith(key) else word
        for word in words
        for key, path in [next(((k, p) for k, p in places.items() if word.startswith(k)), ("", ""))]
    ]
    assert restore(*words) != 0
    errors = capsys.readouterr().err.splitlines()
    assert told in errors[-1] and "Traceback" not in "".join(errors)
    assert len([line for line in errors if line.startswith("error:")]) == 1


def test_std_bench_sends_data_without_ground_truth_here(tmp_path, capsys):
    scene = write_scene(tmp_path / "scene", labelled=False).root
    for task in (("depth", "--method", "nearest"), ("pose", "--method", "gt-nocs")):
        given = ("--split", "scenes", "--data", str(scene), "--out", str(tmp_path / "out"))
        assert bench([*task, *given]) == 1
        told = capsys.readouterr().err
        assert told.count("\n") == 1 and "std-restore" in told and str(scene) in told
    assert not (tmp_path / "out").exists()


def restored(folder, out, method="nearest", *more):
    assert restore(folder, "--out", out, "--intrinsics", K, "--method", method, *more) == 0
    return {path.name: path.read_bytes() for path in sorted((out / "depth").iterdir())}


def test_a_restored_image_that_was_cut_is_made_anew(folder, tmp_path):
    out = tmp_path / "out"
    whole = restored(folder, out)
    name = next(iter(whole))
    (out / "depth" / name).write_bytes(whole[name][:100])
    assert restored(folder, out) == whole


def test_another_unit_or_camera_makes_the_images_again(folder, tmp_path):
    out = tmp_path / "out"
    restored(folder, out)
    restored(folder, out, "nearest", "--depth-scale", 0.0005)
    assert json.loads((out / "frames/0000.json").read_text())["unit"] == 0.0005


def test_depth_is_not_written_through_a_link(folder, tmp_path, capsys):
    out, outside = tmp_path / "out", tmp_path / "outside"
    outside.mkdir()
    restored(folder, out)
    shutil.rmtree(out / "depth")
    shutil.rmtree(out / "frames")
    (out / "depth").symlink_to(outside)
    assert restore(folder, "--out", out, "--intrinsics", K, "--method", "nearest") == 1
    assert "symbolic link out" in capsys.readouterr().err
    assert not list(outside.iterdir())


ODD = """
import numpy as np
from benchmark.methods.protocol import Restored
class Base:
    input_size, needs_mask = None, False
    def __init__(self, options): pass
    def restore(self, views): return [self.answer(np.ones_like(v.depth)) for v in views]
class Negative(Base):
    def answer(self, one): return Restored(-one, None)
class Nan(Base):
    def answer(self, one): return Restored(one, np.nan * one)
class Percent(Base):
    def answer(self, one): return Restored(one, 90 * one)
class Shape(Base):
    def answer(self, one): return Restored(one, one[:3])
class Lists(Base):
    def answer(self, one): return Restored(one.tolist(), None)
class Fails(Base):
    def answer(self, one): raise RuntimeError("my own bug")
"""


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("Negative", "there are negative ones and none above 0"),
        ("Nan", "Restored.confidence: must be in [0, 1] (got 'nan to nan')"),
        ("Percent", "must be in [0, 1] (got '90 to 90')"),
        ("Shape", "Restored.confidence: the method was given a view"),
        ("Lists", "odd.py: AttributeError: 'list' object has no attribute"),
        ("Fails", "odd.py: line 19, answer: RuntimeError: my own bug; an error of the plug-in"),
    ],
)
def test_an_odd_answer_is_refused(folder, tmp_path, capsys, kind, words):
    (tmp_path / "odd.py").write_text(ODD)
    method = f"{tmp_path / 'odd.py'}:{kind}"
    assert restore(folder, "--out", tmp_path / "o", "--intrinsics", K, "--method", method) == 1
    told = capsys.readouterr().err
    assert words in told
    assert "defect" not in told


@pytest.mark.parametrize(
    ("option", "value"), [("--depth-scale", 0), ("--depth-scale", "nan"), ("--depth-correction", 0)]
)
def test_a_scale_that_is_none_is_refused(folder, tmp_path, capsys, option, value):
    words = (folder, "--out", tmp_path / "o", "--intrinsics", K, "--method", "nearest")
    assert restore(*words, option, value) == 2
    assert f"error: {option}: must be" in capsys.readouterr().err


def test_a_network_without_end_is_given_up(folder, tmp_path, capsys):
    onnx = pytest.importorskip("onnx")
    make, T = onnx.helper, onnx.TensorProto
    w, h = SIZE
    info = make.make_tensor_value_info
    images = [info("color", T.FLOAT, [1, 3, h, w]), info("depth", T.FLOAT, [1, 1, h, w])]
    body = make.make_graph(
        [make.make_node("Identity", ["c"], ["d"]), make.make_node("Identity", ["x"], ["y"])],
        "body",
        [info("i", T.INT64, []), info("c", T.BOOL, []), info("x", T.FLOAT, [1, 1, h, w])],
        [info("d", T.BOOL, []), info("y", T.FLOAT, [1, 1, h, w])],
    )
    graph = make.make_graph(
        [make.make_node("Loop", ["n", "t", "depth"], ["restored"], body=body)],
        "graph",
        images,
        [info("restored", T.FLOAT, [1, 1, h, w])],
        [make.make_tensor("n", T.INT64, [], [2**62]), make.make_tensor("t", T.BOOL, [], [True])],
    )
    model = make.make_model(graph, opset_imports=[make.make_opsetid("", 17)], ir_version=8)
    onnx.save(model, tmp_path / "loop.onnx")
    words = (
        folder,
        "--out",
        tmp_path / "o",
        "--intrinsics",
        K,
        "--weights",
        tmp_path / "loop.onnx",
    )
    assert restore(*words, "--method", "onnx", "--set", "timeout_s=0.5") == 1
    assert "took longer than 0.5 s for a frame" in capsys.readouterr().err
