"""The guide "Put your method on the board", as a new user follows it."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from benchmark.cli import bench, report
from benchmark.evaluation.results import TABLE
from tests.benchmark.recipes.bakeoff_set import write_recording

GUIDE = Path(__file__).parents[3] / "docs" / "board.md"
PROGRAMS = {"std-bench": bench.main, "std-report": report.main}


def test_every_command_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_recording(tmp_path / "scenes" / "glass", frames=3)
    text = GUIDE.read_text(encoding="utf-8")
    (script,) = re.findall(r"```python\n(.*?)```", text, re.S)
    (tmp_path / "mine.py").write_text(script)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    lines = [
        line
        for block in re.findall(r"```bash\n(.*?)```", text, re.S)
        for line in block.splitlines()
    ]
    assert len(lines) == 7
    for line in lines:
        program, *words = shlex.split(line)
        if program == "python":
            subprocess.run([sys.executable, *words], check=True)
        else:
            assert PROGRAMS[program](words) == 0, line
    for name in ("raw", "nearest", "mine", "program"):
        table = pd.read_parquet(tmp_path / "results" / "scenes" / name / "strict" / TABLE)
        assert (table["error"] == "").all()
    found = [
        pd.read_parquet(tmp_path / "results" / "scenes" / name / "strict" / TABLE)["rmse"]
        for name in ("mine", "program")
    ]
    # One reads the files, the other runs the script: 0.1 mm of the raw depth apart at most.
    assert (found[0] - found[1]).abs().max() < 1e-4
    assert (tmp_path / "site" / "index.html").is_file()
    assert (tmp_path / "results" / "report.html").is_file()
