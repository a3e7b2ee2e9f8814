"""docs/restoring.md: its options exist, its files are written, its program runs."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from restore_cases import K, sensor_depth, write_folder

from benchmark.cli.restore import PROGRAM, main
from benchmark.restoring.onnx_export import made_up_views

REPOSITORY = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def text() -> str:
    return (REPOSITORY / "docs/restoring.md").read_text(encoding="utf-8")


def test_every_option_of_the_guide_exists(text, capsys):
    pages = {}
    for command in ("restore", "live", "export"):
        with pytest.raises(SystemExit):
            PROGRAM.main([command, "--help"])
        pages[command] = capsys.readouterr().out
    lines = text.replace("\\\n", "").splitlines()
    for line in (line for line in lines if "std-restore" in line and "std-curate" not in line):
        command = "live" if "--live" in line else "export" if "export" in line else "restore"
        page = pages[command] + "--live"
        for option in re.findall(r"(?<![\w-])--[a-z-]+", line):
            assert option in page, line


def test_the_files_of_the_guide_are_those_that_are_written(text, tmp_path):
    folder = write_folder(tmp_path / "rec", 1)
    given = ("--out", str(tmp_path / "out"), "--intrinsics", K, "--engine", "serial", "--quiet")
    assert main([str(folder), *given, "--points", "--pictures"]) == 0
    written = {
        str(p.relative_to(tmp_path / "out")) for p in (tmp_path / "out").rglob("*.*") if p.is_file()
    }
    spec = (REPOSITORY / "data_spec.md").read_text(encoding="utf-8")
    for page in (text, spec.partition("### Restored depth")[2].partition("## 14")[0]):
        named = {n.replace("NAME", "0000") for n in re.findall(r"`(\w+/NAME\.\w+)`", page)}
        named |= {"restore.json", "citations.bib"}
        assert written <= named and {"`restore.json`", "`citations.bib`"} <= set(
            re.findall("`.*?`", page)
        )


def test_the_program_of_the_guide_runs(text):
    (code,) = re.findall(r"```python\n(.*?)```", text, re.S)
    names = {
        "color": made_up_views((96, 72))[0].color,
        "depth": sensor_depth(),
        "K": [96, 96, 47.5, 35.5],
    }
    exec(code, names)
    assert names["restored"].depth.shape == (72, 96)  # type: ignore[attr-defined]
