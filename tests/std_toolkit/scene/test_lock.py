"""One writer at a time; a dead one does not block the next."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import msgspec
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.io.locks import lock_holder, scene_lock
from std_toolkit.scene import CameraModel, Frames, Scene, SceneInfo

HOLDER = """
import sys, time
from pathlib import Path
from std_toolkit.io.locks import scene_lock
with scene_lock(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path: Path):  # type: ignore[no-untyped-def]
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "locked\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def test_a_second_writer_is_told_who_the_first_one_is(tmp_path: Path, holder) -> None:  # type: ignore[no-untyped-def]
    with (
        pytest.raises(ToolkitError, match=f"another process.*pid {holder.pid}.*wait"),
        scene_lock(tmp_path),
    ):
        pass


def test_a_killed_owner_frees_the_lock(tmp_path: Path, holder) -> None:  # type: ignore[no-untyped-def]
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    with scene_lock(tmp_path):
        pass


def test_the_lock_is_free_after_use_and_after_an_error(tmp_path: Path) -> None:
    for _ in range(2):
        with pytest.raises(ValueError, match="work"), scene_lock(tmp_path):
            raise ValueError("work failed")
    with (
        scene_lock(tmp_path),
        pytest.raises(ToolkitError, match=f"pid {os.getpid()}"),
        scene_lock(tmp_path),
    ):
        pass


def test_a_missing_or_unwritable_scene_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (
        pytest.raises(ToolkitError, match="missing: cannot write"),
        scene_lock(tmp_path / "missing"),
    ):
        pass
    (tmp_path / ".std").touch()  # a file where the folder should be
    with pytest.raises(ToolkitError, match="cannot write to the scene"), scene_lock(tmp_path):
        pass


@pytest.mark.skipif(os.getuid() == 0, reason="root may write anywhere")
def test_a_read_only_scene_is_named(tmp_path: Path) -> None:
    tmp_path.chmod(0o555)
    with pytest.raises(ToolkitError, match="Permission denied"), scene_lock(tmp_path):
        pass


def test_a_link_in_place_of_the_lock_is_not_written_through(tmp_path: Path) -> None:
    """A scene from a stranger must not be able to empty a file elsewhere."""
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "lock").write_text("keep")
    scene = tmp_path / "scene"
    (scene / ".std").mkdir(parents=True)
    (scene / ".std" / "lock").symlink_to(precious / "lock")
    with pytest.raises(ToolkitError, match="cannot write"), scene_lock(scene):
        pass
    (scene / ".std" / "lock").unlink()
    (scene / ".std").rmdir()
    (scene / ".std").symlink_to(precious)
    with pytest.raises(ToolkitError, match="symbolic link"), scene_lock(scene):
        pass
    assert (precious / "lock").read_text() == "keep"


def test_a_writer_works_on_what_the_last_one_left(tmp_path: Path) -> None:
    camera = CameraModel(width=64, height=48, fx=60, fy=60, cx=32, cy=24)
    info = SceneInfo(name="shared", cameras={"color": camera})
    one = Scene.create(tmp_path / "scene", info, Frames(frames=[]))
    other = Scene.open(one.root)
    with one.lock():
        one.save_info(msgspec.structs.replace(info, source="one"))
    with other.lock():
        assert other.info.source == "one"


def test_whoever_asks_who_writes_keeps_nobody_from_writing(tmp_path: Path) -> None:
    """It holds the lock for a moment, in another process."""
    (tmp_path / ".std").mkdir()
    with (tmp_path / ".std" / "lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_SH)
        threading.Timer(0.005, lambda: fcntl.flock(file, fcntl.LOCK_UN)).start()
        with scene_lock(tmp_path):
            assert lock_holder(tmp_path, "lock") != ""
    assert lock_holder(tmp_path, "lock") == ""
