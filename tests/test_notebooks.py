"""The notebooks run from the first cell to the last, with small frames; the guides' code runs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((REPOSITORY / "docs/notebooks").glob("*.ipynb"))
NEEDS = {"simulate_and_train": ("mitsuba", "mujoco", "torch")}


def program_of(path: Path) -> str:
    """The code cells, one after the other; no magics."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code")


def run(path: Path, tmp_path: Path) -> str:
    """Run a notebook in the tiny setting; returns what it prints."""
    for name in NEEDS.get(path.stem, ()):
        pytest.importorskip(name)
    file = tmp_path / f"{path.stem}.py"
    # Programs that start processes import this file again.
    lines = "".join(f"    {line}\n" for line in program_of(path).splitlines())
    file.write_text(f"def main():\n{lines}\nif __name__ == '__main__':\n    main()\n")
    paths = os.pathsep.join(filter(None, (str(REPOSITORY), os.environ.get("PYTHONPATH", ""))))
    done = subprocess.run(
        [sys.executable, str(file)],
        cwd=tmp_path,
        env={**os.environ, "STD_TINY": "1", "TMPDIR": str(tmp_path), "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


def test_notebooks_hold_no_output() -> None:
    assert [p.stem for p in NOTEBOOKS] == [
        "label_a_scene",
        "restore_and_score",
        "simulate_and_train",
    ]
    for path in NOTEBOOKS:
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            assert not cell.get("outputs"), path.name
        compile(program_of(path), path.name, "exec")


@pytest.mark.slow
def test_restore_and_score(tmp_path: Path) -> None:
    out = run(REPOSITORY / "docs/notebooks/restore_and_score.ipynb", tmp_path)
    assert "measured" in out and "nearest" in out and "% std-toolkit" in out


@pytest.mark.long
def test_label_a_scene(tmp_path: Path) -> None:
    out = run(REPOSITORY / "docs/notebooks/label_a_scene.ipynb", tmp_path)
    assert "16 of 16 frames" in out and "median mm" in out


@pytest.mark.long
def test_simulate_and_train(tmp_path: Path) -> None:
    out = run(REPOSITORY / "docs/notebooks/simulate_and_train.ipynb", tmp_path)
    assert "best.safetensors" in out and "dfnet" in out
