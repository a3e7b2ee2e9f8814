"""Folders that are symbolic links out of a scene: no step writes through them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from std_toolkit.io.atomic import refuse_links


@pytest.mark.parametrize(
    ("folder", "words"),
    [
        ("gt", ("render", "--renderer", "raycast")),
        ("gt/depth", ("render", "--renderer", "raycast")),
        ("check", ("check",)),
        ("models", ("propagate",)),
        ("poses", ("poses",)),
        (".std/records", ("run",)),
    ],
)
def test_no_step_writes_through_a_link(
    root: Path, tmp_path: Path, folder: str, words: tuple[str, ...], refuse: Any
) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "mine.txt").write_text("mine")
    place = root / folder
    shutil.rmtree(place, ignore_errors=True)
    place.parent.mkdir(exist_ok=True)
    place.symlink_to(outside)
    line = refuse(words[0], root, *words[1:], names=folder)
    assert "symbolic link out of its scene" in line and str(outside) in line
    assert [p.name for p in outside.iterdir()] == ["mine.txt"]


def test_an_export_does_not_resume_through_a_link(root: Path, tmp_path: Path, run: Any) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "mine.txt").write_text("mine")
    (tmp_path / ".out.partial").symlink_to(outside)
    outcome = run("export", root, "--format", "bop", "--out", tmp_path / "out")
    assert outcome.status == 1
    assert "must not be a symbolic link" in outcome.err
    assert (outside / "mine.txt").read_text() == "mine"


def test_links_within_a_scene_and_to_images_remain(tmp_path: Path) -> None:
    images, scene = tmp_path / "images", tmp_path / "scene"
    for folder in (images, scene / "gt", scene / "a"):
        folder.mkdir(parents=True)
    (images / "0.png").write_bytes(b"png")
    (scene / "scene.json").write_text("{}")
    (scene / "color").symlink_to(images)
    (scene / "b").symlink_to(scene / "a")
    (scene / "gt" / "0.png").symlink_to(images / "0.png")
    (tmp_path / "link").symlink_to(scene)
    refuse_links(scene)
    refuse_links(tmp_path / "link")
