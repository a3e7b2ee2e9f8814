"""Result folders of somebody else: no text of theirs is markup or a script on the page."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from hostile_pages import MARKUP, Field, attack, harm

from benchmark.evaluation.engine import run_all
from benchmark.evaluation.tasks.depth_results import read_results
from benchmark.evaluation.tasks.pose_results import read_pose_results
from benchmark.report.page import make_parts, render_page
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.bench_set import a_run, write_split
from tests.benchmark.evaluation.pose_set import a_pose_run, write_pose_split

JOBS = JobOptions(engine="serial", progress=False)
pytestmark = pytest.mark.slow


def depth_results(top: Path) -> Path:
    root = write_split(top / "data", scenes=1, frames=1)
    run_all([a_run(root, top / "r", m, gallery=False) for m in ("raw",)], JOBS)
    return top / "r"


def pose_results(top: Path) -> Path:
    root = write_pose_split(top / "data", scenes=1, frames=1)
    run_all([a_pose_run(root, top / "r")], JOBS)
    return top / "r"


def page_of(folder: Path) -> str:
    return render_page(make_parts([folder], published=False))


@pytest.mark.parametrize(
    ("results", "read"),
    [(depth_results, read_results), (pose_results, read_pose_results)],
    ids=["depth", "pose"],
)
def test_no_field_is_markup(
    results: Callable[[Path], Path], read: Callable[[list[Path]], object], tmp_path: Path
) -> None:
    folder = results(tmp_path)
    assert harm(page_of(folder)) == []
    tally = attack(folder, lambda: read([folder]), lambda: page_of(folder), skip=known_later)
    assert {"run.json:label", "pose.json:label"} & set(tally.refused)
    assert len(tally.shown) > 30


def known_later(field: Field) -> bool:
    """Libraries by name, and names that must be known to draw a page."""
    return "packages" in field.keys or field.keys[-1] in (
        "protocol",
        "picture",
        "grid",
        "subset",
        "kind",
    )


def test_one_fit_that_there_is_not(tmp_path: Path) -> None:
    folder = pose_results(tmp_path)
    (path,) = folder.rglob("pose.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | {"fit": "best"}))
    with pytest.raises(ToolkitError, match=r"pose\.json: fit: not a fit of poses"):
        page_of(folder)


@pytest.mark.parametrize("column", ["scene", "kind", "model"])
def test_markup_in_a_table_is_refused(column: str, tmp_path: Path) -> None:
    folder = pose_results(tmp_path)
    (path,) = folder.rglob("poses.parquet")
    Field(path, (column,)).replace(MARKUP)
    with pytest.raises(ToolkitError, match=f"poses.parquet: {column}: not a name"):
        page_of(folder)
