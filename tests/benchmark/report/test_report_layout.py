"""What authors choose: rows over training seeds, p of all pairs, the layout of papers, LaTeX."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark.cli.report import main
from benchmark.evaluation.engine import run_all
from benchmark.evaluation.tasks.depth_pictures import INDEX_FILE, Gallery
from benchmark.evaluation.tasks.depth_results import read_results
from benchmark.methods.registry import MethodOptions
from benchmark.methods.training_data import training_seed
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.report.leaderboard import make_board
from benchmark.report.page import make_parts, render_page
from benchmark.report.parts.comparisons import common_label, pair_table, seed_groups
from benchmark.report.parts.depth import SEEDS, gallery
from benchmark.report.parts.depth_comparisons import pair_tables
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import Cell, Column, Row, Table
from std_toolkit.io.documents import read_document
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.bench_set import SPLIT, a_run, write_split

JOBS = JobOptions(engine="serial", progress=False)
# Of the figures of `nearest`: mean 2, standard deviation 1.
FACTORS = {0: 1.0, 1: 2.0, 7: 3.0}


def trained(
    source: Path, target: Path, *, seed: int | None, factor: float, **setup: object
) -> None:
    """A copy of a run as one of a network trained with a seed, with all errors multiplied."""
    shutil.copytree(source, target)
    document = json.loads((target / "run.json").read_text())
    document["label"] = target.parent.name
    document["training_seed"] = seed
    document["setup"] |= {"weights_sha256": f"{seed}" * 8, **setup}
    (target / "run.json").write_text(json.dumps(document))
    path = target / "images.parquet"
    table = pd.read_parquet(path)
    for name in ("rmse", "rmse_answered"):
        table[name] *= factor
    table.to_parquet(path, index=False)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """raw, nearest, and three trainings of a network; six scenes of one frame."""
    top = tmp_path_factory.mktemp("layout")
    root = write_split(top / "data", scenes=6, frames=1)
    source = a_run(root, top / "x").open()
    names = list(map(str, source.keys()))
    wanted = (names[4], names[1])
    runs = [
        a_run(root, top / "results", "nearest", gallery_frames=wanted),
        a_run(root, top / "results", "raw", gallery=False),
    ]
    assert not run_all(runs, JOBS).failed
    folder = top / "results" / SPLIT
    for seed, factor in FACTORS.items():
        trained(
            folder / "nearest/strict", folder / f"net.seed-{seed}/strict", seed=seed, factor=factor
        )
    # Other settings, no seed, and a seed alone: none of them is one of the three.
    more = {"settings": {"a": "1"}}
    trained(folder / "nearest/strict", folder / "other.seed-0/strict", seed=0, factor=1.0, **more)
    trained(folder / "nearest/strict", folder / "unknown/strict", seed=None, factor=1.0)
    (top / "names.txt").write_text("\n".join(names))
    return top


def test_trainings_are_grouped_by_all_but_their_seed(made: Path) -> None:
    (group,) = seed_groups(read_results([made / "results"]))
    assert group.label == "net" and group.seeds == ((0,), (1,), (7,))
    assert [r.manifest.label for r in group.runs] == [f"net.seed-{s}" for s in FACTORS]


def test_rows_over_seeds_are_mean_and_deviation(made: Path) -> None:
    (part,) = make_parts([made / "results"])
    rows = pd.read_csv(pd.io.common.StringIO(part.files[SEEDS]))
    one = make_board(read_results([made / "results"]), samples=10).main_rows(SPLIT, "strict")
    nearest = float(one.loc[one["method"] == "nearest", "rmse"].iloc[0])
    row = rows[rows["of"].str.contains("all objects")].iloc[0]
    assert (row["method"], row["trainings"], row["seeds"]) == ("net", 3, "0, 1, 7")
    assert row["rmse"] == pytest.approx(2 * nearest)
    assert row["rmse_sd"] == pytest.approx(nearest)
    assert row["mae_sd"] == pytest.approx(0)
    told = f"{2000 * nearest:.1f} ± {1000 * nearest:.1f}"
    assert told in part.terminal and told in render_page([part])


def test_the_seed_is_that_of_the_training(tmp_path: Path) -> None:
    weights = tmp_path / "best.safetensors"
    weights.write_bytes(b"")
    options = MethodOptions(weights=weights)
    assert training_seed("net", object(), options) is None
    (tmp_path / "best.md").write_text("# A card\n\n| seed | 5 |\n")
    assert training_seed("net", object(), options) == 5
    (tmp_path / "config.json").write_text('{"seed": 12, "method": "net"}')
    assert training_seed("net", object(), options) == 12
    assert training_seed("net", None, options) is None


@pytest.mark.parametrize(
    ("labels", "shared"),
    [(["a", "a"], "a"), (["s1", "s2"], "s"), (["x1", "y1"], ""), (["net+3", "net+4"], "net")],
)
def test_labels_are_told_by_what_they_share(labels: list[str], shared: str) -> None:
    assert common_label(labels) == shared


def test_all_pairs_are_tested_over_scenes(made: Path) -> None:
    board = make_board(read_results([made / "results"]), samples=10)
    (table,) = pair_tables(board, SPLIT, "strict", "scenes")
    names = [row.cells[0].text for row in table.rows]
    at = {name: i for i, name in enumerate(names)}
    a, b = at["net.seed-0"], at["net.seed-7"]
    # Worse in each of six scenes: 2 / 2**6, of which Holm makes at least twice as much.
    count = len(names) * (len(names) - 1) // 2
    p = table.rows[max(a, b)].cells[min(a, b) + 1].value
    assert 2 / 64 <= p <= min(1, count * 2 / 64)
    means = board.main_rows(SPLIT, "strict").set_index("method")["rmse"]
    shown = table.rows[min(a, b)].cells[max(a, b) + 1].value
    sign = -1 if a < b else 1
    assert shown == pytest.approx(sign * (means["net.seed-7"] - means["net.seed-0"]))
    # Equal methods: no difference, p 1.
    c, d = sorted((at["nearest"], at["unknown"]))
    assert table.rows[c].cells[d + 1].value == 0 and table.rows[d].cells[c + 1].value == 1


def test_p_is_corrected_for_all_pairs() -> None:
    column = Column(heading="RMSE", unit="mm", name="rmse", factor=1000)
    found = [(-0.001, 0.01), (-0.002, 0.04), None]
    (table,) = pair_table(["a", "b", "c"], found, column, title="t", test="A test.")
    cells = [[cell.text for cell in row.cells] for row in table.rows]
    assert cells == [
        ["a", "", "−1.0", "−2.0"],
        ["b", "0.020", "", "–"],
        ["c", "0.040", "–", ""],
    ]
    assert table.rows[1].cells[1].mark == "best"
    assert not pair_table(["a"], [], column, title="t", test="")


def test_pairs_over_frames_of_one_scene(made: Path) -> None:
    """Six frames in one scene: no pair over scenes, all pairs over frames."""
    results = read_results([made / "results"])
    results = [r for r in results if r.manifest.label in ("nearest", "net.seed-7")]
    for r in results:
        r.table["frame"] = r.table["scene"] + r.table["frame"]
        r.table["scene"] = "one"
    board = make_board(results, samples=10)
    assert not pair_tables(board, SPLIT, "strict", "scenes")
    (table,) = pair_tables(board, SPLIT, "strict", "frames")
    assert table.rows[1].cells[1].value == pytest.approx(2 / 64)


def test_the_layout_of_papers(made: Path, tmp_path: Path) -> None:
    words = ["report", str(made / "results"), "--out", str(tmp_path), "--layout", "paper"]
    assert main([*words, "--latex-rows", "nearest", "--latex-columns", "rmse", "mae"]) == 0
    board = make_board(read_results([made / "results"]), samples=10)
    grid, _ = get_protocol("strict").main
    pair = [
        board.part(SPLIT, "strict", grid, subset).set_index("method").loc["nearest", "rmse"]
        for subset in ("all", "specular+transparent")
    ]
    assert all(map(math.isfinite, pair)) and pair[0] != pair[1]
    told = f"{1000 * pair[0]:.1f} / {1000 * pair[1]:.1f}"
    (line,) = [
        x for x in (tmp_path / "leaderboard.md").read_text().splitlines() if "| nearest |" in x
    ]
    assert told in line and line.startswith(f"| {SPLIT} |")
    latex = (tmp_path / "leaderboard.tex").read_text()
    rows = [x for x in latex.splitlines() if " & " in x and "method" not in x]
    assert len(rows) == 1 and rows[0].startswith(f"{SPLIT} & nearest & {told} & ")
    assert rows[0].count("&") == 3 and "RMSE" in latex and "REL" not in latex


WRONG = {
    "row": (["--latex-rows", "swin"], "--latex-rows: no table has it (got 'swin')"),
    "column": (["--latex-columns", "rsme"], "--latex-columns: no table has it (got 'rsme')"),
    "picture": (["--gallery", "a/1"], "--gallery: no run has a picture"),
    "layout": (["--layout", "papers"], "--layout"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_names_are_one_line(
    case: str, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words, said = WRONG[case]
    assert main(["report", str(made / "results"), "--out", str(tmp_path / "o"), *words]) != 0
    told = capsys.readouterr().err
    assert len([x for x in told.splitlines() if said in x]) == 1 and "Traceback" not in told
    assert not (tmp_path / "o" / "report.html").exists()


def test_pictures_are_of_the_frames_that_were_named(made: Path) -> None:
    names = (made / "names.txt").read_text().split("\n")
    index = made / "results" / SPLIT / "nearest/strict/gallery" / INDEX_FILE
    found = [
        f"{p.scene}/{p.frame}" for p in read_document(index, Gallery).pictures if p.rank == "common"
    ]
    assert found == [names[4], names[1]]
    results = [r for r in read_results([made / "results"]) if r.manifest.label == "nearest"]
    heads = [b.text for b in gallery(results, (names[1],)) if type(b).__name__ == "Heading"]
    assert heads == [f"{SPLIT} {names[1]}, strict"]


def test_a_frame_that_the_run_lacks_is_refused(made: Path, tmp_path: Path) -> None:
    run = a_run(made / "data", tmp_path, "nearest", gallery_frames=("test_9/0000",))
    with pytest.raises(ToolkitError, match="the run has no such frame"):
        run.pictured(run.open())


def test_columns_of_a_table_are_chosen() -> None:
    columns = [
        Column(heading="method", numeric=False), Column(heading="RMSE", name="rmse"),
        Column(heading="MAE", name="mae"), Column(heading="notes", numeric=False),
    ]  # fmt: skip
    rows = [
        Row([Cell(text=t) for t in line]) for line in (("a", "1", "2", "x"), ("b", "3", "4", "y"))
    ]
    table = Table(columns=columns, rows=rows)
    chosen = table.chosen(["b"], ["mae", "rmse"])
    assert chosen is not None
    assert [c.heading for c in chosen.columns] == ["method", "MAE", "RMSE", "notes"]
    assert [[c.text for c in row.cells] for row in chosen.rows] == [["b", "4", "3", "y"]]
    assert table.chosen(["c"], []) is None and table.chosen([], ["rel"]) is None
    assert np.array_equal(table.without("notes").columns, columns[:3])
