"""The page in a browser: it draws without an error and without the network, and columns sort."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from benchmark.cli.report import PAGE, main
from benchmark.evaluation.engine import run_all
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.bench_set import a_run, write_split

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    top = tmp_path_factory.mktemp("page")
    root = write_split(top / "data", scenes=2, frames=2)
    jobs = JobOptions(engine="serial", progress=False)
    run_all([a_run(root, top / "r", m) for m in ("raw", "nearest", "telea")], jobs)
    assert main([str(top / "r")]) == 0
    return top / "r" / PAGE


def test_it_draws_and_sorts(report: Path, page: Page) -> None:
    errors: list[str] = []
    asked: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(report.as_uri())
    page.wait_for_selector(".plot .main-svg")
    assert "Error against depth" in report.read_text()
    assert errors == []
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []

    table = page.locator("table.sortable").first
    head = table.locator("th", has_text="RMSE")

    def column() -> list[float]:
        cells = table.locator("tbody").first.locator("td:nth-child(4)")
        values = [cells.nth(i).get_attribute("data-v") for i in range(cells.count())]
        return [float(v) for v in values if v]

    head.click()
    assert head.get_attribute("aria-sort") == "ascending"
    assert column() == sorted(column())
    assert len(column()) == 3  # published rows are sorted apart
    assert table.locator("tbody").nth(1).locator("tr:not(.published)").count() == 0
    head.click()
    assert column() == sorted(column(), reverse=True)


def test_shares_sort_from_the_best(report: Path, page: Page) -> None:
    page.goto(report.as_uri())
    head = page.locator("table.sortable").first.locator("th", has_text="δ1.05")
    head.click()
    assert head.get_attribute("aria-sort") == "descending"
