"""Photos as cameras write them: HEIC, orientation, lenses, and one camera a group."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("manifold3d")

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.images import read_color
from std_toolkit.poses.board_scale import BoardDetection
from std_toolkit.scanning.board.board_adjustment import adjust, build_model
from std_toolkit.scanning.board.board_photos import PhotoCameras, board_pose, calibrate
from std_toolkit.scanning.photos.photo_file import read_photo, read_photo_header
from std_toolkit.scanning.photos.photos import find_photos
from tests.std_toolkit.scanning.ball import look_at

WIDE = {"focal": 5.7, "equivalent": 26, "model": "phone"}


def picture(n: int = 0) -> np.ndarray:
    """An image of 64x48 with a red left upper corner."""
    image = np.full((48, 64, 3), 40 + 5 * n, np.uint8)
    image[:16, :16] = (230, 20, 20)
    return image


def exif(orientation: int = 1, focal: float = 5.7, equivalent: int = 26, model: str = "phone"):
    made = Image.Exif()
    made[0x0110], made[0x0112] = model, orientation
    block = made.get_ifd(0x8769)
    block[0x920A], block[0xA405] = focal, equivalent
    return made


# How stored pixels are made from upright ones, by EXIF orientation.
STORED = {
    1: lambda a: a, 2: lambda a: a[:, ::-1], 3: lambda a: a[::-1, ::-1], 4: lambda a: a[::-1],
    5: lambda a: a.transpose(1, 0, 2), 6: lambda a: np.rot90(a, 1),
    7: lambda a: np.rot90(a, 1)[:, ::-1][::-1, ::-1][::-1], 8: lambda a: np.rot90(a, 3),
}  # fmt: skip


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_photo_is_read_upright(tmp_path: Path, orientation: int) -> None:
    """As Pillow's `exif_transpose` turns it."""
    from PIL import ImageOps

    path = tmp_path / "a.jpg"
    stored = np.ascontiguousarray(STORED.get(orientation, STORED[1])(picture()))
    Image.fromarray(stored).save(path, quality=98, exif=exif(orientation))
    with Image.open(path) as opened:
        expected = np.asarray(ImageOps.exif_transpose(opened))
    header = read_photo_header(path)
    found = read_photo(path, header.orientation)
    assert header.size == (expected.shape[1], expected.shape[0])
    assert np.abs(found.astype(int) - expected).max() < 12
    # Given intrinsics belong to the stored pixels.
    assert read_photo_header(path, stored=True).size == (stored.shape[1], stored.shape[0])


def test_lens_and_focal_length_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    Image.fromarray(picture()).save(path, exif=exif(6))
    header = read_photo_header(path)
    assert header.size == (48, 64)
    assert "phone" in header.lens and "5.70 mm" in header.lens
    # 26 mm before a diagonal of 43.27 mm; that of the photo is 80 pixels.
    assert header.focal_px == pytest.approx(26 / 43.27 * 80)


