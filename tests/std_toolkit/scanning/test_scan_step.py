"""A scan from photos to files, its resumption, and what it says about unusable photos."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("manifold3d")

from std_toolkit.cli.scanning import main
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.images import read_color, write_color, write_png
from std_toolkit.jobs import JobOptions
from std_toolkit.jobs.door import output
from std_toolkit.options import KnownCameras
from std_toolkit.poses.board_scale import BoardDetection
from std_toolkit.scanning import scan_step
from std_toolkit.scanning.board.board_adjustment import adjust, build_model
from std_toolkit.scanning.board.board_photos import (
    PhotoCameras,
    board_pose,
    calibrate,
    check_boards,
)
from std_toolkit.scanning.masks import object_masks
from std_toolkit.scanning.options import MODEL_FOLDER, ScanOptions
from std_toolkit.scanning.photos.photos import blurred_photos
from tests.std_toolkit.scanning.ball import CENTRE, RADIUS, ball_views, look_at

SERIAL = JobOptions(engine="serial", workers=1)


def write_photos(folder: Path, count: int = 16) -> Path:
    """Photos of the ball, and cameras.json beside the folder."""
    folder.mkdir()
    rows = []
    views = ball_views(count)
    for view in views:
        write_color(folder / view.name, view.image)
        rows.append({"name": view.name, "T_world_cam": view.T_world_cam.matrix().tolist()})
    cameras = folder.parent / "cameras.json"
    cameras.write_text(json.dumps(rows))
    return cameras


def options_for(tmp_path: Path, **changes: object) -> ScanOptions:
    values: dict[str, object] = {
        "photos": tmp_path / "photos",
        "out": tmp_path / "ball",
        "intrinsics": "260,260,79.5,59.5",
        "known": KnownCameras(cameras=tmp_path / "cameras.json"),
        "faces": 2000,
        "texture": 128,
        "voxels": 60,
        "jobs": SERIAL,
    }
    return ScanOptions(**{**values, **changes})  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_painted_ball_is_scanned_and_the_scan_resumes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_photos(tmp_path / "photos")
    done = scan_step.scan(options_for(tmp_path))
    off = np.linalg.norm(done.vertices - CENTRE, axis=1) - RADIUS
    seen = done.vertices[:, 2] > CENTRE[2] - 0.4 * RADIUS
    assert np.median(np.abs(off[seen])) < 0.0005
    assert np.percentile(np.abs(off[seen]), 95) < 0.002
    assert done.supported.mean() > 0.5
    facts = json.loads((tmp_path / "ball" / "scan.json").read_text())
    assert min(facts["outline_overlaps"].values()) > 0.95
    assert "from below" in (tmp_path / "ball" / "report.html").read_text()

    def never(*_: object, **__: object) -> None:
        raise AssertionError("made again although nothing changed")

    monkeypatch.setattr(scan_step, "depth_engine", lambda _: never)
    monkeypatch.setattr(object_masks, "segment_by_border", never)
    again = scan_step.scan(options_for(tmp_path))
    assert np.array_equal(again.vertices, done.vertices)


def test_too_few_photos(tmp_path: Path) -> None:
    write_photos(tmp_path / "photos", 5)
    with pytest.raises(ToolkitError, match=r"5 photos are too few.*40 to 60"):
        scan_step.scan(options_for(tmp_path))


def test_without_board_and_cameras_the_size_is_unknown(tmp_path: Path) -> None:
    write_photos(tmp_path / "photos", 8)
    with pytest.raises(ToolkitError, match=r"scale is unknown: no board.*--board"):
        scan_step.scan(options_for(tmp_path, known=KnownCameras()))


def test_masks_must_be_named_as_the_photos(tmp_path: Path) -> None:
    write_photos(tmp_path / "photos", 8)
    (tmp_path / "masks").mkdir()
    write_png(tmp_path / "masks" / "other.png", np.zeros((120, 160), np.uint8))
    with pytest.raises(ToolkitError, match="no mask is named as a photo"):
        scan_step.scan(options_for(tmp_path, masks=tmp_path / "masks"))


def test_photos_without_the_board_are_refused(tmp_path: Path) -> None:
    nothing = BoardDetection(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 2)))
    with pytest.raises(ToolkitError, match=r"found in 0 of 9 photos.*most of the board in view"):
        check_boards([nothing] * 9, [Path("a.jpg")] * 9, tmp_path / "board.json")


def grid_detection(T_world_cam: SE3, camera: Camera) -> BoardDetection:
    y, x = np.mgrid[:6, :8] * 0.03
    xyz = np.stack([x, y, np.zeros(x.shape)], axis=-1).reshape(-1, 3)
    return BoardDetection(np.arange(48), xyz, camera.project(T_world_cam.inverse() @ xyz))


def test_the_board_gives_intrinsics_and_poses() -> None:
    camera = Camera(640, 480, 600, 600, 322.0, 236.0, (-0.1, 0.05, 0.0, 0.0))
    middle = np.array([0.1, 0.07, 0.0])
    poses = [
        look_at(middle + np.array([r * np.cos(a), r * np.sin(a), h]), middle)
        for a, r, h in [(k, 0.25, 0.25 + 0.05 * (k % 3)) for k in range(8)]
    ]
    found = [grid_detection(T, camera) for T in poses]
    got = calibrate(found, (640, 480))
    assert got.fx == pytest.approx(600, rel=1e-3)
    assert got.cx == pytest.approx(322, abs=0.5)
    result = board_pose(found[0], camera)
    assert result is not None
    T, error = result
    assert error < 0.01
    assert np.allclose(T.inverse().t, poses[0].t, atol=1e-4)


def test_features_do_not_change_what_corners_say(tmp_path: Path) -> None:
    """Noisy features adjusted together with corners leave the poses of the corners."""
    camera = Camera(640, 480, 600, 600, 322.0, 236.0, (-0.1, 0.05, 0.0, 0.0))
    middle = np.array([0.1, 0.07, 0.0])
    poses = {
        k: look_at(middle + np.array([r * np.cos(k), r * np.sin(k), h]), middle)
        for k, r, h in [(k, 0.25, 0.25 + 0.05 * (k % 3)) for k in range(8)]
    }
    found = [grid_detection(T, camera) for T in poses.values()]
    rng = np.random.default_rng(0)
    points = middle + rng.uniform(-0.06, 0.06, (60, 3)) + [0, 0, 0.06]
    uv = {
        k: camera.project(T.inverse() @ points) + rng.normal(size=(60, 2)) + [0.6, 0]
        for k, T in poses.items()
    }
    same = np.column_stack([np.arange(60)] * 2)
    pairs = [(a, b, same) for a in poses for b in poses if a < b]
    paths = [tmp_path / f"{k}.jpg" for k in poses]
    start = Camera(640, 480, 603, 602, 320.0, 238.0, (-0.08, 0.0, 1e-3, 0.0))
    done = adjust(build_model(paths, poses, found, uv, pairs, PhotoCameras.one(start, 8)), found)
    assert done.cameras[0].fx == done.cameras[0].fy == pytest.approx(600, abs=2.0)
    assert done.cameras[0].distortion[2:] == (0.0, 0.0)
    off = [np.linalg.norm(done.poses[k].t - T.t) for k, T in poses.items()]
    assert max(off) < 2e-3
    assert len(done.points) > 10


@pytest.mark.parametrize("features", [True, False])
def test_corners_seen_through_glass_do_not_move_the_cameras(tmp_path: Path, features: bool) -> None:
    camera = Camera(640, 480, 600, 600, 322.0, 236.0)
    middle = np.array([0.1, 0.07, 0.0])
    poses = {
        k: look_at(middle + np.array([0.25 * np.cos(k), 0.25 * np.sin(k), h]), middle)
        for k, h in [(k, 0.12 if k % 2 else 0.3) for k in range(10)]
    }
    rng = np.random.default_rng(0)
    found = []
    for k, T in poses.items():
        one = grid_detection(T, camera)
        uv = one.uv + rng.normal(0, 0.08, one.uv.shape)
        # Behind the vessel, a sixth of the corners are moved upwards, as by a lens.
        behind = np.argsort(np.abs(one.uv[:, 0] - 320) + 0.1 * k)[: len(uv) // 6]
        uv[behind] += rng.normal([0.0, -4.0], 1.5, (len(behind), 2))
        found.append(replace(one, uv=uv))
    points = middle + rng.uniform(-0.06, 0.06, (60, 3)) + [0, 0, 0.06]
    uv = {
        k: camera.project(T.inverse() @ points) + rng.normal(0, 0.5, (60, 2))
        for k, T in poses.items()
    }
    same = np.column_stack([np.arange(60)] * 2)
    pairs = [(a, b, same) for a in poses for b in poses if a < b] if features else []
    paths = [tmp_path / f"{k}.jpg" for k in poses]
    start = {k: board_pose(found[k], camera)[0].inverse() for k in poses}  # type: ignore[index]
    done = adjust(build_model(paths, start, found, uv, pairs, PhotoCameras.one(camera, 10)), found)
    off = [np.linalg.norm(done.poses[k].t - T.t) for k, T in poses.items()]
    assert max(off) < 4e-4
    assert done.cameras[0].fx == pytest.approx(600, abs=0.6)
    assert done.corner_rms_px == pytest.approx(0.08 * np.sqrt(2), rel=0.15)


@pytest.mark.slow
def test_a_ball_is_a_surface_of_revolution() -> None:
    shift = SE3(np.eye(3), np.array([0, 0, RADIUS - CENTRE[2]]))
    views = [replace(v, T_world_cam=shift @ v.T_world_cam) for v in ball_views(12)]
    posed = scan_step.PosedPhotos(
        views=views, corners=np.zeros((0, 3)), points=np.zeros((0, 3)), on_table=True, facts={},
        warnings=[], digest="", photos=scan_step.photo_files.Photos((), (), (160, 120), 1.0),
    )  # fmt: skip
    found = scan_step.fit_revolution(scan_step._outline_views(views))
    surface = scan_step._revolved(found, posed)
    vertices, faces, support = surface.vertices, surface.faces, surface.support
    assert not support.any()
    assert len(support) == len(faces)
    assert np.linalg.norm(vertices[:, :2] - CENTRE[:2], axis=1).max() == pytest.approx(
        RADIUS, abs=0.0006
    )
    assert "outline residual" in posed.facts
    options = scan_step.ScanOptions(photos=Path("photos"), out=Path("out"), revolve=True)
    with pytest.raises(ToolkitError, match="needs the board"):
        scan_step._vessel(options, replace(posed, on_table=False), Path("x"), 1)


def test_blurred_photos_are_found(tmp_path: Path) -> None:
    import cv2

    rng = np.random.default_rng(0)
    paths = []
    for n in range(10):
        image = rng.integers(0, 255, (240, 320, 3)).astype(np.uint8)
        image = cv2.GaussianBlur(image, (0, 0), 1.2)
        if n == 4:
            image = cv2.GaussianBlur(image, (0, 0), 6)
        paths.append(tmp_path / f"{n}.png")
        write_color(paths[-1], image)
    assert blurred_photos(paths) == [4]


def test_a_choice_names_a_photo_and_numbers(tmp_path: Path) -> None:
    write_photos(tmp_path / "photos", 8)
    found = scan_step.photo_files.find_photos(tmp_path / "photos", tmp_path, longest=1600)
    assert found.index_of("003", "--pick") == 3
    with pytest.raises(ToolkitError, match="no such photo"):
        found.index_of("nine", "--pick")


def test_a_photo_replaced_by_an_older_file_is_reduced_again(tmp_path: Path) -> None:
    """As after `cp -p`, or with the clock set back."""
    folder = tmp_path / "photos"
    folder.mkdir()
    for n in range(8):
        write_color(folder / f"{n}.png", np.full((48, 64, 3), 50 + n, np.uint8))
    scan_step.photo_files.find_photos(folder, tmp_path / "work", longest=32)
    write_color(folder / "3.png", np.full((48, 64, 3), 200, np.uint8))
    os.utime(folder / "3.png", (0, 0))
    found = scan_step.photo_files.find_photos(folder, tmp_path / "work", longest=32)
    assert (read_color(found.used[3]) == 200).all()


def test_files_of_the_user_are_not_replaced(tmp_path: Path) -> None:
    write_photos(tmp_path / "photos")
    out = tmp_path / "ball"
    out.mkdir()
    for name in ("report.html", "ball.obj"):
        (out / name).write_text("mine")
        with pytest.raises(ToolkitError, match="files that are not of this command"):
            scan_step.scan(options_for(tmp_path))
        assert [p.name for p in out.iterdir()] == [name]
        (out / name).unlink()
    # Within a folder that a scan began.
    with output(out, MODEL_FOLDER, "std-scan photos"):
        (out / ".scan").mkdir()
    (out / "ball.obj").write_text("mine")
    with pytest.raises(ToolkitError, match=r"ball\.obj: is not a file of this command"):
        scan_step.scan(options_for(tmp_path))
    assert (out / "ball.obj").read_text() == "mine"


@pytest.mark.parametrize("option", ["pick", "box"])
def test_an_object_is_chosen_on_a_board_alone(tmp_path: Path, option: str) -> None:
    with pytest.raises(ToolkitError, match=f"--{option}: chooses one of several objects"):
        options_for(tmp_path, **{option: "0.png:3,4"})


def test_an_error_of_an_engine_is_not_ours(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cameras = write_photos(tmp_path / "photos", 8)
    (tmp_path / "masks").mkdir()
    for view in ball_views(8):
        write_png(tmp_path / "masks" / f"{view.name}", view.mask.astype(np.uint8) * 255)
    engine = tmp_path / "engine.py"
    engine.write_text("def E(*args, **kw):\n    raise RuntimeError('my own bug')\n")
    words = f"photos {tmp_path}/photos --masks {tmp_path}/masks --depth {engine}:E"
    more = f"--cameras {cameras} --intrinsics 260,260,79.5,59.5 --voxels 30 --engine serial"
    assert main([*words.split(), *more.split(), "--out", str(tmp_path / "out")]) == 1
    errors = [row for row in capsys.readouterr().err.splitlines() if row.startswith("error:")]
    assert len(errors) == 1
    assert f"{engine}: line 2, E: RuntimeError: my own bug" in errors[0]


def test_masks_of_another_shape_are_refused(tmp_path: Path) -> None:
    write_photos(tmp_path / "photos")
    (tmp_path / "masks").mkdir()
    photo = sorted((tmp_path / "photos").iterdir())[0]
    write_png(tmp_path / "masks" / f"{photo.stem}.png", np.full((160, 120), 255, np.uint8))
    with pytest.raises(ToolkitError, match=r"another shape than its photo, which is 160x120"):
        scan_step.scan(options_for(tmp_path, masks=tmp_path / "masks"))
