"""Pages know their data: where frames come from, which data sets differ, which rows lack frames."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import msgspec
import pytest

from benchmark.cli.bench import main as bench
from benchmark.cli.report import PAGE, main
from benchmark.data.provenance import Provenance, provenance_of
from benchmark.data.splits import open_split
from benchmark.evaluation.engine import run_all
from benchmark.evaluation.tasks.depth_results import depth_records, read_results
from benchmark.report.leaderboard import PUBLISHED, make_board
from benchmark.report.page import make_parts
from sensors.simulation.options import PRESETS
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.bench_set import SPLIT, a_run, published_as, write_split
from tests.benchmark.evaluation.pose_set import SIZE, a_pose_run, write_pose_split

SERIAL = JobOptions(engine="serial", progress=False)
TEST = "dreds-catknown-test"
HERE = "tests.benchmark.evaluation.bench_set"


def mark_simulated(root: Path, scenes: int) -> None:
    """Write the records of std-sim, as far as they matter here."""
    for i in range(scenes):
        record = {
            "format": "std-sim-scene",
            "version_of_tool": "0.2.0",
            "seed": 40 + i,
            "sensor": "d415",
            "width": SIZE[0],
            "height": SIZE[1],
            "K": [[67.0, 0, 47.5], [0, 67.0, 26.5], [0, 0, 1]],
            "parameters": {"options": {"quality": "draft"}},
        }
        path = root / "parameters/test" / f"{i + 1}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(record))


def origin(root: Path, split: str) -> Provenance:
    return provenance_of(open_split(split, root), split)


def test_frames_are_published_ones_only_if_all_are_there(tmp_path: Path) -> None:
    root = write_split(tmp_path, scenes=2, frames=3)
    with published_as(6, 2):
        assert origin(root, SPLIT).kind == "published"
    with published_as(6, 3):
        assert origin(root, SPLIT).kind == "unknown"
    with published_as(7, 2):
        assert origin(root, SPLIT).kind == "unknown"
    with published_as(6, 2):
        (root / "simulation.json").write_text("{}")
        assert origin(root, SPLIT) == Provenance(
            about="simulation.json or parameters/ of std-sim lies there"
        )
        (root / "simulation.json").unlink()
        next(root.rglob("0001_mask.png")).unlink()
        assert origin(root, SPLIT).kind == "unknown"


def test_simulated_frames_say_version_and_seeds(tmp_path: Path) -> None:
    root = write_pose_split(tmp_path, scenes=3)
    mark_simulated(root, 3)
    found = origin(root, TEST)
    assert found.kind == "simulated"
    assert re.fullmatch(r"std-sim 0\.2\.0, d415, options [0-9a-f]{8}, seeds 40 to 42", found.about)
    usual = msgspec.to_builtins(PRESETS["tiny"].options)
    for options, told in (
        (usual, "preset tiny"),
        (usual | {"views": 2}, "preset tiny with views 2"),
        (usual | {"quality": "<script>"}, "preset tiny with quality other"),
        ({**usual, "unheard": 1}, r"options [0-9a-f]{8}"),
        (dict.fromkeys(usual, 1), r"options [0-9a-f]{8}"),
    ):
        for path in (root / "parameters/test").iterdir():
            record = json.loads(path.read_text()) | {"parameters": {"options": options}}
            path.write_text(json.dumps(record))
        about = origin(root, TEST).about
        assert re.fullmatch(rf"std-sim 0\.2\.0, d415, {told}, seeds 40 to 42", about), about
    (root / "parameters/test/2.json").unlink()
    assert origin(root, TEST) == Provenance(about="2 of 3 scenes simulated")


@pytest.mark.parametrize(
    ("source", "kind"),
    [
        ("simulated:d415", "simulated"),
        ("synthetic", "simulated"),
        ("import:folder", "own recording"),
        ("import:bop", "unknown"),
    ],
)
def test_a_scene_tells_its_source(tmp_path: Path, source: str, kind: str) -> None:
    from benchmark.data.splits import SceneFiles

    (tmp_path / "scene.json").write_text(json.dumps({"source": source, "more": 1}))

    class Scenes:
        def files(self) -> list[SceneFiles]:
            return [SceneFiles("a", str(tmp_path), 3, {})]

    assert provenance_of(Scenes(), "scenes").kind == kind  # type: ignore[arg-type]


def test_simulated_frames_bear_no_published_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = write_pose_split(tmp_path / "data", scenes=2, frames=2)
    mark_simulated(root, 2)
    words = ["--data", str(root), "--split", TEST, "--out", str(tmp_path / "out")]
    words += ["--engine", "serial", "--no-gallery"]
    assert bench([*words, "--method", "raw", "--no-speed", "--limit", "3"]) == 0
    assert bench(["pose", *words, "--method", "gt-nocs", "--limit", "3"]) == 0
    assert f"std-sim:{TEST}, protocol strict" in capsys.readouterr().out
    assert main([str(tmp_path / "out")]) == 0
    page = (tmp_path / "out" / PAGE).read_text()
    assert f"std-sim:{TEST}, protocol strict: 3 of 4 frames, simulated" in page
    assert "19,380" not in page and 'class="published"' not in page
    assert "seeds 40 to 41" in page  # in the table of runs
    rows = (tmp_path / "out/leaderboard.csv").read_text()
    assert "simulated (std-sim 0.2.0" in rows and PUBLISHED not in rows.splitlines()[1]


def test_different_data_of_one_name_are_never_ranked_together(tmp_path: Path) -> None:
    roots = [write_pose_split(tmp_path / name, scenes=1) for name in ("one", "two")]
    for path in roots[1].rglob("*_simDepthImage.exr"):
        shutil.copyfile(path.with_name(path.name.replace("_simDepthImage", "_depth_120")), path)
    made = {0: ("raw", "nearest"), 1: ("raw",)}
    for i, methods in made.items():
        runs = [a_run(roots[i], tmp_path / f"r{i}", m, split=TEST, gallery=False) for m in methods]
        assert not run_all(runs, SERIAL).failed
        assert not run_all([a_pose_run(roots[i], tmp_path / f"r{i}", gallery=False)], SERIAL).failed
    folders = [tmp_path / "r0", tmp_path / "r1"]
    board = make_board(read_results(folders), samples=10)
    places = dict.fromkeys(board.rows["split"])
    assert len(places) == 2, places
    assert all(re.fullmatch(rf"{TEST}@[0-9a-f]{{6}}", p) for p in places)
    one, two = (board.main_rows(place, "strict") for place in places)
    assert set(one["method"]) == {"raw", "nearest"} and two["method"].tolist() == ["raw"]
    assert two.loc[0, "rmse"] == 0 < one["rmse"].min()
    for part in make_parts(folders):
        assert len(set(re.findall(rf"{TEST}@[0-9a-f]{{6}}, protocol strict", part.terminal))) == 2
    alone = make_board(read_results(folders[:1]), samples=10)
    assert set(alone.rows["split"]) == {TEST}


def test_a_submission_without_some_frames_pays_and_is_not_ranked(tmp_path: Path) -> None:
    root = write_split(tmp_path / "data")
    made = a_run(root, tmp_path / "a", save_depth=True, gallery=False)
    assert not run_all([made], SERIAL).failed
    files = sorted((made.folder / "depth").rglob("*.exr"))
    for path in files[::3]:
        path.unlink()
    run = a_run(
        root, tmp_path / "b", "raw", label="submission",
        depth_from=made.folder / "depth", gallery=False,
    )  # fmt: skip
    report = run_all([run], SERIAL)
    assert report.failed_frames == 4
    board = make_board(read_results([tmp_path / "a", tmp_path / "b"]), samples=10)
    rows = board.main_rows(SPLIT, "strict").set_index("method")
    assert rows.loc["submission", "frames"] == rows.loc["nearest", "frames"] == 12
    assert rows["unanswered"].to_dict() == {"nearest": 0, "submission": 4}
    assert rows.loc["submission", "coverage"] < 0.7 * rows.loc["nearest", "coverage"]
    assert rows.loc["submission", "rmse"] > rows.loc["nearest", "rmse"]
    assert rows.loc["submission", "harm_opaque"] > rows.loc["nearest", "harm_opaque"]
    (part,) = make_parts([tmp_path / "a", tmp_path / "b"])
    assert part.summary.startswith("Lowest RMSE: nearest on ")
    assert re.search(r"^submission +12 \(4 unanswered\) ", part.terminal, re.M)


def test_a_run_over_fewer_frames_is_not_ranked_beside_a_whole_one(tmp_path: Path) -> None:
    root = write_split(tmp_path / "data")
    runs = [
        a_run(root, tmp_path / "r", "raw", gallery=False),
        a_run(root, tmp_path / "r", "nearest", limit=5, gallery=False),
    ]
    assert not run_all(runs, SERIAL).failed
    board = make_board(read_results([tmp_path / "r"]), samples=10)
    rows = board.main_rows(SPLIT, "strict")
    assert rows["method"].tolist() == ["raw", "nearest"]  # although nearest is better
    assert rows["unanswered"].tolist() == [0, 7]
    (part,) = make_parts([tmp_path / "r"])
    assert part.summary.startswith("Lowest RMSE: raw on ")


def test_a_method_that_failed_everywhere_has_no_figures(tmp_path: Path) -> None:
    root = write_split(tmp_path / "data", scenes=2, frames=2)
    runs = [
        a_run(root, tmp_path / "r", "raw", gallery=False),
        a_run(root, tmp_path / "r", f"{HERE}:Failing", label="Failing", gallery=False),
    ]
    assert run_all(runs, SERIAL).failed_frames == 4
    results = read_results([tmp_path / "r"])
    record = next(r for r in depth_records(results) if r["method"] == "Failing")
    assert record["rmse"] != record["rmse"] and record["d125"] != record["d125"]
    assert record["failed"] == record["frames"] == 4
    (part,) = make_parts([tmp_path / "r"])
    assert re.search(r"^Failing +4 \(4 unanswered\) +2 +failed", part.terminal, re.M)
    assert part.summary.startswith("Lowest RMSE: raw on ")


def test_a_page_of_failures_alone_says_so(tmp_path: Path) -> None:
    root = write_split(tmp_path / "data", scenes=2, frames=2)
    run_all([a_run(root, tmp_path / "r", f"{HERE}:Failing", label="F", gallery=False)], SERIAL)
    assert main([str(tmp_path / "r")]) == 0
    assert "no method answered every frame" in (tmp_path / "r" / PAGE).read_text()


def test_poses_of_a_method_that_failed_everywhere_read_failed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = write_pose_split(tmp_path / "data", scenes=2, frames=1)
    words = ["pose", "--data", str(root), "--split", TEST, "--out", str(tmp_path / "out")]
    words += ["--engine", "serial", "--no-gallery", "--method", "gt-nocs"]
    assert bench([*words, "--depth", "raw", f"nothing={root}"]) == 1
    text = capsys.readouterr().out
    assert re.search(r"gt-nocs +nothing +ransac +all +6 +failed +- ", text)
    (part,) = make_parts([tmp_path / "out"])
    assert re.search(r"^gt-nocs +nothing .* 2 \(2 unanswered\) +2 +failed", part.terminal, re.M)
