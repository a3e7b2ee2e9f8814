"""Leaderboards as text and as a page: the figures are those of the rows, published ones marked."""

from __future__ import annotations

import io
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark.cli.report import PAGE, main
from benchmark.evaluation.engine import run_all
from benchmark.evaluation.tasks.depth import TASK
from benchmark.evaluation.tasks.depth_results import read_results, summarise
from benchmark.report.leaderboard import METRICS, PUBLISHED, make_board
from benchmark.report.leaderboard_text import escape_latex, latex, markdown, terminal
from benchmark.report.parts.depth import CSV, LATEX, MARKDOWN
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.bench_set import a_run, write_split


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three methods on three scenes."""
    top = tmp_path_factory.mktemp("report")
    root = write_split(top / "data")
    out = top / "results"
    jobs = JobOptions(engine="serial", progress=False)
    runs = [a_run(root, out, method) for method in ("raw", "nearest", "telea")]
    assert not run_all(TASK, runs, jobs).failed
    return out


@pytest.mark.slow
def test_the_figures_are_the_means_of_the_rows(results: Path) -> None:
    board = make_board(read_results([results]), samples=50)
    measured = board.rows[board.rows["kind"] == "measured"]
    expected = summarise(board.tables)
    expected = expected[expected["frames"] > 0]
    keys = ["split", "protocol", "grid", "subset", "method"]
    both = measured.merge(expected, on=keys, suffixes=("", "_expected"))
    assert len(both) == len(measured) == len(expected)
    for column in METRICS:
        np.testing.assert_allclose(both[column.name], both[f"{column.name}_expected"])


def test_published_rows_stand_where_they_belong(results: Path) -> None:
    board = make_board(read_results([results]), samples=50)
    printed = board.rows[board.rows["kind"] == PUBLISHED]
    assert set(printed["split"]) == {"std-catknown"}
    assert set(printed["grid"]) == {"h126w224"}
    assert printed["coverage"].isna().all(), "what is not printed stays empty"
    swin = printed[(printed["method"] == "SwinDRNet") & (printed["subset"] == "all")]
    assert 0.015 in swin["rmse"].tolist()
    without = make_board(read_results([results]), published=False, samples=50)
    assert (without.rows["kind"] == "measured").all()


def test_tables_tell_published_from_measured(results: Path) -> None:
    board = make_board(read_results([results]), samples=50)
    text = terminal(board)
    assert re.search(r"^\* SwinDRNet +all", text, re.M)
    assert re.search(r"^nearest +all", text, re.M)
    assert "protocol paper" in text.splitlines()[-1]
    assert "| *SwinDRNet* (published) |" in markdown(board)
    assert r"\textit{SwinDRNet}" in latex(board)


def test_markdown_is_rectangular(results: Path) -> None:
    lines = markdown(make_board(read_results([results]), samples=50)).splitlines()
    widths = {line.count("|") for line in lines if line.startswith("|")}
    assert widths == {10}


def test_latex_has_no_bare_specials() -> None:
    assert escape_latex("a_b & 5 % {x}") == r"a\_b \& 5 \% \{x\}"


def test_latex_is_balanced(results: Path) -> None:
    text = latex(make_board(read_results([results]), samples=50))
    body = [line for line in text.splitlines() if " & " in line]
    assert {line.count(" & ") for line in body} == {8}
    assert all(line.endswith(r"\\") for line in body)
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 1
    assert not re.search(r"(?<!\\)[%_#]", "\n".join(text.splitlines()[1:]))


def test_the_command_writes_all_forms_twice_alike(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for place in ("a", "b"):
        assert main([str(results), "--out", str(tmp_path / place)]) == 0
    for name in (CSV, MARKDOWN, LATEX, PAGE):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    csv = pd.read_csv(tmp_path / "a" / CSV)
    assert {"measured", "published"} == set(csv["kind"])
    assert "std-catknown, protocol strict" in capsys.readouterr().out


def test_the_page_needs_nothing_but_itself(results: Path, tmp_path: Path) -> None:
    assert main([str(results), "--out", str(tmp_path)]) == 0
    page = (tmp_path / PAGE).read_text()
    ours = re.sub(r"<script>/\*\*.*?</script>", "", page, flags=re.S)  # without Plotly itself
    assert not re.search(r"""(src|href)=["']https?:""", ours)
    assert ours.count('class="strip"') == 3 * (3 + 3)
    assert "class=published" in ours
    assert "Error against depth" in ours


def test_two_folders_make_one_board(results: Path, tmp_path: Path) -> None:
    shutil.copytree(results, tmp_path / "two")
    shutil.rmtree(tmp_path / "two/std-catknown/raw")
    shutil.rmtree(tmp_path / "two/std-catknown/nearest")
    (tmp_path / "one").mkdir()
    shutil.copytree(results / "std-catknown/raw", tmp_path / "one/std-catknown/raw")
    joined = read_results([tmp_path / "one", tmp_path / "two"])
    assert {r.manifest.label for r in joined} == {"raw", "telea"}


@pytest.mark.parametrize(
    ("harm", "told"),
    [
        (lambda top: shutil.rmtree(top / "std-catknown"), "no results of std-bench"),
        (
            lambda top: next(top.rglob("images.parquet")).write_bytes(b"PAR1nonsense"),
            "cannot read the table",
        ),
        (lambda top: next(top.rglob("run.json")).write_text("{}"), "run.json"),
    ],
)
def test_bad_results_are_told_in_one_line(
    results: Path,
    tmp_path: Path,
    harm: object,
    told: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    top = tmp_path / "results"
    shutil.copytree(results, top)
    harm(top)  # type: ignore[operator]
    assert main([str(top)]) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert told in line


def test_one_method_twice_is_refused(results: Path, tmp_path: Path) -> None:
    shutil.copytree(results, tmp_path / "again")
    with pytest.raises(ToolkitError, match="stands in two folders"):
        read_results([results, tmp_path / "again"])


def test_csv_reads_back(results: Path) -> None:
    from benchmark.report.leaderboard_text import board_csv

    board = make_board(read_results([results]), samples=50)
    back = pd.read_csv(io.StringIO(board_csv(board)))
    assert list(back.columns) == list(board.rows.columns)
    assert len(back) == len(board.rows)
