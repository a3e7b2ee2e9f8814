"""The clouds of a scene: made aside, of what the scene is now, and tried again after a failure."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest
from desk_without_window import Desk
from scene_on_disk import camera_pose, camera_poses, write_scene

from annotator.app.view_options import CloudSource
from annotator.views.clouds import Cloud, CloudReader
from std_toolkit.geometry import SE3
from std_toolkit.rendering import point_cloud as support
from std_toolkit.scene import Scene

FUSED, FRAME = CloudSource.FUSED, CloudSource.FRAME


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(write_scene(tmp_path / "scene").root)
    yield made
    made.close()


def fused(desk: Desk, reader: CloudReader) -> Cloud:
    """The cloud of many frames, once it is there."""
    reader.prepare(FUSED)
    desk.wait(lambda: len(reader.get(0, FUSED).points) > 0)
    return reader.get(0, FUSED)


def test_single_frames_have_the_depth_correction_of_the_scene_as_it_is(desk: Desk) -> None:
    reader = CloudReader(desk.controller)
    before = reader.get(0, FRAME)
    assert reader.get(0, FRAME) is before
    other = Scene.open(desk.session.scene.root)
    other.save_info(msgspec.structs.replace(other.info, depth_correction=1.1))
    desk.session.reload()
    after = reader.get(0, FRAME)
    assert after.points[:, 2] == pytest.approx(1.1 * before.points[:, 2], rel=1e-3)


def test_reading_the_same_documents_again_reads_no_cloud_again(desk: Desk) -> None:
    reader = CloudReader(desk.controller)
    before = reader.get(0, FRAME), fused(desk, reader)
    desk.session.reload()
    assert (reader.get(0, FRAME), reader.get(0, FUSED)) == before


def test_other_camera_poses_bring_the_points_elsewhere(desk: Desk) -> None:
    reader = CloudReader(desk.controller)
    before = fused(desk, reader)
    T = SE3.exp([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    moved = camera_poses([T @ camera_pose(i) for i in range(3)])
    Scene.open(desk.session.scene.root).save_poses(moved)
    desk.session.reload()
    assert len(reader.get(0, FUSED).points) == 0  # nothing of before is shown
    after = fused(desk, reader)
    shift = np.median(after.points, axis=0) - np.median(before.points, axis=0)
    assert shift == pytest.approx([0.5, 0.0, 0.0], abs=0.02)


def test_what_was_being_made_of_the_old_poses_is_dropped(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The thread has a scene of its own: it does not see half of a change."""
    began, go_on = threading.Event(), threading.Event()
    real = support.fuse_clouds
    seen: list[float] = []

    def held(scene: Scene, *args: object, **options: object) -> object:
        began.set()
        assert go_on.wait(30)
        T = scene.T_world_cam(0)
        assert T is not None
        seen.append(float(T.t[0]))
        options["cancel"] = None
        return real(scene, *args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(support, "fuse_clouds", held)
    reader = CloudReader(desk.controller)
    reader.prepare(FUSED)
    assert began.wait(30)
    T = SE3.exp([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    moved = camera_poses([T @ camera_pose(i) for i in range(3)])
    Scene.open(desk.session.scene.root).save_poses(moved)
    desk.session.reload()
    go_on.set()
    desk.wait(lambda: len(seen) == 1)
    cloud = fused(desk, reader)
    assert seen == pytest.approx([0.0, 0.5])
    assert float(np.median(cloud.points[:, 0])) == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("error", [MemoryError("no room"), OSError("gone")])
def test_a_failure_is_told_once_and_can_be_tried_again(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    calls = []

    def broken(*_: object, **__: object) -> None:
        calls.append(1)
        raise error

    reader = CloudReader(desk.controller)
    with monkeypatch.context() as patch:
        patch.setattr(support, "fuse_clouds", broken)
        reader.prepare(FUSED)
        desk.wait(lambda: len(desk.messages) == 1)
        for _ in range(3):  # as with every drawing
            reader.prepare(FUSED)
            desk.rest(0.05)
        assert calls == [1]
        assert len(desk.messages) == 1
        assert str(error) in desk.messages[0]
        assert str(error) in reader.get(0, FUSED).note
    reader.prepare(FRAME)  # somebody looks at a single frame, and then asks again
    assert len(fused(desk, reader).points) > 100


def test_a_frame_that_cannot_be_read_is_told_and_does_not_last(desk: Desk) -> None:
    """An image that is missing while somebody copies the scene may be there a moment later."""
    reader = CloudReader(desk.controller)
    path = desk.session.scene.root / "depth" / "000001.png"
    data = path.read_bytes()
    path.write_bytes(b"")
    reader.prepare(FUSED)
    desk.wait(lambda: len(desk.messages) == 1)
    assert "000001.png" in desk.messages[0]
    path.write_bytes(data)
    reader.prepare(FRAME)
    assert len(fused(desk, reader).points) > 100
