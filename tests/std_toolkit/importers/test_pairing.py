from __future__ import annotations

import os
from pathlib import Path

import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.folder_importer import frame_key, frame_names, list_images
from std_toolkit.importers.foreign_files import natural_key
from std_toolkit.importers.pairing import Images, pair, paired


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


def images(folder: Path, *names: str) -> Images:
    return list_images(str(touch(folder, *names)), (".png",), role="images")


def names_of(found: tuple[Images, Images, dict[str, float]]) -> list[tuple[str, str]]:
    color, depth, _ = found
    return [(color[k].name, depth[k].name) for k in color]


def test_numbers_with_and_without_zeros_are_the_same(tmp_path):
    color = images(tmp_path / "rgb", *(f"{i}.png" for i in range(1, 12)))
    depth = images(tmp_path / "depth", *(f"{i:04d}.png" for i in range(1, 12)))
    assert names_of(paired(color, depth)) == [(f"{i}.png", f"{i:04d}.png") for i in range(1, 12)]
    depth = images(tmp_path / "other", *(f"depth{i:04d}.png" for i in range(1, 12)))
    assert len(names_of(paired(color, depth))) == 11
    fewer = images(tmp_path / "fewer", *(f"{i:04d}.png" for i in range(1, 11)))
    with pytest.raises(ToolkitError, match=r"do not pair by name.*--pair index"):
        paired(color, fewer)


def test_an_index_and_a_time_in_each_name_by_option(tmp_path):
    color = images(tmp_path / "rgb", *(f"{i}-{33333 * i:012d}.png" for i in range(1, 5)))
    depth = images(tmp_path / "depth", *(f"{i}-{33333 * i + 8000:012d}.png" for i in range(1, 5)))
    for by in ("index", "time", None):
        assert [c[0] for c, _ in names_of(paired(color, depth, by=by))] == list("1234")
    late = {k: p for k, p in depth.items() if not k.startswith("1")}
    assert [(c[0], d[0]) for c, d in names_of(paired(color, late, by="time"))] == [
        ("2", "2"), ("3", "3"), ("4", "4"),
    ]  # fmt: skip
    with pytest.raises(ToolkitError, match="4 colour and 3 depth"):
        paired(color, late, by="index")


def indexed(folder: Path, stamps: dict[int, int]) -> Images:
    names = [f"{i:07d}-{t:012d}.png" for i, t in stamps.items()]
    return {Path(n).stem: touch(folder, n) / n for n in names}


def test_an_index_and_a_time_that_agree_pair(tmp_path, caplog):
    """Index and microseconds; depth a little later."""
    color = indexed(tmp_path / "rgb", {i: 33_333 * i for i in range(1, 6)})
    depth = indexed(tmp_path / "depth", {i: 33_333 * i + 4_000 for i in range(1, 6)})
    with caplog.at_level("INFO", "std_toolkit"):
        found = paired(color, depth)
    assert [d.stem.split("-")[0] for d in found[1].values()] == [f"{i:07d}" for i in range(1, 6)]
    assert "paired by index and time in their names; 0 left out" in caplog.text


def test_half_a_period_does_not_contradict_the_index(tmp_path, caplog):
    """Depth 17.0 ms after its colour and 16.3 ms before the next: the handed case."""
    color = indexed(tmp_path / "rgb", {i + 1: 33_333 * i for i in range(4)})
    depth = indexed(tmp_path / "depth", {i + 1: 33_333 * i + 17_000 for i in range(4)})
    found = paired(color, depth)
    assert [k.split("-")[0] for k in found[0]] == [p.stem.split("-")[0] for p in found[1].values()]
    assert len(found[0]) == 4 and "depth is 0.51 periods after colour" in caplog.text


@pytest.mark.parametrize(
    ("color", "depth"),
    [
        ("1305031102 1305031102.5 1305031103", "1305031102.01 1305031102.51 1305031103.01"),
        ("1305031102 1305031103 1305031104", "1305031102.1 1305031103.1 1305031104.1"),
        ("1305031102175 1305031102208 1305031102241", "1305031102180 1305031102213 1305031102246"),
        ("1403636579763555584 1403636579813555456", "1403636579764555584 1403636579814555456"),
        ("1403636579763555584 1403636579813555456", "1403636579764555 1403636579814555"),
        ("0.000 0.033 0.067", "0.004 0.037 0.071"),
    ],
)
def test_time_stamps_of_any_unit_pair(color: str, depth: str, tmp_path):
    folders = [
        {s: touch(tmp_path / kind, f"{s}.png") / f"{s}.png" for s in stamps.split()}
        for kind, stamps in (("rgb", color), ("depth", depth))
    ]
    found = paired(*folders)
    assert list(found[0]) == color.split()
    assert [p.stem for p in found[1].values()] == depth.split()
    assert len(found[2]) == len(color.split())


