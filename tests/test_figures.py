"""Figures of README, guides and cards: each is the row of a table, and none is without one."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from tools import figures
from tools.check_docs import help_page

REPOSITORY = Path(__file__).resolve().parent.parent
ROWS = figures.read_figures()


@pytest.mark.parametrize("path", figures.pages(), ids=lambda path: path.name)
def test_a_page_shows_each_figure_as_measured(path: Path) -> None:
    assert list(figures.wrong_marks(path.read_text(encoding="utf-8"), ROWS)) == []


@pytest.mark.parametrize("path", figures.pages(), ids=lambda path: path.name)
def test_every_number_with_a_unit_is_a_figure_or_a_fact(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    if path.parent.name == "weights":  # what comes before is the exporter's record of the training
        text = text[text.index("## Scores of validation") :]
    assert list(figures.unmarked(text)) == []


def test_every_row_is_shown() -> None:
    shown = {name for path in figures.pages() for name in figures.used(path.read_text("utf-8"))}
    assert set(ROWS) - shown == set()


def test_every_row_is_complete() -> None:
    for name, row in ROWS.items():
        assert re.search(r"\d", row.value), name
        assert row.unit in ("", *figures.UNITS), name
        assert row.claim and row.machine, name
        assert re.fullmatch(r"20\d\d-\d\d-\d\d", row.date), name


def test_every_command_exists() -> None:
    for command in sorted({row.command for row in ROWS.values()}):
        assert wrong_command(command) is None, command


@pytest.mark.parametrize(
    "command",
    [
        "std-bench --nothing x",
        "std-nothing",
        "python perf/nothing.py",
        "python perf/render.py --nothing",
        "python -m sensors.nothing",
        "pytest tests/nothing.py",
        "make nothing",
        "",
    ],
)
def test_a_command_that_does_not_exist_is_found(command: str) -> None:
    assert wrong_command(command)


def test_every_commit_exists() -> None:
    commits = {row.commit for row in ROWS.values()} - {""}
    assert all(re.fullmatch(r"[0-9a-f]{8,40}", commit) for commit in commits)
    if not (REPOSITORY / ".git").exists() or git("rev-parse", "--is-shallow-repository") == "true":
        return  # a source distribution or a shallow clone has no history
    for commit in sorted(commits):
        assert git("cat-file", "-t", commit) == "commit", commit


def git(*words: str) -> str:
    return subprocess.run(
        ["git", *words], cwd=REPOSITORY, capture_output=True, text=True
    ).stdout.strip()


def wrong_command(command: str) -> str | None:
    """What of a row's command does not exist."""
    program, *words = command.split() or ["nothing"]
    if program == "python" and words[0] == "-m":
        module = REPOSITORY.joinpath(*words[1].split("."))
        exists = module.with_suffix(".py").is_file() or (module / "__main__.py").is_file()
        return None if exists else words[1]
    if program in ("python", "pytest"):
        files = [word.partition("::")[0] for word in words if "/" in word]
        script = REPOSITORY / files[0]
        if not script.is_file():
            return files[0]
        options = [word for word in words if word.startswith("--")]
        text = script.read_text(encoding="utf-8")
        if "world_options(" in text:
            text += (REPOSITORY / "perf" / "world.py").read_text(encoding="utf-8")
        return next((option for option in options if f'"{option}"' not in text), None)
    if program == "make":
        makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
        return None if re.search(rf"^{words[0]}:", makefile, re.MULTILINE) else words[0]
    page = help_page(program, words[0] if words else "", False)
    if not page:
        return program
    for word in words:
        if word.startswith("--") and word not in page.split():
            return word
    return None


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("A <!--=a.b-->1.5<!--/--> mm", "the page says 1.5"),
        ("A <!--=a.b-->1.4<!--/--> m off", "the page says m"),
        ("A **<!--=a.b-->1.4<!--/-->** m", "the page says m"),
        ("A <!--=a.c-->1.4<!--/--> mm", "no row a.c"),
        ("A <!--=a.b:interval-->1.4<!--/--> mm", "is nothing"),
        ("<!--=a.b-->1.4<!--/--> mm", "start of a line"),
        ("- <!--=a.b-->1.4<!--/--> mm", "start of a line"),
        ("It is\n<!--fact-->5 mm<!--/--> off", "start of a line"),
        ("It is <!--fact-->5 mm\n<!--/--> off", "start of a line"),
        ("A `<!--=a.b-->1.4<!--/-->` mm", "in code"),
        ("```\nA <!--=a.b-->1.4<!--/-->\n```", "in code"),
        ("A <!--=a.b-->1.4 mm", "without its pair"),
        ("A 1.4<!--/--> mm", "without its pair"),
        ("A <!--fact-->1 mm <!--=a.b-->1.4<!--/--> mm", "not closed"),
    ],
)
def test_a_wrong_mark_is_found(text: str, problem: str) -> None:
    assert problem in " ".join(figures.wrong_marks(text, {"a.b": row("a.b", "1.4", "mm")}))


