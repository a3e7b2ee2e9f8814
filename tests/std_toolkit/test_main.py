"""The command line starts fast and keeps its exit codes."""

from __future__ import annotations

import subprocess
import sys

import pytest

from std_toolkit import __version__
from std_toolkit.cli.main import main

HEAVY = (
    "numpy",
    "torch",
    "open3d",
    "pycolmap",
    "pyrender",
    "trimesh",
    "scipy",
    "pandas",
    "ray",
    "cv2",
)


def test_help_imports_no_heavy_library() -> None:
    script = (
        "import sys, contextlib, io\n"
        "from std_toolkit.cli.main import main\n"
        "for name in ('--help', 'poses --help', 'check --help', 'label --help'):\n"
        "    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):\n"
        "        main(name.split())\n"
        f"print([m for m in {HEAVY} if m in sys.modules])\n"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert result.stdout.strip() == "[]", result.stdout + result.stderr


@pytest.mark.parametrize("arguments", [[], ["no_such_command"], ["info"], ["info", "--no-such"]])
def test_bad_usage_is_status_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert len(capsys.readouterr().err.splitlines()) == (1 if arguments else 0)


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == f"std-toolkit {__version__}"


def test_a_closed_pipe_is_no_error() -> None:
    """As in `std-curate schema | head -1`."""
    command = (
        f"{sys.executable} -m std_toolkit.cli.main schema | head -c 1; exit ${{PIPESTATUS[0]}}"
    )
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert "Traceback" not in result.stderr
    assert "error" not in result.stderr.lower()
    assert result.returncode == 0
