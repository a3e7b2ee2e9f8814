"""Folders that appear whole or not at all, with many processes at work on one data set."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import pytest

from sensors.output.staging import WAITING, staged_folder
from std_toolkit.errors import ToolkitError

ROUNDS = 60


def write_scenes(out: Path, worker: int) -> int:
    """Own folders, and in each round one that all workers want; how often this one was first."""
    first = 0
    for k in range(ROUNDS):
        with staged_folder(out, f"scenes/{worker}-{k}") as folder:
            (folder / "file").write_text("whole")
            try:
                with staged_folder(out, f"models/{k}") as shared:
                    (shared / "model").write_text(str(k))
                first += 1
            except ToolkitError:
                pass
        assert (out / f"models/{k}/model").read_text() == str(k)
    return first


@pytest.mark.slow
def test_workers_do_not_get_in_each_other_s_way(tmp_path: Path) -> None:
    context = get_context("fork")
    with ProcessPoolExecutor(4, mp_context=context) as pool:
        firsts = list(pool.map(partial(write_scenes, tmp_path), range(4), timeout=100))
    assert sum(firsts) == ROUNDS
    assert len(list((tmp_path / "scenes").iterdir())) == 4 * ROUNDS
    assert not (tmp_path / WAITING).exists()


def test_leftovers_of_another_folder_stay(tmp_path: Path) -> None:
    left = tmp_path / WAITING / "scenes+1.0123456789ab"
    left.mkdir(parents=True)
    with staged_folder(tmp_path, "scenes/2"):
        assert left.exists()
    assert left.exists()
    with staged_folder(tmp_path, "scenes/1"):
        assert not left.exists()
    assert not (tmp_path / WAITING).exists()


def test_a_place_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("here")
    with (
        pytest.raises(ToolkitError, match="cannot write here"),
        staged_folder(tmp_path / "file", "a"),
    ):
        pass
    with pytest.raises(ToolkitError, match="in place"), staged_folder(tmp_path, "file/a"):
        pass
    with pytest.raises(ToolkitError, match="already"), staged_folder(tmp_path, "file"):
        pass
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file"]
