"""A file is the old one or the new one, whatever happens while it is written."""

from __future__ import annotations

import errno
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import atomic_path, sweep_temporaries, write_bytes_atomic


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.rglob("*"))


def test_a_file_appears_complete_and_alone(tmp_path: Path) -> None:
    write_bytes_atomic(tmp_path / "new" / "a.bin", b"content")
    assert (tmp_path / "new" / "a.bin").read_bytes() == b"content"
    assert names(tmp_path) == ["a.bin", "new"]


@pytest.mark.parametrize("failure", [ValueError, KeyboardInterrupt, SystemExit])
def test_a_failing_writer_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, failure: type[BaseException]
) -> None:
    (tmp_path / "a.bin").write_bytes(b"old")
    with pytest.raises(failure), atomic_path(tmp_path / "a.bin") as temporary:
        temporary.write_bytes(b"half of the n")
        raise failure
    assert (tmp_path / "a.bin").read_bytes() == b"old"
    assert names(tmp_path) == ["a.bin"]


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_a_full_disk_leaves_the_old_file_and_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    def fail(*args: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    (tmp_path / "a.bin").write_bytes(b"old")
    monkeypatch.setattr(os, "fsync", fail) if step == "fsync" else monkeypatch.setattr(
        Path, "replace", fail
    )
    with pytest.raises(ToolkitError, match=r"a\.bin: cannot write the file: No space left"):
        write_bytes_atomic(tmp_path / "a.bin", b"new")
    assert (tmp_path / "a.bin").read_bytes() == b"old"
    assert names(tmp_path) == ["a.bin"]


def test_a_writer_that_writes_nothing_is_an_error(tmp_path: Path) -> None:
    with (
        pytest.raises(ToolkitError, match=r"a\.bin: cannot write"),
        atomic_path(tmp_path / "a.bin"),
    ):
        pass


def test_a_folder_or_a_file_in_the_way_is_named(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(ToolkitError, match="folder: cannot write the file: Is a directory"):
        write_bytes_atomic(tmp_path / "folder", b"")
    (tmp_path / "file").touch()
    with pytest.raises((ToolkitError, OSError), match="file"):
        write_bytes_atomic(tmp_path / "file" / "a.bin", b"")
    assert names(tmp_path) == ["file", "folder"]


def test_an_error_at_another_file_is_not_blamed_on_this_one(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="other"), atomic_path(tmp_path / "a.bin"):
        (tmp_path / "other").read_bytes()


def test_a_link_is_replaced_and_its_target_untouched(tmp_path: Path) -> None:
    (tmp_path / "precious").write_bytes(b"keep")
    (tmp_path / "a.bin").symlink_to(tmp_path / "precious")
    write_bytes_atomic(tmp_path / "a.bin", b"new")
    assert (tmp_path / "precious").read_bytes() == b"keep"
    assert not (tmp_path / "a.bin").is_symlink()


def test_long_names_are_no_problem(tmp_path: Path) -> None:
    write_bytes_atomic(tmp_path / ("n" * 250 + ".png"), b"x")
    assert len(names(tmp_path)) == 1


def test_the_temporary_keeps_the_suffix(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "map.exr") as temporary:
        assert temporary.suffix == ".exr"
        assert temporary.parent == tmp_path
        temporary.write_bytes(b"x")


def test_only_temporaries_are_swept(tmp_path: Path) -> None:
    ours = [".map.0123456789ab.tmp.exr", ".scene.0123456789ab.tmp.json", ".lock.fedcba987654.tmp"]
    others = [
        ".std",
        "a.tmp",
        ".notes.tmp",
        ".map.0123456789AB.tmp.exr",
        ".x.0123456789ab.tmp.exr~",
    ]
    (tmp_path / "gt" / "deep").mkdir(parents=True)
    for name in ours + others:
        (tmp_path / "gt" / "deep" / name).touch()
    (tmp_path / ".folder.0123456789ab.tmp").mkdir()
    swept = sweep_temporaries(tmp_path)
    assert sorted(p.name for p in swept) == sorted(ours)
    assert {p.name for p in (tmp_path / "gt" / "deep").iterdir()} == set(others)


def test_sweeping_does_not_leave_the_folder(tmp_path: Path) -> None:
    outside = tmp_path / "outside" / ".a.0123456789ab.tmp"
    outside.parent.mkdir()
    outside.touch()
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "link").symlink_to(outside.parent)
    (tmp_path / "scene" / ".b.0123456789ab.tmp").symlink_to(outside)
    assert len(sweep_temporaries(tmp_path / "scene")) == 1
    assert outside.exists()


WRITER = """
import sys
from pathlib import Path
from std_toolkit.io.atomic import write_bytes_atomic
folder = Path(sys.argv[1])
print("ready", flush=True)
n = 0
while True:
    for name in ("a.bin", "b.bin"):
        write_bytes_atomic(folder / name, bytes([n % 256]) * 300_000)
    n += 1
"""


@pytest.mark.slow
def test_kill_9_at_random_moments_never_tears_a_file(tmp_path: Path) -> None:
    moments = random.Random(0)
    swept = 0
    for _ in range(12):
        process = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE
        )
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(moments.uniform(0.0, 0.08))
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        swept += len(sweep_temporaries(tmp_path))
        for path in tmp_path.iterdir():
            data = path.read_bytes()
            assert len(data) == 300_000
            assert len(set(data)) == 1
    assert swept > 0  # else the moments were badly chosen and nothing was tested
    assert names(tmp_path) == ["a.bin", "b.bin"]
