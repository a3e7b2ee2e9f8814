"""docs/methods.md: its example runs as it stands, and its tables name what there is."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from filling_scenes import FILLINGS

from benchmark.evaluation.tasks.depth_results import read_results
from benchmark.methods.registry import restorers
from tests.dreds_on_disk import write_std_scene

REPOSITORY = Path(__file__).resolve().parents[5]


@pytest.fixture(scope="module")
def text() -> str:
    return (REPOSITORY / "docs" / "methods.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_example_is_scored_beside_others(text: str, tmp_path: Path) -> None:
    (code,) = (c for c in re.findall(r"```python\n(.*?)```", text, re.S) if "class" in c)
    (tmp_path / "my_methods.py").write_text(code, encoding="utf-8")
    (command,) = re.findall(r"```\nstd-bench (--method raw .*?)```", text, re.S)
    write_std_scene(tmp_path / "ROOT/STD-CatKnown/test_0", frames=2)
    quick = ["--no-speed", "--engine", "serial"]
    arguments = [*command.replace("\\\n", "").split(), *quick]
    done = subprocess.run(
        [sys.executable, "-m", "benchmark.cli.bench", *arguments],
        cwd=tmp_path,
        env={"PYTHONPATH": str(REPOSITORY), "PATH": ""},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    results = {r.manifest.label: r.table for r in read_results([tmp_path / "results"])}
    assert {"raw", "nearest"} < set(results)
    (own,) = set(results) - {"raw", "nearest"}
    assert "FromBehind" in own
    assert results[own]["error"].eq("").all()
    assert results[own]["coverage"].mean() > results["raw"]["coverage"].mean()


def test_the_tables_name_all_methods_and_their_settings(text: str) -> None:
    described = re.findall(r"^\| `([a-z-]+)` \|", text, re.M)
    assert set(described) >= {"raw", *FILLINGS}
    (table,) = re.findall(r"^\| setting \|.*?\n\n", text, re.M | re.S)
    defaults = dict(re.findall(r"^\| `(\w+)` \|[^|]*\| `?([^|`]*?)`? \|", table, re.M))
    actual = {}
    for method in FILLINGS:
        for field in fields(restorers.get(method).settings_type):  # type: ignore[attr-defined]
            actual[field.name] = field.default
    assert set(defaults) == set(actual)
    for name, default in actual.items():
        assert defaults[name] == (f"{default:g}" if not isinstance(default, str) else default)
