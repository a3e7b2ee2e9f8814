"""Frames by id, name and file: what could mean two frames is refused, never guessed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_on_disk import camera_pose, camera_poses, write_scene

from std_toolkit.cli.main import main
from std_toolkit.errors import ToolkitError
from std_toolkit.scene import Frame
from std_toolkit.scene.frame_names import file_number, find_frame, frame_title


def every(step: int, count: int, *, pattern: str = "{:06d}", suffix: str = ".jpg") -> list[Frame]:
    names = [pattern.format(step * i) for i in range(count)]
    return [
        Frame(id=i, name=n, color=f"color/{n}{suffix}", depth=f"depth/{n}.png")
        for i, n in enumerate(names)
    ]


SPARSE = every(3, 20)


@pytest.mark.parametrize(
    ("given_", "wanted"),
    [
        ("000036.jpg", 12),
        ("color/000036.jpg", 12),
        ("depth/000036.png", 12),
        ("000036", 12),
        ("36", 12),
        (36, 12),
        ("000012.jpg", 4),
        ("000012", 4),
        ("13", 13),
        ("0013", 13),
        ("0", 0),
        (" 000036.jpg ", 12),
    ],
)
def test_a_frame_is_found_by_file_name_name_number_and_id(given_: str | int, wanted: int) -> None:
    assert find_frame(SPARSE, given_, root="scene").id == wanted


def test_a_number_that_means_two_frames_is_refused_with_both() -> None:
    for number in ("12", 12, "0012"):
        with pytest.raises(ToolkitError) as error:
            find_frame(SPARSE, number, root="scene")
        text = str(error.value)
        assert "the number of color/000012.jpg" in text
        assert "the id of color/000036.jpg" in text
        assert "000012.jpg or 000036.jpg" in text
        assert "\n" not in text


def test_a_name_of_plain_digits_is_a_number_too() -> None:
    frames = every(3, 20, pattern="{}")
    with pytest.raises(ToolkitError, match="several frames"):
        find_frame(frames, "12", root="scene")
    assert find_frame(frames, "12.jpg", root="scene").id == 4
    assert find_frame(frames, "36", root="scene").id == 12


@pytest.mark.parametrize("given_", ["99", "000099.jpg", "", "first", "-1", "1.5", "٣", "9" * 40])
def test_what_no_frame_has_is_an_error_with_the_range(given_: str) -> None:
    with pytest.raises(ToolkitError) as error:
        find_frame(SPARSE, given_, root="scene")
    text = str(error.value)
    assert "no such frame" in text
    assert "20 frames, ids 0 to 19, color/000000.jpg to color/000057.jpg" in text
    assert "info SCENE --frames" in text


def test_one_file_name_in_two_folders_needs_its_folder() -> None:
    frames = [
        Frame(id=0, name="a_1", color="left/1.png"),
        Frame(id=1, name="b_1", color="right/1.png"),
    ]
    with pytest.raises(ToolkitError, match=r"its folder.*left/1\.png, right/1\.png"):
        find_frame(frames, "1.png", root="scene")
    assert find_frame(frames, "right/1.png", root="scene").id == 1


@settings(max_examples=60, deadline=None)
@given(
    numbers=st.lists(st.integers(0, 40), min_size=1, max_size=12, unique=True).map(sorted),
    asked=st.integers(0, 45),
    pattern=st.sampled_from(["{}", "{:06d}", "color_{:04d}", "{}_rgb"]),
)
def test_a_number_is_found_only_where_every_reading_agrees(
    numbers: list[int], asked: int, pattern: str
) -> None:
    names = [pattern.format(n) for n in numbers]
    frames = [Frame(id=i, name=n, color=f"{n}.png") for i, n in enumerate(names)]
    readings = {i for i, n in enumerate(numbers) if n == asked}
    readings |= {asked} & set(range(len(numbers)))
    if len(readings) == 1:
        assert {find_frame(frames, asked, root="s").id} == readings
    else:
        with pytest.raises(ToolkitError, match="several frames" if readings else "no such frame"):
            find_frame(frames, asked, root="s")
    for frame in frames:
        assert find_frame(frames, f"{frame.name}.png", root="s") == frame


def test_the_title_has_id_and_file() -> None:
    assert frame_title(SPARSE[12]) == "frame 12 = color/000036.jpg"
    assert file_number("left_007_rgb") == 7
    assert file_number("left") is None


def test_info_lists_the_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path / "scene")
    scene.save_poses(camera_poses([camera_pose(0), None, camera_pose(2)]))
    assert main(["info", str(scene.root), "--frames"]) == 0
    head, *rows = (line.split() for line in capsys.readouterr().out.splitlines() if line.strip())
    assert head == ["id", "name", "file", "registered", "labelled", "annotated"]
    assert rows[-3:] == [
        ["0", "000000", "color/000000.png", "yes", "1", "box_1"],
        ["1", "000001", "color/000001.png", "no", "0"],
        ["2", "000002", "color/000002.png", "yes", "1"],
    ]
    assert main(["info", str(scene.root), "--frames", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [row["labelled"] for row in listed] == [["box_1"], [], ["box_1"]]


def test_render_takes_file_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path / "scene")
    command = ["render", str(scene.root), "--renderer", "raycast", "--workers", "1", "--frames"]
    assert main([*command, "000002.png", "0"]) == 0
    assert "frame 2 = color/000002.png" in capsys.readouterr().out
    assert {p.stem for p in (scene.root / "gt" / "mask").iterdir()} == {"000000", "000002"}
    assert main([*command, "5.png"]) == 1
    assert "no such frame; the scene has 3 frames" in capsys.readouterr().err


def test_a_scene_finds_its_frames(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "scene")
    assert scene.find_frame("000001.png") == scene.frame(1)
    with pytest.raises(ToolkitError, match=rf"{tmp_path}/scene: no such frame; .*ids 0 to 2"):
        scene.find_frame(7)
