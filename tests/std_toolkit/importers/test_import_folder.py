"""`std-curate import --color`: what is read, what is refused, and that nothing is left behind."""

from __future__ import annotations

import json
import os
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from std_toolkit.checks.summary import summarise
from std_toolkit.errors import ToolkitError
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.options import ImportRequest
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.poses.camera_file import read_cameras
from std_toolkit.poses.frame_matching import match_frames
from std_toolkit.scene import Scene

SIZE = (64, 48)
K = "70,71,31.5,23.5"


@pytest.fixture
def recording(tmp_path) -> Path:
    """Ten frames named 1 to 10, unsorted on disk, with depth in millimetres."""
    folder = tmp_path / "rec"
    rng = np.random.default_rng(0)
    for i in (10, 2, 1, 9, 3, 4, 5, 6, 8, 7):
        image = rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)
        write_color(folder / f"color/{i}.png", image)
        depth = np.full((48, 64), 0.5 + i / 100, np.float32)
        depth[:5] = 0
        write_depth_png16(folder / f"depth/{i}.png", depth, scale=0.001)
    return folder


def request(folder: Path, **changes) -> ImportRequest:
    arguments = {
        "source": folder,
        "name": "demo",
        "color": str(folder / "color"),
        "depth": str(folder / "depth"),
        "intrinsics": K,
    }
    return ImportRequest(**{**arguments, **changes})


def refused(out: Path, match: str, asked: ImportRequest, **options) -> None:
    """The import fails with one line, and leaves neither a scene nor a temporary."""
    before = sorted(p for p in out.parent.rglob("*"))
    with pytest.raises(ToolkitError, match=match) as error:
        import_recording(asked, out, **options)
    assert "\n" not in str(error.value)
    assert sorted(p for p in out.parent.rglob("*")) == before


def test_frames_come_in_natural_order(recording, tmp_path):
    scene = import_recording(request(recording), tmp_path / "scene")
    assert [f.name for f in scene.frames] == [str(i) for i in range(1, 11)]
    assert [f.id for f in scene.frames] == list(range(10))
    assert scene.info.name == "demo"
    assert scene.info.depth_scale == 0.001
    for frame in scene.frames:
        source = recording / f"color/{frame.name}.png"
        assert scene.color_path(frame).read_bytes() == source.read_bytes()
        depth = scene.read_depth(frame)
        assert depth[10, 10] == pytest.approx(0.5 + int(frame.name) / 100)
        assert depth[0, 0] == 0
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]
    summary = summarise(scene)
    assert summary.frames_with_depth == 10
    assert summary.next_command == f"std-curate poses {tmp_path / 'scene'}"


@pytest.mark.parametrize("stem", ["a[{}]", "a {}", "图{}", "-a{}", "\u200e{}", "a\n{}"])
def test_images_of_any_name(recording, tmp_path, stem):
    """Their poses and intrinsics have their names."""
    for path in sorted(recording.glob("*/*.png")):
        path.rename(path.with_name(f"{stem.format(path.stem)}.png"))
    stems = [p.stem for p in sorted((recording / "color").iterdir())]
    poses = {f"{s}.png": [*np.eye(4).tolist()[:3], [0, 0, 0, 1]] for s in stems}
    for i, pose in enumerate(poses.values()):
        pose[0][3] = 0.1 * i
    (tmp_path / "poses.json").write_text(json.dumps(poses))
    asked = request(recording)
    scene = import_recording(asked, tmp_path / "scene")
    filed = read_cameras(tmp_path / "poses.json")
    assert len(match_frames(filed, scene.frames)) == len(stems) == len(scene.frames) > 1
    for stem in stems:
        (tmp_path / "lens").mkdir(exist_ok=True)
        text = json.dumps({"fx": 60 + stems.index(stem), "fy": 60, "cx": 31.5, "cy": 23.5})
        (tmp_path / "lens" / f"{stem}.json").write_text(text)
    each = import_recording(replace(asked, intrinsics=str(tmp_path / "lens")), tmp_path / "each")
    assert len(each.info.cameras) == len(stems)


def test_colour_alone(recording, tmp_path):
    scene = import_recording(request(recording, depth=None), tmp_path / "scene")
    assert all(f.depth is None for f in scene.frames)
    assert scene.info.depth_scale is None


@pytest.mark.parametrize("link", ["hard", "sym"])
def test_images_can_be_linked(recording, tmp_path, link):
    scene = import_recording(request(recording), tmp_path / "scene", link=link)
    path = scene.color_path(scene.frames[0])
    source = recording / "color/1.png"
    assert path.samefile(source)
    assert path.is_symlink() == (link == "sym")


def test_two_workers_write_the_same_scene(recording, tmp_path):
    from std_toolkit.jobs import JobOptions

    import_recording(request(recording), tmp_path / "a")
    import_recording(
        request(recording), tmp_path / "b", options=JobOptions(workers=2, progress=False)
    )
    files = [
        {p.relative_to(tmp_path / x): p.read_bytes() for p in (tmp_path / x).rglob("*.*")}
        for x in "ab"
    ]
    assert files[0] == files[1]


