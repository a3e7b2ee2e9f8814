"""Recordings whose intrinsics change from image to image: a camera of the scene for each."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.doctor import examine
from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.importer import read_recording
from std_toolkit.importers.options import ImportRequest
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.options import KnownCameras
from std_toolkit.scene import Scene

W, H = 64, 48
K = [60, 0, 0, 0, 60, 0, 31.5, 23.5, 1]
# The third is that of the second, the last within the precision of a corner.
ROWS = [[60, 60, 31.5, 23.5], [63, 63, 32, 23], [63, 63, 32, 23], [63.02, 63, 32, 23]]
SAME = [ROWS[0]] * 4


def images(root: Path, names: list[str], color: str = "rgb", suffix: str = ".jpg") -> Path:
    for name in names:
        write_color(root / color / f"{name}{suffix}", np.full((H, W, 3), 80, np.uint8))
        write_depth_png16(root / "depth" / f"{name}.png", np.full((H, W), 0.7), scale=0.001)
    return root


def record3d(root: Path, rows: object, names: list[str] | None = None, **more: object) -> Path:
    document = {"w": W, "h": H, "K": K, "perFrameIntrinsicCoeffs": rows, **more}
    images(root, ["0", "1", "2", "3"] if names is None else names)
    (root / "metadata.json").write_text(json.dumps(document))
    return root


def imported(request: ImportRequest, tmp_path: Path) -> Scene:
    return import_recording(request, tmp_path / "scene")


def numbers(scene: Scene) -> list[list[float]]:
    cameras = [scene.camera(f) for f in scene.frames]
    return [[c.fx, c.fy, c.cx, c.cy] for c in cameras]


def test_each_image_of_record3d_has_its_own(tmp_path: Path, caplog) -> None:
    root = record3d(tmp_path / "rec", ROWS)
    with caplog.at_level("INFO", "std_toolkit"):
        scene = imported(ImportRequest(source=root, name="s"), tmp_path)
    assert numbers(scene) == [ROWS[0], ROWS[1], ROWS[1], ROWS[1]]
    assert list(scene.info.cameras) == ["color", "color_1"]
    # The right upper corner moves most: x by 31.5 / 20 + 0.5, y by -23.5 / 20 - 0.5.
    moved = np.hypot(31.5 / 20 + 0.5, -23.5 / 20 - 0.5)
    assert f"change from image to image, by up to {moved:.2g} px" in caplog.text
    report = examine(ImportRequest(source=root, name="s"))
    assert any("from image to image" in line for line in report.lines())
    assert any("camera color_1: 64x48, 3 frames" in line for line in report.lines())


def test_equal_rows_are_one_camera(tmp_path: Path, caplog) -> None:
    root = record3d(tmp_path / "rec", SAME)
    with caplog.at_level("INFO", "std_toolkit"):
        scene = imported(ImportRequest(source=root, name="s"), tmp_path)
    assert list(scene.info.cameras) == ["color"] and "image to image" not in caplog.text


def test_rows_are_found_by_the_number_of_the_image(tmp_path: Path, caplog) -> None:
    root = record3d(tmp_path / "rec", [*ROWS[:3], None], ["1", "2", "3"])
    scene = imported(ImportRequest(source=root, name="s"), tmp_path)
    assert numbers(scene) == [ROWS[1], ROWS[1], ROWS[1]]
    assert "no intrinsics of 1 of 3 images: those of the nearest image" in caplog.text


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ([*ROWS[:3], [1, 2]], r"perFrameIntrinsicCoeffs\[3\].*must be fx, fy, cx, cy"),
        ([*ROWS[:3], [63, 63, "x", 23]], r"perFrameIntrinsicCoeffs\[3\].*finite number"),
        ([*ROWS[:3], [63, 63, 60, 23]], "cx.*far from the centre"),
    ],
)
def test_bad_rows_are_named(rows: object, problem: str, tmp_path: Path) -> None:
    root = record3d(tmp_path / "rec", rows)
    with pytest.raises(ToolkitError, match=problem):
        imported(ImportRequest(source=root, name="s"), tmp_path)


def frames(names: list[str], rows: list[list[float]], *, posed: bool) -> dict[str, object]:
    found = []
    for i, (name, (fx, fy, cx, cy)) in enumerate(zip(names, rows, strict=True)):
        row: dict[str, object] = {"file_path": f"images/{name}.jpg", "fl_x": fx, "fl_y": fy}
        row |= {"cx": cx + 0.5, "cy": cy + 0.5, "w": W, "h": H}
        T = np.eye(4)
        T[0, 3] = 0.1 * i
        found.append({**row, "transform_matrix": T.tolist()} if posed else row)
    return {"frames": found}


@pytest.mark.parametrize("posed", [False, True])
def test_frames_of_transforms_have_their_own(posed: bool, tmp_path: Path) -> None:
    names = ["b", "a", "d", "c"]  # in another order than the images
    root = images(tmp_path / "rec", names, "images")
    path = tmp_path / "t.json"
    path.write_text(json.dumps(frames(names, ROWS, posed=posed)))
    request = ImportRequest(
        source=root / "images", color=str(root / "images"), name="s", intrinsics=str(path)
    )
    scene = imported(request, tmp_path)
    assert [f.name for f in scene.frames] == ["a", "b", "c", "d"]
    assert numbers(scene) == [ROWS[1], ROWS[0], ROWS[3], ROWS[1]]


def test_frames_of_known_cameras_have_their_own(tmp_path: Path) -> None:
    names = ["b", "a", "d", "c"]
    root = images(tmp_path / "rec", names, "images")
    path = tmp_path / "t.json"
    path.write_text(json.dumps(frames(names, ROWS, posed=True)))
    color = str(root / "images")
    known = KnownCameras(cameras=path, cameras_unit="m")
    found = read_recording("folder", ImportRequest(source=root, color=color, name="s", known=known))
    cameras = [found.cameras[f.camera] for f in found.frames]
    assert [c.fx for c in cameras] == [63, 60, 63.02, 63]


@pytest.mark.parametrize("given", ["cameras", "cameras/2.json"])
def test_a_file_for_each_image(given: str, tmp_path: Path, caplog) -> None:
    """As Polycam and ARKit file them."""
    root = images(tmp_path / "rec", ["1", "2", "3", "4"], "images")
    (root / "cameras").mkdir()
    for i, (fx, fy, cx, cy) in enumerate(ROWS, start=1):
        row = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": W, "height": H, "t_00": 1.0}
        (root / "cameras" / f"{i}.json").write_text(json.dumps(row))
    request = ImportRequest(source=root, name="s", intrinsics=str(root / given))
    with caplog.at_level("INFO", "std_toolkit"):
        scene = imported(request, tmp_path)
    assert numbers(scene) == [ROWS[0], ROWS[1], ROWS[1], ROWS[1]]
    assert "from image to image" in caplog.text


def test_pincam_files_of_arkitscenes(tmp_path: Path) -> None:
    names = ["4001_12.100", "4001_12.200"]
    root = images(tmp_path / "rec", names, "color", ".png")
    for name, row in zip(names, ROWS, strict=False):
        (root / "k").mkdir(exist_ok=True)
        (root / "k" / f"{name}.pincam").write_text(f"{W} {H} " + " ".join(map(str, row)))
    request = ImportRequest(source=root, name="s", intrinsics=str(root / "k"))
    assert numbers(imported(request, tmp_path)) == ROWS[:2]


def test_a_folder_of_other_files_is_refused(tmp_path: Path) -> None:
    root = images(tmp_path / "rec", ["1"], "images")
    request = ImportRequest(source=root, name="s", intrinsics=str(root))
    with pytest.raises(ToolkitError, match="no file of intrinsics in this folder has the name"):
        imported(request, tmp_path)
