"""Leaderboards as text and as a page: the figures are those of the rows, published ones marked."""

from __future__ import annotations

import io
import json
import re
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from benchmark.cli.report import PAGE, main
from benchmark.evaluation.engine import run_all
from benchmark.evaluation.results import read_table, write_part
from benchmark.evaluation.tasks.depth_results import read_results, summarise
from benchmark.report.leaderboard import (
    BOARD,
    MEASURED,
    METRICS,
    PUBLISHED,
    Board,
    frames_of,
    make_board,
    merge_equal,
)
from benchmark.report.page import table_files, terminal_text
from benchmark.report.parts.depth import CSV, LATEX, MARKDOWN, board_sections
from benchmark.report.parts.depth_tables import board_tables
from std_toolkit.errors import ToolkitError
from std_toolkit.html.page import Details, Paragraph
from std_toolkit.html.table import Table, escape_latex
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.bench_set import a_run, published_as, write_split


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three methods on three scenes, which are known as the published ones."""
    top = tmp_path_factory.mktemp("report")
    root = write_split(top / "data")
    out = top / "results"
    jobs = JobOptions(engine="serial", progress=False)
    runs = [a_run(root, out, method, protocol="paper") for method in ("raw", "nearest", "telea")]
    with published_as(12, 3):
        assert not run_all(runs, jobs).failed
    return out


def tables(board: Board) -> list[Table]:
    return [table for where in board.boards for table in board_tables(board, *where)]


def file(board: Board, name: str) -> str:
    return table_files((CSV, MARKDOWN, LATEX), tables(board), board.rows)[name]


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


@pytest.mark.slow
def test_published_rows_stand_where_they_belong(results: Path) -> None:
    board = make_board(read_results([results]), samples=50)
    printed = board.rows[board.rows["kind"] == PUBLISHED]
    assert set(printed["split"]) == {"std-catknown"}
    assert set(printed["grid"]) == {"h224w126"}
    assert printed["coverage"].isna().all(), "what is not printed stays empty"
    swin = printed[(printed["method"] == "SwinDRNet") & (printed["subset"] == "all")]
    assert 0.015 in swin["rmse"].tolist()
    without = make_board(read_results([results]), published=False, samples=50)
    assert (without.rows["kind"] == "measured").all()


def test_tables_tell_published_from_measured(results: Path) -> None:
    board = make_board(read_results([results]), samples=50)
    text = terminal_text(tables(board))
    assert re.search(r"^\* SwinDRNet  ", text, re.M)
    assert re.search(r"^nearest +12 +3 ", text, re.M)
    assert "std-bench list published" in text.splitlines()[-1]
    markdown = file(board, MARKDOWN)
    # What is said of a method stands in a column of its own.
    said = r"\| \*SwinDRNet\* \|[^\n]*\| \*published; main: comparison[^|]* \(paper text\)"
    assert re.search(said, markdown)
    assert "arxiv.org/abs/2208.03792" in markdown
    assert r"\textit{SwinDRNet}" in file(board, LATEX)


def test_measured_rows_come_before_published_ones(results: Path) -> None:
    board = make_board(read_results([results]), samples=50)
    rows = board.main_rows("std-catknown", "paper")
    kinds = rows["kind"].tolist()
    assert kinds == sorted(kinds) and set(kinds) == {MEASURED, PUBLISHED}
    for kind in (MEASURED, PUBLISHED):
        figures = rows.loc[rows["kind"] == kind, "rmse"].dropna().tolist()
        assert figures == sorted(figures)


def test_a_fragment_says_so_in_every_heading(results: Path) -> None:
    board = make_board(read_results([results]), samples=50)
    found = tables(board)
    assert len(found) == 2
    assert all("12 of 22,500 frames" in table.title for table in found)
    for name in (MARKDOWN, LATEX):
        assert file(board, name).count("12 of 22,500 frames") == 2
    assert terminal_text(found).count("12 of 22,500 frames") == 2
    assert frames_of("std-catknown", 22_500) == "22,500 frames"
    assert frames_of("os:system", 1) == "1 frame"  # nothing is imported for a name


def test_counts_and_intervals_are_in_every_form(results: Path) -> None:
    board = make_board(read_results([results]), samples=50)
    row = next(iter(board.main_rows("std-catknown", "paper").to_dict("records")))
    low, high = (METRICS[0].text(row[f"rmse_{end}"]) for end in ("low", "high"))
    assert low and high
    for name in (MARKDOWN, LATEX):
        (line,) = [x for x in file(board, name).splitlines() if f"[{low}, {high}]" in x][:1]
        assert re.search(r"[|&] 12 [|&] 3 [|&]", line)


def test_equal_published_rows_are_one_that_lists_its_sources() -> None:
    same = {"split": "s", "protocol": "p", "subset": "all", "method": "A", "rmse": 0.1}
    rows = pd.DataFrame(
        [
            {**same, "mae": np.nan, "table": "main", "training_data": "D"},
            {**same, "mae": np.nan, "table": "supplement", "training_data": "D"},
            {**same, "mae": 0.2, "table": "other", "training_data": ""},
        ]
    )
    merged = merge_equal(rows, ["rmse", "mae", "rel"])
    assert merged["table"].tolist() == ["main; supplement", "other"]
    assert merged["training_data"].tolist() == ["D", ""]


def test_markdown_is_rectangular(results: Path) -> None:
    text = file(make_board(read_results([results]), samples=50), MARKDOWN)
    widths = {line.count("|") for line in text.splitlines() if line.startswith("|")}
    # Method, frames, scenes and notes beside the figures.
    assert widths == {len(BOARD) + 5}


def test_latex_has_no_bare_specials() -> None:
    assert escape_latex("a_b & 5 % {x}") == r"a\_b \& 5 \% \{x\}"


@pytest.mark.slow
def test_latex_is_balanced(results: Path) -> None:
    text = file(make_board(read_results([results]), samples=50), LATEX)
    body = [line for line in text.splitlines() if " & " in line]
    assert {line.count(" & ") for line in body} == {len(BOARD) + 3}  # with the notes
    assert all(line.endswith(r"\\") for line in body)
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 2
    assert not re.search(r"(?<!\\)[%_#]", "\n".join(text.splitlines()[1:]))


@pytest.mark.slow
def test_the_name_of_a_split_is_no_markup(results: Path, tmp_path: Path) -> None:
    evil = "x'`onload='alert(1)"
    shutil.copytree(results, tmp_path / "evil")
    for path in (tmp_path / "evil").rglob("run.json"):
        path.write_text(path.read_text().replace('"std-catknown"', json.dumps(evil)))
    assert main([str(tmp_path / "evil")]) == 0
    page = (tmp_path / "evil" / PAGE).read_text()
    assert evil not in page and "x&#39;" in page
    assert all(re.fullmatch(r"[\w-]+", name) for name in re.findall(r'\bid="(.*?)"', page))


def test_markup_in_the_name_of_a_split_is_refused(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(results, tmp_path / "evil")
    for path in (tmp_path / "evil").rglob("run.json"):
        path.write_text(path.read_text().replace('"std-catknown"', '"<script>alert(1)</script>"'))
    assert main([str(tmp_path / "evil")]) == 1
    assert "run.json: setup.split: Expected `str` matching" in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_writes_all_forms_twice_alike(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for place in ("a", "b"):
        assert main([str(results), "--out", str(tmp_path / place)]) == 0
    for name in (CSV, MARKDOWN, LATEX, PAGE):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    csv = pd.read_csv(tmp_path / "a" / CSV)
    assert {"measured", "published"} == set(csv["kind"])
    assert "std-catknown, protocol paper" in capsys.readouterr().out
    assert main([str(results), "--out", str(tmp_path / "a"), "--json"]) == 0
    board = json.loads(capsys.readouterr().out)[Path(CSV).stem]
    assert [row["method"] for row in board] == csv["method"].tolist()


@pytest.mark.slow
def test_the_page_needs_nothing_but_itself(results: Path, tmp_path: Path) -> None:
    assert main([str(results), "--out", str(tmp_path)]) == 0
    page = (tmp_path / PAGE).read_text()
    assert not re.search(r"""(src|href)=["']https?:""", page)
    assert page.count("<figure>") == 3 * (3 + 3)
    assert 'class="published"' in page
    assert len(page) < 3_000_000


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