def test_foreign_marks_of_missing_depth_become_zero(recording, tmp_path):
    for i in range(1, 11):
        values = np.full((48, 64), 0.7, np.float32)
        values[0, :4] = [np.nan, np.inf, -0.001, -np.inf]
        write_exr(tmp_path / f"exr/{i}.exr", {"R": values, "G": values, "B": values})
    scene = import_recording(request(recording, depth=str(tmp_path / "exr")), tmp_path / "scene")
    depth = scene.read_depth(scene.frames[0])
    assert (depth[0, :4] == 0).all()
    assert depth[1, 1] == np.float32(0.7)
    assert scene.info.depth_scale is None


def test_saturated_depth_becomes_zero(recording, tmp_path):
    for i in range(1, 11):
        raw = np.full((48, 64), 700, np.uint16)
        raw[3] = 65535
        (tmp_path / "d").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / f"d/{i}.png"), raw)
    scene = import_recording(request(recording, depth=str(tmp_path / "d")), tmp_path / "scene")
    depth = scene.read_depth(scene.frames[0])
    assert (depth[3] == 0).all()
    assert depth[4, 4] == pytest.approx(0.7)


@pytest.mark.parametrize(("scale", "median"), [(0.0001, 0.0555), (0.02, 11.1)])
def test_a_unit_that_the_user_states_is_not_questioned(recording, tmp_path, scale, median, caplog):
    with caplog.at_level("INFO", "std_toolkit"):
        scene = import_recording(request(recording, depth_scale=scale), tmp_path / "scene")
    depth = scene.read_depth(scene.frames[5])
    assert np.median(depth[depth > 0]) == pytest.approx(median, rel=0.05)
    assert "stated by --depth-scale" in caplog.text


def test_nothing_is_measured_beyond_65_m(recording, tmp_path):
    words = r"--depth-scale: no depth image has a measurement nearer than 65 m"
    refused(tmp_path / "scene", words, request(recording, depth_scale=1.0))


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), 1000.0])
def test_impossible_depth_scales_are_refused(recording, tmp_path, scale):
    refused(tmp_path / "scene", "metres per unit", request(recording, depth_scale=scale))


def test_exr_depth_in_millimetres_is_refused(recording, tmp_path):
    for i in range(1, 11):
        write_exr(tmp_path / f"exr/{i}.exr", {"Y": np.full((48, 64), 700, np.float32)})
    refused(
        tmp_path / "scene",
        "not to be in metres; --depth-scale 0.001",
        request(recording, depth=f"{tmp_path}/exr"),
    )


def test_unaligned_depth_is_refused(recording, tmp_path):
    write_depth_png16(recording / "depth/4.png", np.full((24, 32), 0.7), scale=0.001)
    refused(tmp_path / "scene", "not aligned.*rs.align", request(recording))


def test_missing_frames_are_named(recording, tmp_path):
    (recording / "depth/7.png").unlink()
    (recording / "color/3.png").unlink()
    refused(tmp_path / "scene", "1 without depth: 7; 1 without colour: 3", request(recording))
    scene = import_recording(request(recording, skip_unpaired=True), tmp_path / "scene")
    assert [f.name for f in scene.frames] == ["1", "2", "4", "5", "6", "8", "9", "10"]


def test_intrinsics_of_another_size_are_refused(recording, tmp_path):
    refused(
        tmp_path / "a", "another image size", request(recording, intrinsics="140,142,63.5,47.5")
    )
    refused(tmp_path / "a", "another image size", request(recording, intrinsics="35,35,15.5,11.5"))
    refused(tmp_path / "a", "need intrinsics", request(recording, intrinsics=None))


def test_images_of_two_sizes_are_refused(recording, tmp_path):
    write_color(recording / "color/5.png", np.zeros((24, 32, 3), np.uint8))
    refused(tmp_path / "scene", "differ in size", request(recording))


def test_importing_twice_is_refused(recording, tmp_path):
    import_recording(request(recording), tmp_path / "scene")
    refused(tmp_path / "scene", "a scene already exists here", request(recording))
    (tmp_path / "other").mkdir()
    (tmp_path / "other/file").write_text("x")
    refused(tmp_path / "other", "not empty", request(recording))
    refused(tmp_path / "other/file", "a file already exists here", request(recording))


def test_parents_made_for_a_failed_import_go_as_well(recording, tmp_path):
    (recording / "depth/7.png").write_bytes(b"")
    refused(tmp_path / "new/deep/scene", "7.png", request(recording))
    assert not (tmp_path / "new").exists()


