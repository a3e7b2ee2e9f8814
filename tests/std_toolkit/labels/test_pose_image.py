"""A pose file that holds another image's pose is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.entry.pose_image import WantedImage
from std_toolkit.labels.entry.posefile import read_pose
from std_toolkit.scene import Frame

POSE = SE3.exp(np.array([0.05, -0.02, 0.7, 0.4, -0.8, 1.1]))


def scene_frames(step: int, count: int = 30, pattern: str = "{:06d}") -> tuple[Frame, ...]:
    names = [pattern.format(step * i) for i in range(count)]
    return tuple(Frame(id=i, name=n, color=f"color/{n}.png") for i, n in enumerate(names))


def bop(images: dict[str, float], path: Path) -> Path:
    """A file with an object at a depth (m) by image."""
    rows = {
        image: [
            {"obj_id": 1, "cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0, 0, 1000 * z]}
        ]
        for image, z in images.items()
    }
    path.write_text(json.dumps(rows))
    return path


def depth_of(path: Path, frame: int, frames: tuple[Frame, ...], given: str | None = None) -> float:
    pose = read_pose(path, frame=given, wanted=WantedImage(frames[frame], frames))
    return float(pose.t[2])


@pytest.mark.parametrize("name", ["scene_gt.json", "pose.json"])
def test_a_file_of_another_image_alone_is_refused_with_its_image(tmp_path: Path, name: str) -> None:
    path = bop({"5": 0.5}, tmp_path / name)
    with pytest.raises(ToolkitError) as error:
        depth_of(path, 0, scene_frames(1))
    text = str(error.value)
    assert "image 5 alone, not frame 0 = color/000000.png" in text
    assert "--pose-frame 5" in text and str(path) in text
    assert depth_of(path, 5, scene_frames(1)) == 0.5
    assert depth_of(path, 0, scene_frames(1), given="000005") == 0.5


def test_the_number_of_the_file_selects_the_image(tmp_path: Path) -> None:
    frames = scene_frames(3)  # 000000, 000003, ...: frame 12 is 000036
    every = bop({str(3 * i): 0.3 + 0.01 * i for i in range(30)}, tmp_path / "scene_gt.json")
    assert depth_of(every, 12, frames) == pytest.approx(0.42)
    exported = bop({str(i): 0.3 + 0.01 * i for i in range(30)}, tmp_path / "exported.json")
    assert depth_of(exported, 12, frames) == pytest.approx(0.42)


def test_a_number_of_two_frames_is_refused(tmp_path: Path) -> None:
    frames = scene_frames(3)
    all_images = bop({str(i): 0.4 for i in range(90)}, tmp_path / "a.json")
    with pytest.raises(ToolkitError, match=r"images 36, 12 .*--pose-frame"):
        depth_of(all_images, 12, frames)
    assert depth_of(all_images, 12, frames, given="36") == 0.4
    alone = bop({"12": 0.4}, tmp_path / "b.json")
    with pytest.raises(ToolkitError, match=r"image 12 .* frame 12 = .*000036.* or frame 4 = "):
        depth_of(alone, 12, frames)


def test_images_named_by_file_are_compared_by_name(tmp_path: Path) -> None:
    row = {"obj": "mug.obj", "R": np.eye(3).ravel().tolist(), "t": [0, 0, 0.6], "id": "x"}
    path = tmp_path / "poses.json"
    path.write_text(json.dumps({"000003.png": [row]}))
    assert depth_of(path, 1, scene_frames(3)) == 0.6
    with pytest.raises(ToolkitError, match=r"image 000003\.png alone, not frame 0 = "):
        depth_of(path, 0, scene_frames(3))


def test_labelfusion_names_its_image_in_the_file_name(tmp_path: Path) -> None:
    body = "mug:\n  pose: [[0, 0, 0.6], [1, 0, 0, 0]]\n"
    frames = scene_frames(1, pattern="{:010d}_rgb")
    numbered = tmp_path / "0000000004_poses.yaml"
    first = tmp_path / "registration_result.yaml"
    other = tmp_path / "mug.yaml"
    for path in (numbered, first, other):
        path.write_text(body)
    assert depth_of(numbered, 4, frames) == 0.6
    with pytest.raises(ToolkitError, match=r"image 0000000004 alone, not frame 1 = "):
        depth_of(numbered, 1, frames)
    assert depth_of(first, 0, frames) == 0.6
    with pytest.raises(ToolkitError, match=r"image first alone, not frame 1 = "):
        depth_of(first, 1, frames)
    assert depth_of(first, 1, frames, given="first") == 0.6
    assert depth_of(other, 7, frames) == 0.6