def test_text_in_a_column_of_numbers_is_refused(results: Path, tmp_path: Path) -> None:
    top = tmp_path / "results"
    shutil.copytree(results, top)
    path = next(top.rglob("images.parquet"))
    table = pd.read_parquet(path)
    table.assign(rmse=[*(["0.1"] * (len(table) - 1)), "large"]).to_parquet(path)
    with pytest.raises(ToolkitError, match=r"images\.parquet: rmse: the column needs numbers"):
        read_results([top])


@pytest.mark.parametrize("column", ["n_pixels", "n_answered", "not_finite", "index"])
def test_counts_below_0_are_refused(results: Path, tmp_path: Path, column: str, capsys) -> None:
    top = tmp_path / "results"
    shutil.copytree(results, top)
    path = next(top.rglob("images.parquet"))
    table = pd.read_parquet(path)
    table.loc[1, column] = -5
    table.to_parquet(path)
    assert main([str(top)]) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert f"{path}: {column} of row 1: a count is a whole number, 0 or more (got -5.0)" in line


@pytest.mark.parametrize(
    ("name", "damage", "told"),
    [
        ("images", lambda t: pd.concat([t, t]), "a row is there twice"),
        ("images", lambda t: t.assign(grid=5), "grid: the column needs text"),
        ("images", lambda t: t.assign(rmse=[[0.1]] * len(t)), "rmse: the column needs numbers"),
        ("images", lambda t: t.assign(index=t["index"] + 0.5), "index of row 0: a count is a"),
        ("data", lambda t: t.assign(scene=-1), "scene: the column needs text"),
        ("data", lambda t: t.assign(scene=[["a"]] * len(t)), "scene: the column needs text"),
    ],
    ids=["twice", "number", "list", "half", "scene", "scenes"],
)
def test_tables_of_other_cells_are_refused(
    name: str, damage: Callable[[pd.DataFrame], pd.DataFrame], told: str, results: Path,
    tmp_path: Path,
) -> None:  # fmt: skip
    top = tmp_path / "results"
    shutil.copytree(results, top)
    path = next(top.rglob(f"{name}.parquet"))
    damage(pd.read_parquet(path)).to_parquet(path)
    with pytest.raises(ToolkitError, match=rf"{name}\.parquet: .*{told}"):
        read_results([top])