def bomb(path: Path) -> None:
    """A PNG of a few bytes that claims 60000 x 60000 pixels."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")
    )


def half(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])


DAMAGE = {
    "empty": lambda p: p.write_bytes(b""),
    "text": lambda p: p.write_text("not an image"),
    "truncated": half,
    "bomb": bomb,
    "exr by name": lambda p: p.write_bytes(b"v/1\x01" + b"\0" * 40),
    "folder": lambda p: (p.unlink(), p.mkdir()),
    "dangling link": lambda p: (p.unlink(), p.symlink_to("/nonexistent.png")),
}


@pytest.mark.parametrize("kind", ["color", "depth"])
@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_images_are_refused_and_named(recording, tmp_path, kind, damage):
    DAMAGE[damage](recording / f"{kind}/6.png")
    refused(tmp_path / "scene", "6", request(recording))


def test_wrong_kinds_of_depth_are_refused(recording, tmp_path):
    path = recording / "depth/6.png"
    cv2.imwrite(str(path), np.full((48, 64), 7, np.uint8))
    refused(tmp_path / "scene", "16-bit PNG.*8-bit depth image", request(recording))
    cv2.imwrite(str(path), np.full((48, 64, 3), 700, np.uint16))
    refused(tmp_path / "scene", "3 channels", request(recording))
    for i in range(1, 11):
        cv2.imwrite(str(recording / f"depth/{i}.png"), np.zeros((48, 64), np.uint16))
    refused(tmp_path / "scene", "not a single|no depth image has", request(recording))


def test_names_from_elsewhere_cannot_leave_the_scene(recording, tmp_path):
    (recording / "color/1.png").rename(recording / "color/..%2f..$(x) 1.png")
    (recording / "depth/1.png").rename(recording / "depth/..%2f..$(x) 1.png")
    scene = import_recording(request(recording), tmp_path / "scene")
    inside = {p.resolve() for p in (tmp_path / "scene").rglob("*") if p.is_file()}
    assert all(p.is_relative_to(tmp_path / "scene") for p in inside)
    assert Scene.open(scene.root).frames


def test_what_a_killed_import_left_is_removed_by_the_next(recording, tmp_path):
    left = tmp_path / ".scene.0123456789ab.tmp"
    (left / "color").mkdir(parents=True)
    import_recording(request(recording), tmp_path / "scene")
    assert not left.exists()


def test_a_read_only_place_is_one_line(recording, tmp_path):
    if os.geteuid() == 0:
        out = Path("/proc/scene")
    else:
        (tmp_path / "locked").mkdir(mode=0o500)
        out = tmp_path / "locked/scene"
    with pytest.raises(ToolkitError, match="cannot") as error:
        import_recording(request(recording), out)
    assert "\n" not in str(error.value)


def test_distortion_of_a_flag_or_a_file(recording, tmp_path):
    asked = request(recording, distortion="0.1,-0.05,0.001,-0.001")
    scene = import_recording(asked, tmp_path / "a")
    assert scene.info.cameras["color"].distortion == [0.1, -0.05, 0.001, -0.001]
    (tmp_path / "k.json").write_text(
        '{"fx": 70, "fy": 71, "ppx": 31.5, "ppy": 23.5, "coeffs": [0.1, 0, 0, 0, 0]}'
    )
    scene = import_recording(request(recording, intrinsics=f"{tmp_path}/k.json"), tmp_path / "b")
    assert scene.camera(scene.frames[0]).distortion == (0.1, 0, 0, 0, 0)
    refused(tmp_path / "c", "0, 4, 5 or 8", request(recording, distortion="0.1,0.2"))


def test_the_sensors_correction_is_kept_apart_from_its_numbers(recording, tmp_path):
    scene = import_recording(request(recording, depth_correction=0.98), tmp_path / "scene")
    stored = (scene.root / "depth/1.png").read_bytes()
    assert stored == (recording / "depth/1.png").read_bytes()
    assert scene.read_depth(scene.frames[0])[9, 9] == pytest.approx(0.51 * 0.98)
    refused(tmp_path / "x", "between 0.8 and 1.25", request(recording, depth_correction=1000.0))


class Upside:
    """A third party's importer."""

    def recognises(self, source):
        return source is None

    def read(self, asked):
        from std_toolkit.importers.folder_importer import FOLDER

        return FOLDER.read(asked)


def test_a_third_party_importer_is_found_by_its_path(recording, tmp_path, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "third_party", sys.modules[__name__])
    monkeypatch.setattr(sys.modules[__name__], "UPSIDE", Upside(), raising=False)
    scene = import_recording(
        request(recording), tmp_path / "scene", format_name="third_party:UPSIDE"
    )
    assert len(scene.frames) == 10
    refused(tmp_path / "x", "known: folder, std", request(recording), format_name="exotic")


class Broken:
    """A third party's importer with errors of its own."""

    def __init__(self, fault):
        self.fault = fault

    def recognises(self, source):
        return source is None

    def read(self, asked):
        if self.fault == "raises":
            return {}["no such key"]
        return [asked]


@pytest.mark.parametrize("fault", ["raises", "returns a list"])
def test_an_error_of_a_plug_in_names_its_file(recording, tmp_path, monkeypatch, fault):
    import sys

    monkeypatch.setitem(sys.modules, "third_party", sys.modules[__name__])
    monkeypatch.setattr(sys.modules[__name__], "BROKEN", Broken(fault), raising=False)
    words = r"test_import_folder\.py: the importer third_party:BROKEN failed: (Key|Type)Error"
    refused(tmp_path / "x", words, request(recording), format_name="third_party:BROKEN")
