from __future__ import annotations

from pathlib import Path

import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.folder_importer import frame_key, frame_names, list_images, pair
from std_toolkit.importers.foreign_files import natural_key


@pytest.mark.parametrize(
    ("stem", "key"),
    [
        ("000007", "000007"),
        ("000007-color", "000007"),
        ("0007_rgb", "0007"),
        ("depth_0007", "0007"),
        ("rgb_aligned_0007", "0007"),
        ("frame-000005.color", "frame-000005"),
        ("000123-depth-img", "000123"),
        ("scene_2_view_3", "scene_2_view_3"),
        ("color", "color"),
        ("a-b_c", "a-b_c"),
    ],
)
def test_frame_key_drops_what_tells_the_kind_of_image(stem, key):
    assert frame_key(stem) == key


def test_natural_order_counts():
    names = ["10", "9", "1", "img2", "img10", "img1"]
    assert sorted(names, key=natural_key) == ["1", "9", "10", "img1", "img2", "img10"]


def touch(folder: Path, *names: str) -> Path:
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / name).write_bytes(b"x")
    return folder


def test_one_folder_for_both_kinds(tmp_path):
    touch(tmp_path, "1-color.png", "1-depth.png", "2-color.png", "2-depth.png", "1-mask.png")
    color = list_images(str(tmp_path), (".png",), role="color", shared=True)
    depth = list_images(str(tmp_path), (".png",), role="depth", shared=True)
    assert list(color) == list(depth) == ["1", "2"]
    assert pair(color, depth)["2"].name == "2-depth.png"


def test_two_images_of_one_frame_are_refused(tmp_path):
    touch(tmp_path, "1.png", "1.jpg")
    with pytest.raises(ToolkitError, match="two color images of one frame"):
        list_images(str(tmp_path), (".png", ".jpg"), role="color")


def test_missing_partners_are_named(tmp_path):
    color = {k: tmp_path / k for k in ("1", "2", "3", "4")}
    depth = {k: tmp_path / k for k in ("2", "3", "5")}
    with pytest.raises(ToolkitError, match=r"2 without depth: 1, 4; 1 without colour: 5"):
        pair(color, depth)
    assert list(pair(color, depth, skip_unpaired=True)) == ["2", "3"]
    with pytest.raises(ToolkitError, match="no colour image"):
        pair({"a": tmp_path}, {"b": tmp_path}, skip_unpaired=True)


def test_names_become_safe_and_stay_unique():
    assert frame_names(["a b", "c"]) == {"a b": "a_b", "c": "c"}
    with pytest.raises(ToolkitError, match="map to the same name"):
        frame_names(["a b", "a_b"])


def test_empty_and_missing_folders(tmp_path):
    with pytest.raises(ToolkitError, match="no color images here"):
        list_images(str(tmp_path), (".png",), role="color")
    with pytest.raises(ToolkitError, match="no such folder"):
        list_images(str(tmp_path / "no"), (".png",), role="depth")
    image = tmp_path / "a.png"
    image.touch()
    with pytest.raises(ToolkitError, match=r"not a folder of color images.*\*\.png"):
        list_images(str(image), (".png",), role="color")
