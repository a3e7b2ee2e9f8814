"""The command line starts fast and keeps its exit codes."""

from __future__ import annotations

import subprocess
import sys

import pytest

from std_toolkit import __version__
from std_toolkit.cli.main import COMMANDS, main

HEAVY = ("torch", "open3d", "pycolmap", "pyrender", "trimesh", "scipy", "pandas", "ray", "cv2")


def test_help_imports_no_heavy_library() -> None:
    script = (
        "import sys, contextlib, io\n"
        "from std_toolkit.cli.main import build_parser\n"
        "build_parser().format_help()\n"
        f"print([m for m in {HEAVY} if m in sys.modules])\n"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert result.stdout.strip() == "[]", result.stdout + result.stderr


@pytest.mark.parametrize("arguments", [[], ["no_such_command"], ["info"], ["info", "--no-such"]])
def test_bad_usage_is_status_2(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main([command.rstrip("_"), "--help"])
    assert caught.value.code == 0
    assert "usage: std-curate" in capsys.readouterr().out


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--version"])
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
