"""Machine code that cannot be kept is used nonetheless."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import resource
from std_toolkit.log import log_to_stderr
from std_toolkit.compiled import compiled

log_to_stderr()

@compiled
def doubled(x):
    return 2 * x

resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
assert doubled(21) == 42
"""


@pytest.mark.slow
def test_code_that_a_full_disk_does_not_take_still_runs(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    done = subprocess.run(
        [sys.executable, str(program)],
        env=dict(os.environ, NUMBA_CACHE_DIR=str(tmp_path / "cache")),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert f"{tmp_path}/cache/" in done.stderr
    assert done.stderr.endswith("compiled code is not kept: File too large\n")
    assert "Traceback" not in done.stderr