def test_counts_below_0_in_documents_are_refused(results: Path, tmp_path: Path, capsys) -> None:
    top = tmp_path / "results"
    shutil.copytree(results, top)
    path = next(top.rglob("run.json"))
    document = json.loads(path.read_text())
    document["setup"]["frames"] = -3
    path.write_text(json.dumps(document))
    assert main([str(top)]) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert f"{path}: setup.frames" in line and ">= 0" in line


def test_a_byte_that_changed_in_a_table_is_noticed(tmp_path: Path) -> None:
    """Without a checksum of the page, the number would be read as another one."""
    write_part(tmp_path, 0, 99, [{"index": i, "rmse": 0.1 + i} for i in range(100)])
    (path,) = tmp_path.rglob("*.parquet")
    whole, original = path.read_bytes(), read_table(path)
    last = pq.ParquetFile(path).metadata.row_group(0).column(1)
    other = 0
    for k in range(4, last.dictionary_page_offset + last.total_compressed_size):
        path.write_bytes(whole[:k] + bytes([whole[k] ^ 1]) + whole[k + 1 :])
        try:
            other += not pd.read_parquet(path).equals(original)
        except (OSError, ValueError):
            continue
        with suppress(ToolkitError):
            assert read_table(path).equals(original), f"byte {k}"
    assert other > 100


def test_one_method_twice_is_refused(results: Path, tmp_path: Path) -> None:
    shutil.copytree(results, tmp_path / "again")
    with pytest.raises(ToolkitError, match="stands in two folders"):
        read_results([results, tmp_path / "again"])


def test_csv_reads_back(results: Path) -> None:
    board = make_board(read_results([results]), samples=50)
    back = pd.read_csv(io.StringIO(file(board, CSV)))
    assert list(back.columns) == list(board.rows.columns)
    assert len(back) == len(board.rows)


@pytest.mark.slow
def test_many_runs_have_pictures_of_the_best_alone(
    results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("page", "parts.depth"):
        monkeypatch.setattr(f"benchmark.report.{module}.MOST_PICTURED", 2)
    board = make_board(read_results([results]), samples=2)
    best = board.main_rows(*board.boards[0]).query(f"kind == {MEASURED!r}")["method"].tolist()
    blocks = next(s for s in board_sections(board) if s.anchor == "gallery").blocks
    shown = [block.title.split()[0] for block in blocks if isinstance(block, Details)]
    assert shown == best[:2]
    notes = [block.text for block in blocks if isinstance(block, Paragraph)]
    assert "Pictures of 2 of 3 runs; the others are in the folder `gallery` of each run." in notes
