"""A run knows its data by content: what changed under the same names is scored anew."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pandas as pd
import pytest

from benchmark.data import identity
from benchmark.evaluation.engine import run_all, run_task
from benchmark.evaluation.known_data import CONTENT_FILE, DATA_FILE
from benchmark.evaluation.results import TABLE, read_known
from benchmark.evaluation.tasks.bop import BopRun
from benchmark.metrics.bop import BopEstimate, write_bop_results
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.bench_set import a_run, write_split
from tests.benchmark.evaluation.pose_set import a_pose_run, write_pose_split
from tests.benchmark.metrics.bop.bop_set import TRUTHS, write_bop

SERIAL = JobOptions(engine="serial", progress=False)


def use_true_depth(root: Path, scene: str = "*") -> int:
    """Put the true depth in the place of the raw depth; returns the number of frames."""
    paths = sorted(root.rglob(f"{scene}/*_simDepthImage.exr"))
    for path in paths:
        shutil.copyfile(path.with_name(path.name.replace("_simDepthImage", "_depth_120")), path)
    return len(paths)


def test_changed_depth_is_scored_anew(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    root = write_pose_split(tmp_path / "data", scenes=2, frames=2)
    run = a_run(root, tmp_path / "out", "raw", split="dreds-catknown-test")
    before = run_task(run, SERIAL)
    assert before.loc[0, "rmse"] > 0.05
    use_true_depth(root, "2")
    table = run_task(run, SERIAL)
    assert "raw depth of 2/0000, 2/0001" in caplog.text
    again = run_task(a_run(root, tmp_path / "anew", "raw", split=run.split), SERIAL)
    pd.testing.assert_frame_equal(table, again)
    changed = table["scene"] == "2"
    assert (table.loc[changed, "rmse"].dropna() == 0).all()
    pd.testing.assert_frame_equal(table[~changed], before[before["scene"] != "2"])


def test_changed_truth_of_poses_is_scored_anew(tmp_path: Path) -> None:
    root = write_pose_split(tmp_path / "data", scenes=1, frames=2)
    run = a_pose_run(root, tmp_path / "out", gallery=False)
    before = run_task(run, SERIAL)
    use_true_depth(root)
    table = run_task(run, SERIAL)
    assert not table.equals(before)
    pd.testing.assert_frame_equal(table, run_task(a_pose_run(root, tmp_path / "anew"), SERIAL))
    box = next((root / "cad_model").rglob("bbox.txt"))
    (box.parent / "bbox.txt").write_text("0.6 0.5 0.4\n-0.6 -0.5 -0.4\n")
    then = read_known(run.folder).content
    run_task(run, SERIAL)
    now = read_known(run.folder).content
    assert set(identity.changed_content(then, now)["content"]) == {f"bbox.txt of {box.parent.name}"}


def scored_bop(root: Path, results: Path, out: Path) -> tuple[dict[str, str], float]:
    """Errors of a run, and its precision."""
    run = BopRun(data=root, split="test", results=results, out=out)
    failed = run_all([run], SERIAL).failed
    return failed, json.loads((run.folder / "bop.json").read_text())["ap"]


@pytest.mark.parametrize("listed", [True, False], ids=["targets are listed", "targets change, too"])
def test_changed_visibility_of_bop_is_scored_anew_or_refused(
    tmp_path: Path, listed: bool, caplog: pytest.LogCaptureFixture
) -> None:
    root = write_bop(tmp_path / "set")
    if not listed:
        (root / "test_targets_bop19.json").unlink()
    path = tmp_path / "mine_set-test.csv"
    write_bop_results(path, [BopEstimate(2, 4, n, 1.0, T, 0.5) for n, T in TRUTHS[4]])
    failed, before = scored_bop(root, path, tmp_path / "out")
    assert not failed
    info = root / "test/000002/scene_gt_info.json"
    shares = json.loads(info.read_text())
    shares["3"][1]["visib_fract"] = 0.05  # one instance less is to be detected
    info.write_text(json.dumps(shares))
    failed, after = scored_bop(root, path, tmp_path / "out")
    assert "scene_gt_info.json of 000002/000003" in caplog.text
    right = scored_bop(root, path, tmp_path / "anew")[1]
    assert right != before
    if listed:
        assert not failed and after == right
    else:
        (told,) = failed.values()
        assert "setup.targets" in told and "choose another --out" in told


def test_a_second_run_reads_no_file_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(identity, "_SETTLED_S", -1.0)
    root = write_split(tmp_path / "data", scenes=1, frames=2)
    run_task(a_run(root, tmp_path / "out"), SERIAL)
    read: list[Path] = []
    digest = identity.digest_file

    def counted(path: Path) -> str:
        read.append(path)
        return digest(path)

    monkeypatch.setattr(identity, "digest_file", counted)
    run_task(a_run(root, tmp_path / "out"), SERIAL)
    run_task(a_run(root, tmp_path / "out", "raw"), SERIAL)
    assert read == []
    mask = next(root.rglob("0001_mask.png"))
    status = mask.stat()
    mask.write_bytes(mask.read_bytes())  # the same content at another time
    os.utime(mask, ns=(status.st_atime_ns, status.st_mtime_ns))
    run_task(a_run(root, tmp_path / "out"), SERIAL)
    assert read == [mask]


def test_a_damaged_cache_costs_time_alone(tmp_path: Path) -> None:
    root = write_split(tmp_path / "data", scenes=1, frames=2)
    first = run_task(a_run(root, tmp_path / "out"), SERIAL)
    (tmp_path / "out/.digests.json").write_bytes(b"\xff[")
    pd.testing.assert_frame_equal(run_task(a_run(root, tmp_path / "out"), SERIAL), first)


def test_results_that_do_not_know_their_data_are_scored_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    root = write_split(tmp_path / "data", scenes=1, frames=2)
    run = a_run(root, tmp_path / "out")
    whole = run_task(run, SERIAL)
    for name in (DATA_FILE, CONTENT_FILE):
        (run.folder / name).unlink()
    wrong = whole.assign(rmse=9.0)
    wrong.to_parquet(run.folder / TABLE, index=False)
    pd.testing.assert_frame_equal(run_task(run, SERIAL), whole)
    assert "do not say what data they are of" in caplog.text


def test_pictures_of_changed_frames_are_made_again(tmp_path: Path) -> None:
    root = write_pose_split(tmp_path / "data", scenes=1, frames=2)
    run = a_run(root, tmp_path / "out", "raw", split="dreds-catknown-test")
    assert not run_all([run], SERIAL).failed
    gallery = run.folder / "gallery/gallery.json"
    before = json.loads(gallery.read_text())["pictures"]
    use_true_depth(root)
    assert not run_all([run], SERIAL).failed
    assert max(p["rmse"] for p in json.loads(gallery.read_text())["pictures"]) == 0
    assert max(p["rmse"] for p in before) > 0


def test_saved_depth_that_changed_is_scored_anew(tmp_path: Path) -> None:
    root = write_split(tmp_path / "data", scenes=1, frames=2)
    made = a_run(root, tmp_path / "made", save_depth=True)
    run_task(made, SERIAL)
    saved = made.folder / "depth"
    run = a_run(root, tmp_path / "out", "raw", label="saved", depth_from=saved)
    first = run_task(run, SERIAL)
    one, two = sorted(saved.rglob("*.exr"))
    shutil.copyfile(one, two)
    table = run_task(run, SERIAL)
    assert not table.equals(first)
    data, answers = (read_known(r.folder).record for r in (made, run))
    assert data is not None and answers is not None
    assert data.digest == answers.digest, "saved depth is no part of the data set"


class WithoutFiles:
    """A source of somebody else, which does not name its files."""

    def __init__(self, source: object) -> None:
        self.source = source

    def load(self, index: int, *, nocs: bool = False) -> object:
        return self.source.load(index, nocs=nocs)  # type: ignore[attr-defined]


def test_frames_without_named_files_are_known_by_their_arrays(tmp_path: Path) -> None:
    from benchmark.data.splits import inputs_of, open_split

    root = write_pose_split(tmp_path / "data", scenes=1, frames=2)
    source = WithoutFiles(open_split("dreds-catknown-test", root))
    first = inputs_of(source, 0)  # type: ignore[arg-type]
    assert set(first) == {"frame"} and first != inputs_of(source, 1)  # type: ignore[arg-type]
    assert first == inputs_of(source, 0)  # type: ignore[arg-type]
    use_true_depth(root)
    assert first != inputs_of(source, 0)  # type: ignore[arg-type]


def test_every_source_names_the_files_that_it_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is opened for reading while a frame is loaded is among its inputs."""
    import sys

    from benchmark.data.splits import inputs_of, open_split
    from tests.dreds_on_disk import write_cleargrasp_real

    write_cleargrasp_real(tmp_path / "real-val/d435", frames=2)
    roots = {
        "dreds-catknown-test": write_pose_split(tmp_path / "dreds", scenes=1),
        "std-catknown": write_split(tmp_path / "std", scenes=1, frames=1),
        "cleargrasp-real-known": tmp_path,
    }
    opened: set[str] = set()
    watching = [False]

    def watch(event: str, args: tuple[object, ...]) -> None:
        if watching[0] and event == "open" and isinstance(args[0], str):
            opened.add(args[0])

    sys.addaudithook(watch)
    for split, root in roots.items():
        source = open_split(split, root)
        opened.clear()
        watching[0] = True
        source.load(0, nocs=True)
        watching[0] = False
        inside = {p for p in opened if p.startswith(str(root)) and Path(p).is_file()}
        named = {str(p) for p in inputs_of(source, 0, nocs=True).values()}
        assert inside and inside <= named, (split, inside - named)
