"""Splits are found in every way that archives unpack, and never taken for another."""

from __future__ import annotations

import shutil
from operator import attrgetter
from pathlib import Path

import pytest
from dreds_on_disk import (
    write_cleargrasp_real,
    write_cleargrasp_synthetic,
    write_dreds_scene,
    write_std_scene,
)

from benchmark.data.loading import FrameIndex, SceneFolder, list_scenes
from benchmark.data.splits import DepthSource, Split, open_split, splits
from std_toolkit.errors import ToolkitError


def scenes_of(source: DepthSource) -> list[str]:
    return list(map(attrgetter("scene"), source.keys()))


def names_of(source: DepthSource) -> list[str]:
    return list(map(str, source.keys()))


@pytest.fixture(scope="module")
def dreds(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("scenes") / "dreds"
    write_dreds_scene(folder, frames=1)
    return folder


@pytest.fixture(scope="module")
def std(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("scenes") / "std"
    write_std_scene(folder, frames=1)
    return folder


@pytest.mark.parametrize(
    ("split", "folder"),
    [
        ("dreds-catknown-train", "DREDS/DREDS-CatKnown/train/part0/00001"),
        ("dreds-catknown-train", "DREDS-CatKnown/train/00001"),
        ("dreds-catknown-train", "train/00001"),
        ("dreds-catknown-val", "DREDS-CatKnown/val/shapenet_generate_1216/01162"),
        ("dreds-catknown-val", "shapenet_generate_1216/01162"),
        ("dreds-catknown-test", "DREDS-CatKnown/test/shapenet_generate_1216_val_novel/00000"),
        ("dreds-catknown-test", "data/DREDS_CatKnown/test/00000"),
        ("dreds-catnovel", "DREDS/DREDS-CatNovel/00029"),
        ("dreds-catnovel", "dreds-catnovel/00029"),
        ("dreds-catnovel", "00029"),
    ],
)
def test_layouts_of_dreds(split: str, folder: str, dreds: Path, tmp_path: Path) -> None:
    shutil.copytree(dreds, tmp_path / folder)
    assert scenes_of(open_split(split, tmp_path)) == [Path(folder).name]


@pytest.mark.parametrize(
    ("split", "folder"),
    [
        ("std-catknown", "STD/STD-CatKnown/test_18-1"),
        ("std-catknown", "train_3"),
        ("std-catnovel", "STD-CatNovel/real_data_novel/test_novel_0-1"),
        ("std-catnovel", "real_data_novel/test_novel_0-1"),
    ],
)
def test_layouts_of_std(split: str, folder: str, std: Path, tmp_path: Path) -> None:
    shutil.copytree(std, tmp_path / folder)
    assert scenes_of(open_split(split, tmp_path)) == [Path(folder).name]


def test_the_split_itself_or_a_part_or_a_scene_may_be_the_root(dreds: Path, tmp_path: Path) -> None:
    for part, scene in (("part0", "00001"), ("part0", "00002"), ("part1", "00003")):
        shutil.copytree(dreds, tmp_path / "DREDS-CatKnown/train" / part / scene)
    train = tmp_path / "DREDS-CatKnown/train"
    for root, count in ((train, 3), (train / "part0", 2), (train / "part0/00001", 1)):
        assert len(open_split("dreds-catknown-train", root)) == count


@pytest.mark.parametrize(
    ("split", "folder", "root"),
    [
        ("dreds-catknown-val", "DREDS-CatKnown/train/00001", "."),
        ("dreds-catknown-val", "DREDS-CatKnown/train/00001", "DREDS-CatKnown"),
        ("dreds-catknown-val", "DREDS-CatKnown/train/part0/00001", "DREDS-CatKnown/train"),
        ("dreds-catknown-val", "DREDS-CatKnown/train/part0/00001", "DREDS-CatKnown/train/part0"),
        ("dreds-catknown-test", "DREDS-CatNovel/test/00001", "DREDS-CatNovel"),
        ("dreds-catnovel", "DREDS-CatKnown/test/00001", "DREDS-CatKnown/test"),
        ("dreds-catnovel", "DREDS/DREDS-CatKnown/test/00001", "."),
    ],
)
def test_another_split_is_not_taken(
    split: str, folder: str, root: str, dreds: Path, tmp_path: Path
) -> None:
    shutil.copytree(dreds, tmp_path / folder)
    with pytest.raises(ToolkitError, match="nothing of this split is here") as error:
        open_split(split, tmp_path / root)
    assert "https://pku-epic.github.io/DREDS/" in str(error.value)


def test_files_of_the_other_layout_are_told(dreds: Path, tmp_path: Path) -> None:
    shutil.copytree(dreds, tmp_path / "mine/00001")
    with pytest.raises(ToolkitError, match="files of the layout dreds"):
        open_split("std-catknown", tmp_path / "mine")


def test_scenes_of_one_name_are_told_apart(dreds: Path, tmp_path: Path) -> None:
    for part in ("part0", "part1"):
        shutil.copytree(dreds, tmp_path / "DREDS-CatKnown/train" / part / "00001")
    shutil.copytree(dreds, tmp_path / "DREDS-CatKnown/train/part1/00002")
    keys = names_of(open_split("dreds-catknown-train", tmp_path))
    assert keys == ["part0_00001/0000", "part1_00001/0000", "00002/0000"]


def test_scenes_and_frames_come_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for scene in ("test_2", "test_10", "train_1-4"):
        folder = tmp_path / "STD-CatKnown" / scene
        folder.mkdir(parents=True)
        for stem in ("10", "9", "0100"):
            (folder / f"{stem}_depth_415.exr").touch()
    keys = names_of(open_split("std-catknown", tmp_path))
    assert keys[:4] == ["test_2/9", "test_2/10", "test_2/0100", "test_10/9"]
    assert len(keys) == 9


def test_a_frame_without_colour_is_listed(std: Path, tmp_path: Path) -> None:
    """It fails when it is read: leaving it out would make the set smaller without a word."""
    shutil.copytree(std, tmp_path / "STD-CatKnown/test_8")
    (tmp_path / "STD-CatKnown/test_8/0000_color.png").unlink()
    source = open_split("std-catknown", tmp_path)
    assert len(source) == 1
    with pytest.raises(ToolkitError, match=r"0000_color\.png: the frame has no colour"):
        source.load(0)


def test_places_of_cleargrasp(tmp_path: Path) -> None:
    top = tmp_path / "cleargrasp-dataset-test-val"
    write_cleargrasp_real(top / "real-val/d435", frames=2)
    write_cleargrasp_real(top / "real-test/d415", frames=1)
    write_cleargrasp_real(top / "real-test/d435", frames=1)
    write_cleargrasp_synthetic(top / "synthetic-val/cup-with-waves-val", frames=1)
    write_cleargrasp_synthetic(top / "synthetic-test/glass-round-potion-test", frames=2)
    for root in (tmp_path, top):
        known = open_split("cleargrasp-real-known", root).keys()
        assert [k.scene for k in known] == ["d435-000000000", "d435-000000001"]
        novel = open_split("cleargrasp-real-novel", root).keys()
        assert [k.scene for k in novel] == ["d415-000000000", "d435-000000000"]
        rendered = open_split("cleargrasp-synthetic", root).keys()
        assert [k.scene for k in rendered] == ["cup-with-waves-val"] + 2 * [
            "glass-round-potion-test"
        ]
    assert len(open_split("cleargrasp-real-known", top / "real-val/d435")) == 2
    assert len(open_split("cleargrasp-synthetic", top / "synthetic-test")) == 2
    with pytest.raises(ToolkitError, match="nothing of this split"):
        open_split("cleargrasp-real-novel", top / "real-val")


def test_meshes_beside_exports_are_no_scenes(std: Path, tmp_path: Path) -> None:
    shutil.copytree(std, tmp_path / "bench_7")
    mesh = tmp_path / "cad_model/mug/mug_a"
    mesh.mkdir(parents=True)
    (mesh / "mug_color.png").touch()
    nocs = tmp_path / "nocs/scene_1"
    nocs.mkdir(parents=True)
    (nocs / "0000_color.png").touch()
    assert scenes_of(open_split("std-export", tmp_path)) == ["bench_7"]


def test_an_unknown_split_names_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match=r"std-catknown.*cleargrasp-real-novel.*scenes"):
        open_split("std-known", tmp_path)


def test_a_root_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match=r"no such folder.*ROOT/STD-CatKnown/<scene>"):
        open_split("std-catknown", tmp_path / "nowhere")


