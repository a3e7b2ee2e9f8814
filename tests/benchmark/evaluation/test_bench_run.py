"""One method over one split: complete, resumable, the same however it was interrupted."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark.data.splits import open_split
from benchmark.evaluation.batches import chosen_frames
from benchmark.evaluation.engine import run_all, run_task
from benchmark.evaluation.frames import answers_one_by_one
from benchmark.evaluation.results import FAILURES, TABLE, write_part
from benchmark.methods.depth.full_size import view_of
from benchmark.methods.registry import MethodOptions
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.metrics.protocols.score import score_frame
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.bench_set import SPLIT, a_run, write_split

SERIAL = JobOptions(engine="serial", progress=False)
HERE = "tests.benchmark.evaluation.bench_set"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_split(tmp_path_factory.mktemp("data"))


def own(name: str, **settings: str) -> dict[str, object]:
    return {"method": f"{HERE}:{name}", "label": name, "options": MethodOptions(settings=settings)}


def test_every_frame_has_every_row_of_the_protocol(root: Path, tmp_path: Path) -> None:
    table = run_task(a_run(root, tmp_path, "raw"), SERIAL)
    protocol = get_protocol("strict")
    source = open_split(SPLIT, root)
    fixed = table[~table["subset"].str.startswith("depth:")]
    assert len(fixed) == len(source) * len(protocol.grids) * len(protocol.subsets)
    frames = [source.load(i) for i in range(len(source))]
    # Raw depth has twice the size of the ground truth here; every method sees it at that size.
    seen = [view_of(frame, None).depth for frame in frames]
    figures = pd.DataFrame(
        row.as_dict()
        for depth, frame in zip(seen, frames, strict=True)
        for row in score_frame(depth, frame, protocol)
    )
    pd.testing.assert_frame_equal(table[figures.columns], figures, check_dtype=False)
    assert (table["error"] == "").all()


def test_the_paper_protocol_makes_the_views(root: Path, tmp_path: Path) -> None:
    """The method sees 224x224, whatever the size of the data."""
    table = run_task(a_run(root, tmp_path, protocol="paper", **own("Filling")), SERIAL)
    frame = open_split(SPLIT, root).load(0)
    answer = np.full((224, 224), 0.7, np.float32)
    rows = score_frame(answer, frame, get_protocol("paper"))
    assert table.loc[0, "rmse"] == rows[0].errors.rmse


@pytest.mark.slow
def test_the_table_is_the_same_however_work_is_spread(root: Path, tmp_path: Path) -> None:
    tables = [
        run_task(a_run(root, tmp_path / str(i)), jobs)
        for i, jobs in enumerate((SERIAL, JobOptions(workers=2, progress=False)))
    ]
    pd.testing.assert_frame_equal(*tables)
    files = [(tmp_path / str(i) / SPLIT / "nearest/strict" / TABLE).read_bytes() for i in (0, 1)]
    assert files[0] == files[1]


def test_what_is_scored_is_not_scored_again(root: Path, tmp_path: Path) -> None:
    log = tmp_path / "log"
    run = a_run(root, tmp_path / "out", **own("Counting", log=str(log)))
    first = run_task(run, SERIAL)
    assert len(log.read_text().splitlines()) == 12
    again = run_task(run, SERIAL)
    assert len(log.read_text().splitlines()) == 12
    pd.testing.assert_frame_equal(first, again)


@pytest.mark.slow
def test_a_worker_that_dies_costs_nothing(root: Path, tmp_path: Path) -> None:
    mark = str(tmp_path / "mark")
    run = a_run(root, tmp_path / "out", **own("DiesOnce", mark=mark))
    table = run_task(run, JobOptions(workers=2, progress=False))
    assert Path(mark).exists()
    whole = run_task(a_run(root, tmp_path / "whole", **own("Filling")), SERIAL)
    pd.testing.assert_frame_equal(table, whole)


@pytest.mark.slow
def test_a_killed_run_goes_on_where_it_was(root: Path, tmp_path: Path) -> None:
    log = tmp_path / "log"
    program = (
        "import sys, time; from pathlib import Path\n"
        f"import {HERE} as s\n"
        "from benchmark.evaluation import batches, engine\n"
        "from benchmark.methods.registry import MethodOptions\n"
        "from std_toolkit.jobs import JobOptions\n"
        "batches._FLUSH_S = 0.0\n"
        "slow = s.Counting.restore\n"
        "s.Counting.restore = lambda self, views: (time.sleep(0.3), slow(self, views))[1]\n"
        f"run = s.a_run(Path({str(root)!r}), Path({str(tmp_path / 'out')!r}),\n"
        f"    method={HERE + ':Counting'!r}, label='Counting',\n"
        f"    options=MethodOptions(settings={{'log': {str(log)!r}}}))\n"
        "engine.run_task(run, JobOptions(engine='serial', progress=False))\n"
    )
    process = subprocess.Popen([sys.executable, "-c", program])
    parts = tmp_path / "out" / SPLIT / "Counting/strict/parts"
    while len(list(parts.glob("*.parquet"))) < 2:
        assert process.poll() is None, "it ended before it could be killed"
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    kept = 2 * len(list(parts.glob("0*.parquet")))
    log.unlink()
    run = a_run(root, tmp_path / "out", **own("Counting", log=str(log)))
    table = run_task(run, SERIAL)
    assert len(log.read_text().splitlines()) == 12 - kept
    whole = run_task(a_run(root, tmp_path / "whole", **own("Filling")), SERIAL)
    pd.testing.assert_frame_equal(table, whole)
    assert not list((tmp_path / "out").rglob("*.tmp*"))


def test_a_damaged_frame_is_listed_and_tried_again(tmp_path: Path) -> None:
    root = write_split(tmp_path / "data", scenes=1)
    damaged = next((tmp_path / "data").rglob("0002_gt_depth.exr"))
    content = damaged.read_bytes()
    damaged.write_bytes(content[: len(content) // 2])
    run = a_run(root, tmp_path / "out")
    table = run_task(run, SERIAL)
    assert table.loc[table["error"] != "", "frame"].tolist() == ["0002"]
    failures = pd.read_csv(run.folder / FAILURES, dtype=str)
    assert "0002_gt_depth.exr" in failures["error"][0]
    assert list(failures) == ["index", "scene", "frame", "error"]
    damaged.write_bytes(content)
    mended = run_task(run, SERIAL)
    assert (mended["error"] == "").all()
    assert pd.read_csv(run.folder / FAILURES).empty
    whole = run_task(a_run(root, tmp_path / "whole"), SERIAL)
    pd.testing.assert_frame_equal(mended, whole)


def test_a_frame_at_which_the_method_fails_counts_as_missed(root: Path, tmp_path: Path) -> None:
    source = open_split(SPLIT, root)
    depth = float(view_of(source.load(5), None).depth.max())
    run = a_run(root, tmp_path, **own("FailsAtBright", depth=repr(depth)))
    table = run_task(run, SERIAL)
    failed = table[table["error"] != ""]
    assert 5 in set(failed["index"])
    assert failed["error"].str.contains("cannot stand this frame").all()
    there = failed[failed["n_pixels"] > 0]
    assert (there["coverage"] == 0).all() and (there["d125"] == 0).all()
    # Its neighbour in the batch is scored as if nothing had been.
    good = table[(table["error"] == "")]
    whole = run_task(a_run(root, tmp_path / "whole", **own("Filling")), SERIAL)
    rest = whole[whole["index"].isin(good["index"])]
    pd.testing.assert_frame_equal(
        good.drop(columns="error").reset_index(drop=True),
        rest.drop(columns="error").reset_index(drop=True),
    )


def test_parts_of_equal_name_do_not_lose_frames(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that was killed left a part whose first and last frame failed, the others good."""
    # Both failed batches come in one piece of work, hence in one part.
    monkeypatch.setattr("benchmark.evaluation.batches._PIECES_PER_WORKER", 1)
    run = a_run(root, tmp_path)
    whole = run_task(run, SERIAL)
    (run.folder / TABLE).unlink()
    ends = whole["index"].isin([0, 1, 10, 11])
    left = whole.assign(error=np.where(ends, "a disk that was away", ""))
    write_part(run.folder, 0, 11, left.to_dict("records"))
    again = run_task(run, JobOptions(engine="serial", workers=1, progress=False))
    pd.testing.assert_frame_equal(again, whole)


