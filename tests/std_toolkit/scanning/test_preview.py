"""The first look at a scan: what it shows, and when there is none."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pytest
import trimesh

pytest.importorskip("manifold3d")

from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions
from std_toolkit.poses.board_scale import Board
from std_toolkit.scanning.board.board_photos import PhotoCameras, detect_boards
from std_toolkit.scanning.board.board_poses import board_starts
from std_toolkit.scanning.board.photo_poses import BoardFound
from std_toolkit.scanning.options import ScanOptions
from std_toolkit.scanning.photos.photos import find_photos
from std_toolkit.scanning.preview import remove_preview, write_preview
from tests.std_toolkit.scanning.boxes import BOARD_CAMERA, BOXES, write_photos_on_board

SERIAL = JobOptions(engine="serial", workers=1)


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> tuple[ScanOptions, BoardFound]:
    folder = tmp_path_factory.mktemp("boxes")
    description = write_photos_on_board(folder / "photos")
    photos = find_photos(folder / "photos", folder, longest=1600)
    found = detect_boards(photos.used, Board.read(description), SERIAL)
    options = ScanOptions(
        photos=folder / "photos", out=folder / "out", board=description, jobs=SERIAL
    )
    options.out.mkdir()
    every = range(len(photos.paths))
    return options, BoardFound(photos, every, found, PhotoCameras.one(BOARD_CAMERA, len(every)))


@pytest.mark.slow
def test_it_shows_all_objects_or_the_picked_one(
    board: tuple[ScanOptions, BoardFound], caplog: pytest.LogCaptureFixture
) -> None:
    options, found = board
    with caplog.at_level(logging.INFO, "std_toolkit"):
        write_preview(options, found)
    assert f"preview: {options.out / 'preview.ply'}: 2 objects" in caplog.text
    mesh = trimesh.load_mesh(options.out / "preview.ply")
    parts = sorted(mesh.split(only_watertight=False), key=lambda p: -p.volume)
    assert len(parts) == 2
    for part, (low, high) in zip(parts, BOXES, strict=True):
        # Few small photos, and no features: corners of a hull stick out.
        assert np.abs(part.bounds - [low, high]).max() < 0.025
    # The boxes are dark red, and the table is bright.
    seen = mesh.visual.vertex_colors[:, :3].astype(float)
    assert np.median(seen[:, 0] - seen[:, 1]) > 30

    # A pixel on the small box.
    low, high = BOXES[1]
    poses, _ = board_starts(found.detections, found.cameras)
    pixel = found.cameras.of(0).project(poses[0].inverse() @ ((low + high) / 2)[None])[0]
    name = found.photos.paths[0].name
    write_preview(replace(options, pick=f"{name}:{pixel[0]:.0f},{pixel[1]:.0f}"), found)
    alone = trimesh.load_mesh(options.out / "preview.ply")
    assert np.abs(alone.bounds - [low, high]).max() < 0.015
    remove_preview(options)
    assert not (options.out / "preview.ply").exists()


@pytest.mark.slow
def test_there_is_none_on_demand_or_for_glass(
    board: tuple[ScanOptions, BoardFound], caplog: pytest.LogCaptureFixture
) -> None:
    options, found = board
    with caplog.at_level(logging.INFO, "std_toolkit"):
        write_preview(replace(options, preview=False), found)
        write_preview(replace(options, revolve=True), found)
        write_preview(options, found._replace(kept=range(3), detections=found.detections[:3]))
    assert "preview: none: --no-preview" in caplog.text
    assert "preview: none: --revolve" in caplog.text
    assert "preview: none: the board gives a pose in 3 photos" in caplog.text
    assert not (options.out / "preview.ply").exists()


@pytest.mark.slow
def test_a_file_of_the_user_is_not_replaced(board: tuple[ScanOptions, BoardFound]) -> None:
    options, found = board
    own = options.out / "preview.ply"
    own.write_text("mine")
    try:
        with pytest.raises(ToolkitError, match="is not a file of this command"):
            write_preview(options, found)
        assert own.read_text() == "mine"
    finally:
        own.unlink()