MINE = Split("mine", "a test's own", "anywhere", open=lambda root: open_split("std-export", root))
NOT_MINE = "no split"


def test_a_split_of_ones_own(std: Path, tmp_path: Path) -> None:
    shutil.copytree(std, tmp_path / "a")
    assert len(open_split(f"{__name__}:MINE", tmp_path)) == 1
    with pytest.raises(ToolkitError, match=r"is no benchmark\.data\.splits\.Split"):
        open_split(f"{__name__}:NOT_MINE", tmp_path)


def test_every_split_opens_and_says_where_to_get_it() -> None:
    for name in splits.names():
        split = splits.get(name)
        assert split.name == name
        assert split.about and split.layout.startswith("ROOT/")
        assert (split.page != "") == (name not in ("scenes", "std-export"))
        assert all(address.startswith("https://") for address in split.download)


def test_numbers_of_frames_run_through_the_scenes() -> None:
    index = FrameIndex(
        (
            SceneFolder("a", "/a", ("0", "1")),
            SceneFolder("b", "/b", ("0",)),
            SceneFolder("c", "/c", ()),
        )
    )
    found = [(s.name, stem) for s, stem in (index.at(i) for i in range(len(index)))]
    assert found == [("a", "0"), ("a", "1"), ("b", "0")] == [(s.name, x) for s, x in index]
    for number in (-1, 3):
        with pytest.raises(IndexError):
            index.at(number)


def test_an_empty_folder_has_no_scenes(tmp_path: Path) -> None:
    assert len(list_scenes(tmp_path, ("_color.png",))) == 0
    with pytest.raises(IndexError):
        list_scenes(tmp_path, ("_color.png",)).at(0)
