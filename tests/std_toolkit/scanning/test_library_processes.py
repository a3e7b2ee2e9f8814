"""Scans of all objects as processes: killed and run again, and two into one folder at once."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("manifold3d")

from std_toolkit.io.documents import digest_file, read_document
from std_toolkit.scanning.library import Library
from tests.std_toolkit.scanning.boxes import write_photos_on_board

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

_LONGEST_S = 600


@pytest.fixture(scope="module")
def words(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("boxes")
    board = write_photos_on_board(folder / "photos")
    return [
        sys.executable, "-m", "std_toolkit.cli.scanning", str(folder / "photos"), "--board",
        str(board), "--all", "--names", "large", "small", "--voxels", "40", "--faces", "600",
        "--texture", "64", "--neighbours", "3", "--engine", "serial", "--out",
    ]  # fmt: skip


def wait_for(started: subprocess.Popen[str], condition: object) -> None:
    end = time.monotonic() + _LONGEST_S
    while not condition():  # type: ignore[operator]
        assert started.poll() is None, started.communicate()[1]
        assert time.monotonic() < end
        time.sleep(0.05)


def states(out: Path) -> list[tuple[str, str]]:
    if not (out / "library.json").is_file():
        return []
    return [(o.name, o.status) for o in read_document(out / "library.json", Library).objects]


def begin(words: list[str], out: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*words, str(out)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.mark.long
def test_a_run_that_is_killed_resumes_and_loses_nothing(words: list[str], tmp_path: Path) -> None:
    out = tmp_path / "things"
    first = begin(words, out)
    wait_for(first, lambda: ("large", "done") in states(out))
    first.kill()
    first.communicate()
    assert states(out) == [("large", "done"), ("small", "waiting")]
    assert (out / "preview.ply").is_file()
    model = {p: (p.stat().st_mtime_ns, digest_file(p)) for p in (out / "large").iterdir()
             if p.is_file()}  # fmt: skip
    assert {p.name for p in model} >= {"large.obj", "large.glb", "report.html", "scan.json"}

    again = subprocess.run([*words, str(out)], capture_output=True, text=True, timeout=_LONGEST_S)
    assert again.returncode == 0, again.stderr
    assert "large: kept" in again.stderr
    assert states(out) == [("large", "done"), ("small", "done")]
    assert {p: (p.stat().st_mtime_ns, digest_file(p)) for p in model} == model
    assert (out / "small/small.obj").is_file()
    assert "small/report.html" in (out / "report.html").read_text()
    # A first look is of no use beside the models.
    assert not (out / "preview.ply").exists()


def test_a_second_run_into_the_same_folder_is_refused(words: list[str], tmp_path: Path) -> None:
    out = tmp_path / "things"
    first = begin(words, out)
    try:
        wait_for(first, lambda: (out / ".scan").is_dir())
        second = subprocess.run(
            [*words, str(out)], capture_output=True, text=True, timeout=_LONGEST_S
        )
        assert first.poll() is None
    finally:
        first.kill()
        first.communicate()
    assert second.returncode == 1
    (line,) = second.stderr.strip().splitlines()
    assert line.startswith("error:")
    assert "another process" in line
    assert str(out) in line