@pytest.mark.parametrize(
    "text",
    [
        "A 1.4 mm",
        "A 12% share",
        "In 1,024 s.",
        "A **3** <!--fact-->4 mm<!--/--> and 5 MB",
        "From 2 to 3 degrees",
        "It is 1.5x faster",
        "| a | RMSE [mm] |\n|---|---|\n| b | 3.4 |\n",
        "| a | median mm |\n|---|---|\n| b | 3.4 |\n",
        "| a | b |\n|---|---|\n| b | 3.4 mm |\n",
    ],
)
def test_a_number_without_a_mark_is_found(text: str) -> None:
    assert list(figures.unmarked(text))


@pytest.mark.parametrize(
    "text",
    [
        "A <!--=a.b-->1.4<!--/--> mm",
        "At 640x480 and 800 x 450 in `3 mm`",
        "```\n3 mm\n```\n",
        "<!--fact-->\n\n| a | mm |\n|---|---|\n| b | 3.4 |\n\n<!--/-->\n",
        "5 mugs, 3 scenes, 2 models, 10°5cm",
        "| a | n |\n|---|---|\n| b | 3 |\n",
    ],
)
def test_other_numbers_need_no_mark(text: str) -> None:
    assert list(figures.unmarked(text)) == []


def test_refreshing_writes_values_and_intervals() -> None:
    text = "A <!--=a.b-->1<!--/--> mm [<!--=a.b:interval-->0<!--/-->] <!--=c.d-->7<!--/-->"
    rows = {"a.b": row("a.b", "1.4", "mm", interval="1.2 to 1.6")}
    assert figures.refreshed(text, rows) == (
        "A <!--=a.b-->1.4<!--/--> mm [<!--=a.b:interval-->1.2 to 1.6<!--/-->] <!--=c.d-->7<!--/-->"
    )


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        (["name,value"], "columns"),
        ([",".join(figures.COLUMNS), "a.b,c,1,mm,,make x,,m"], "cells"),
        ([",".join(figures.COLUMNS), *["a.b,c,1,mm,,make x,,m,2026-01-01"] * 2], "twice"),
        ([",".join(figures.COLUMNS), "b.b,c,1,mm,,make x,,m,2026-01-01"], "begins otherwise"),
    ],
)
def test_a_wrong_table_is_refused(lines: list[str], problem: str, tmp_path: Path) -> None:
    (tmp_path / figures.RESULTS).mkdir(parents=True)
    (tmp_path / figures.RESULTS / "a.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(ValueError, match=problem):
        figures.read_figures(tmp_path)


def row(name: str, value: str, unit: str, interval: str = "") -> figures.Figure:
    return figures.Figure(
        name=name,
        claim="c",
        value=value,
        unit=unit,
        interval=interval,
        command="make test",
        commit="",
        machine="m",
        date="2026-01-01",
    )