@pytest.mark.parametrize(
    ("color", "depth"),
    [
        ("1.1 1.2 1.3", "1.4 1.5 1.6"),  # views of places
        ("0000000001 0000000002", "0000000003 0000000004"),  # indices of ten digits
        ("1305031102.1 1305031102.2", "0.101 0.201"),  # two clocks
    ],
)
def test_other_numbers_are_no_time_stamps(color: str, depth: str, tmp_path):
    folders = [
        {s: touch(tmp_path / kind, f"{s}.png") / f"{s}.png" for s in stamps.split()}
        for kind, stamps in (("rgb", color), ("depth", depth))
    ]
    with pytest.raises(ToolkitError, match="do not pair by name"):
        paired(*folders)


@pytest.mark.parametrize(
    "late",
    [
        {i: 33_333 * i + 21_000 for i in range(1, 6)},  # nearer to the next image
        {i + 1: 33_333 * i + 4_000 for i in range(1, 6)},  # counts of its own
        {1: 37_000, 2: 70_000, 3: 137_000, 4: 170_000, 5: 203_000},  # one was lost
    ],
)
def test_an_index_and_a_time_that_differ_ask(late: dict[int, int], tmp_path):
    color = indexed(tmp_path / "rgb", {i: 33_333 * i for i in range(1, 6)})
    with pytest.raises(ToolkitError, match=r"--pair index or --pair time"):
        paired(color, indexed(tmp_path / "depth", late))


def test_time_stamps_pair_with_the_nearest(tmp_path):
    color = images(tmp_path / "rgb", *(f"1305031102.{i}75304.png" for i in (1, 3, 5)))
    depth = images(tmp_path / "depth", *(f"1305031102.{i}90604.png" for i in (1, 3, 5)))
    color_found, depth_found, seconds = paired(color, depth)
    assert [p.name[11] for p in color_found.values()] == list("135")
    assert [p.name[11] for p in depth_found.values()] == list("135")
    assert next(iter(seconds.values())) == 1305031102.175304


def test_lists_of_time_stamps_beside_the_folders(tmp_path):
    color = images(tmp_path / "rgb", "a.png", "b.png")
    depth = images(tmp_path / "depth", "x.png", "y.png", "z.png")
    (tmp_path / "rgb.txt").write_text("# time name\n1.00 rgb/a.png\n1.10 rgb/b.png\n")
    (tmp_path / "depth.txt").write_text("0.50 depth/x.png\n1.01 depth/y.png\n1.11 depth/z.png\n")
    found = paired(color, depth, by="time")
    assert names_of(found) == [("a.png", "y.png"), ("b.png", "z.png")]
    assert found[2] == {"a": 1.0, "b": 1.1}
    (tmp_path / "depth.txt").unlink()
    with pytest.raises(ToolkitError, match=r"no time stamp.*rgb.txt"):
        paired(color, depth, by="time")


@pytest.mark.parametrize("order", [0, 1])
def test_associations(order, tmp_path):
    color = images(tmp_path / "rgb", "1.1.png", "2.1.png", "3.1.png")
    depth = images(tmp_path / "depth", "1.2.png", "3.2.png")
    rows = [["1.1 rgb/1.1.png", "1.2 depth/1.2.png"], ["3.1 rgb/3.1.png", "3.2 depth/3.2.png"]]
    text = "\n".join(" ".join(row[:: -1 if order else 1]) for row in rows)
    (tmp_path / "associations.txt").write_text(text)
    assert names_of(paired(color, depth)) == [("1.1.png", "1.2.png"), ("3.1.png", "3.2.png")]


def test_an_existing_folder_is_no_pattern(tmp_path):
    folder = touch(tmp_path / "rec [1]", "1.png", "2.png")
    assert list(list_images(str(folder), (".png",), role="color")) == ["1", "2"]
    assert list(list_images(str(folder / "*.png"), (".png",), role="color")) == ["1", "2"]


def test_a_list_that_contradicts_the_names_asks(tmp_path):
    color = images(tmp_path / "rgb", "1.png", "2.png", "3.png")
    depth = images(tmp_path / "depth", "1.png", "2.png", "3.png")
    (tmp_path / "associations.txt").write_text(
        "1 rgb/1.png 1 depth/2.png\n2 rgb/2.png 2 depth/3.png"
    )
    with pytest.raises(ToolkitError, match=r"colour 1 with depth 2.*--pair list.*--pair name"):
        paired(color, depth)
    assert names_of(paired(color, depth, by="list")) == [("1.png", "2.png"), ("2.png", "3.png")]
    assert len(names_of(paired(color, depth, by="name"))) == 3
    (tmp_path / "associations.txt").unlink()
    with pytest.raises(ToolkitError, match=r"no list of pairs"):
        paired(color, depth, by="list")


@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_an_entry_that_is_no_file_is_named(kind, tmp_path):
    folder = touch(tmp_path / "rgb", "1.png", "2.png")
    if kind == "link":
        (folder / "3.png").symlink_to(tmp_path / "not mounted" / "3.png")
    else:
        os.mkfifo(folder / "3.png")
    with pytest.raises(ToolkitError, match=r"3\.png: is a (link to nothing|pipe)"):
        list_images(str(folder), (".png",), role="color")