def test_nan_is_counted_as_missed_and_told(root: Path, tmp_path: Path) -> None:
    table = run_task(a_run(root, tmp_path, **own("HalfNaN")), SERIAL)
    assert (table["not_finite"] > 0).all()
    assert table["coverage"].min() < 1


def test_nan_everywhere_is_a_failure(root: Path, tmp_path: Path) -> None:
    report = run_all([a_run(root, tmp_path, **own("AllNaN"), gallery=False)], SERIAL)
    assert report.failed_frames == 12  # std-bench then exits with 1
    table = run_task(a_run(root, tmp_path, **own("AllNaN")), SERIAL)
    assert table["error"].str.contains("every pixel of the answer is NaN or infinite").all()


def test_an_answer_of_another_size_is_the_methods_fault(root: Path, tmp_path: Path) -> None:
    table = run_task(a_run(root, tmp_path, **own("WrongSize")), SERIAL)
    assert table["error"].str.contains("Restored.depth").all()


def test_other_options_do_not_mix_with_what_is_there(root: Path, tmp_path: Path) -> None:
    run_task(a_run(root, tmp_path), SERIAL)
    with pytest.raises(ToolkitError, match=r"setup.batch_size.*begun with 2|begun with 2"):
        run_task(a_run(root, tmp_path, batch_size=3), SERIAL)


def test_saved_depth_scores_as_the_method_did(root: Path, tmp_path: Path) -> None:
    run = a_run(root, tmp_path, save_depth=True)
    table = run_task(run, SERIAL)
    saved = run_task(
        a_run(root, tmp_path, "raw", label="saved", depth_from=run.folder / "depth"), SERIAL
    )
    pd.testing.assert_frame_equal(table, saved)


def test_a_limit_takes_frames_evenly() -> None:
    assert chosen_frames(10, 2) == [2, 7]
    assert chosen_frames(3, 5) == [0, 1, 2]
    assert chosen_frames(100, 1) == [50]


def test_an_interrupted_method_gives_no_failed_view(root: Path) -> None:
    """Compiled code reports an interrupt within its callbacks as an error of its own."""
    view = view_of(open_split(SPLIT, root).load(0), None)

    def interrupted(views: object) -> list[object]:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as interrupt:
            raise RuntimeError("a callback failed") from interrupt

    with pytest.raises(RuntimeError, match="a callback failed"):
        answers_one_by_one(interrupted, lambda _view, _answer: None, {0: view})
