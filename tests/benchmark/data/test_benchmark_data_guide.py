"""The guide docs/benchmark_data.md says what is so."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from dreds_on_disk import write_std_scene

from benchmark.data.splits import get_split, splits

GUIDE = Path(__file__).resolve().parents[3] / "docs/benchmark_data.md"


@pytest.fixture(scope="module")
def text() -> str:
    return GUIDE.read_text(encoding="utf-8")


def test_the_table_has_every_split_with_its_counts(text: str) -> None:
    rows = [line for line in text.splitlines() if line.startswith("| `")]
    # "`-val`" behind the name of another split stands for the name with this ending.
    rows = [r.replace("`-val`", "`dreds-catknown-val`") for r in rows]
    for name in splits.names():
        (row,) = [r for r in rows if f"`{name}`" in r]
        for said in get_split(name).published:
            assert f"{said.frames:,}" in row
        page = get_split(name).page
        assert page in text


def test_the_example_runs(text: str, tmp_path: Path, capsys) -> None:
    write_std_scene(tmp_path / "STD-CatKnown/test_8", frames=2)
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(compile(code, str(GUIDE), "exec"), {"root": tmp_path})
    printed = capsys.readouterr().out.splitlines()
    assert [line.split(" (")[0] for line in printed] == ["test_8/0000", "test_8/0001"]
    assert all(int(line.split()[-1]) > 20 for line in printed)