def test_photos_are_grouped_by_size_and_lens(tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    for n in range(12):
        turned, tele = n % 3 == 1, n % 3 == 2
        stored = np.rot90(picture(n), 1) if turned else picture(n)
        made = exif(6 if turned else 1, *((9.0, 77) if tele else (5.7, 26)))
        Image.fromarray(np.ascontiguousarray(stored)).save(folder / f"{n:02d}.jpg", exif=made)
    # One in portrait, whose pixels are upright already.
    Image.fromarray(np.rot90(picture(9), 1).copy()).save(folder / "20.jpg", exif=exif())
    found = find_photos(folder, tmp_path, longest=32)
    assert found.groups == (*([0, 1, 2] * 4), 3)
    assert found.sizes[1] == (32, 24) and found.sizes[12] == (24, 32)
    assert read_color(found.used[1])[2, 2].argmax() == 0
    assert read_color(found.used[1]).shape == (24, 32, 3)
    assert found.factor_of(12) == 0.5


def test_each_group_has_its_own_camera() -> None:
    """Photos of two lenses and sizes on one board: poses and both focal lengths are right."""
    lenses = (Camera(640, 480, 600, 600, 322.0, 236.0), Camera(480, 640, 900, 900, 238.0, 322.0))
    y, x = np.mgrid[:6, :8] * 0.03
    xyz = np.stack([x, y, np.zeros(x.shape)], axis=-1).reshape(-1, 3)
    middle = np.array([0.1, 0.07, 0.0])
    rng = np.random.default_rng(0)
    groups = tuple(k % 2 for k in range(16))
    poses: dict[int, SE3] = {}
    found = []
    for k, g in enumerate(groups):
        away = np.array([0.3 * np.cos(k), 0.3 * np.sin(k), 0.25 + 0.04 * (k % 3)]) * (1 + g)
        poses[k] = look_at(middle + away, middle)
        uv = lenses[g].project(poses[k].inverse() @ xyz) + rng.normal(0, 0.1, (48, 2))
        found.append(BoardDetection(np.arange(48), xyz, uv))
    start = PhotoCameras(
        tuple(calibrate([f for f, h in zip(found, groups, strict=True) if h == g], lenses[g].size)
              for g in range(2)), groups,
    )  # fmt: skip
    first = {k: board_pose(found[k], start.of(k))[0].inverse() for k in poses}  # type: ignore[index]
    points = middle + rng.uniform(-0.06, 0.06, (60, 3)) + [0, 0, 0.06]
    uv = {k: lenses[groups[k]].project(T.inverse() @ points) for k, T in poses.items()}
    same = np.column_stack([np.arange(60)] * 2)
    pairs = [(a, b, same) for a in poses for b in poses if a < b]
    paths = [Path(f"{k}.jpg") for k in poses]
    done = adjust(build_model(paths, first, found, uv, pairs, start), found, groups)
    assert [c.size for c in done.cameras] == [(640, 480), (480, 640)]
    assert [c.fx for c in done.cameras] == pytest.approx([600, 900], rel=6e-3)
    assert max(np.linalg.norm(done.poses[k].t - T.t) for k, T in poses.items()) < 4e-3
    assert done.corner_rms_px < 0.2 and len(done.points) > 30


def test_photos_that_no_camera_explains_are_named() -> None:
    camera = Camera(640, 480, 600, 600, 319.5, 239.5)
    y, x = np.mgrid[:6, :8] * 0.03
    xyz = np.stack([x, y, np.zeros(x.shape)], axis=-1).reshape(-1, 3)
    middle = np.array([0.1, 0.07, 0.0])
    poses = {
        k: look_at(middle + np.array([0.3 * np.cos(k), 0.3 * np.sin(k), 0.18 + 0.15 * (k % 2)]),
                   middle)
        for k in range(12)
    }  # fmt: skip
    found = []
    for k, T in poses.items():
        uv = camera.project(T.inverse() @ xyz)
        # As a rolling shutter or a wavy sheet would.
        bend = 3 * np.sin(uv[:, :1] / 60) * [0, 1] if k % 3 == 0 else 0
        found.append(BoardDetection(np.arange(48), xyz, uv + bend))
    model = build_model([Path(f"{k}.jpg") for k in poses], poses, found, {k: np.zeros((0, 2))
                        for k in poses}, [], PhotoCameras.one(camera, 12))  # fmt: skip
    with pytest.raises(
        ToolkitError, match=r"board in 4 of 12 photos.*(0|3|6|9)\.jpg.*zoom or lens"
    ):
        adjust(model, found)


def heic_folder(folder: Path) -> Path:
    """Ten files of 12 bytes, which begin as HEIC does."""
    folder.mkdir()
    for n in range(10):
        (folder / f"IMG_{n:04d}.HEIC").write_bytes(b"\0\0\0\x18ftypheic")
    return folder


def test_heic_without_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    told = r"IMG_0000\.HEIC: HEIC photos need pillow-heif.*std-toolkit\[heic\].*convert"
    with pytest.raises(ToolkitError, match=told):
        find_photos(heic_folder(tmp_path / "heic"), tmp_path, longest=1600)


def test_damaged_heic_is_called_so(tmp_path: Path) -> None:
    pytest.importorskip("pillow_heif")
    with pytest.raises(ToolkitError, match=r"IMG_0000\.HEIC: the HEIC file is damaged"):
        find_photos(heic_folder(tmp_path / "heic"), tmp_path, longest=1600)


def test_heic_is_read_with_its_lens(tmp_path: Path) -> None:
    pillow_heif = pytest.importorskip("pillow_heif")
    folder = tmp_path / "photos"
    folder.mkdir()
    for n in range(8):
        image = pillow_heif.from_pillow(Image.fromarray(picture(n)))
        image.save(folder / f"IMG_{n:04d}.HEIC", quality=95, exif=exif().tobytes())
    found = find_photos(folder, tmp_path, longest=1600)
    assert found.groups == (0,) * 8 and "5.70 mm" in found.headers[0].lens
    read = read_color(found.used[3])
    assert read.shape == (48, 64, 3)
    assert np.abs(read[20:, 20:].astype(int) - 55).max() < 12
    assert read[4, 4].argmax() == 0
