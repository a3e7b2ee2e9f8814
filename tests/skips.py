"""Which tests may be skipped: here is the only place that decides it.

A test that cannot run on a machine skips, with the reason. In continuous integration (`CI=true`,
as `.ci/run` sets it) a skip fails unless its reason is one of `ALLOWED`; `conftest.py` calls
`refuse` for every skip.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from functools import cache
from typing import NoReturn

import pytest

# What continuous integration may lack, or have beyond what a test wants.
ALLOWED = (
    r"cuda_ad_rgb: ",
    r"this machine has (CUDA|GPUs)",
    r"there is CUDA here",
    r"root may write",
    # No package index has it.
    r"bop_toolkit is not installed",
    # They may not be redistributed. Where their folder is, each of them has to be in it.
    r"(real recordings|known answers) not found at",
)
_GL = """
import numpy, pyrender
renderer = pyrender.OffscreenRenderer(8, 8)
scene = pyrender.Scene()
scene.add(pyrender.PerspectiveCamera(yfov=1.0))
renderer.render(scene)
"""


def in_ci() -> bool:
    """Whether continuous integration runs the tests."""
    return os.environ.get("CI") == "true"


def refuse(reason: str) -> str | None:
    """Why a skip with this reason is a failure; None if it is allowed."""
    reason = reason.removeprefix("Skipped: ")
    if not in_ci() or any(re.match(pattern, reason) for pattern in ALLOWED):
        return None
    return f"skipped in continuous integration, which allows only tests/skips.py: {reason}"


def refuse_report(report: pytest.TestReport | pytest.CollectReport) -> None:
    """Make a report of a skip that is not allowed a failure."""
    if report.outcome != "skipped" or hasattr(report, "wasxfail"):
        return
    skip = report.longrepr
    problem = refuse(skip[2] if isinstance(skip, tuple) else str(skip))
    if problem is not None:
        report.outcome = "failed"
        report.longrepr = f"{report.nodeid}: {problem}"


def program_missing(program: str, package: str) -> NoReturn:
    """Skip for want of a program."""
    pytest.skip(f"needs {program}, Debian's package {package}; `make test` installs it")


@cache
def gl_problem(platform: str) -> str | None:
    """Why pyrender alone, without our renderer, draws nothing on a platform; None if it does."""
    environment = {**os.environ, "PYOPENGL_PLATFORM": platform}
    command = [sys.executable, "-c", _GL]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    return done.stderr.strip().rpartition("\n")[2] if done.returncode else None


def need_gl(*platforms: str) -> None:
    """Skip where the machine cannot draw; a fault of our renderer is not the machine's.

    Args:
        platforms: any of them will do; default: EGL and OSMesa.
    """
    problems = []
    for platform in platforms or ("egl", "osmesa"):
        problem = gl_problem(platform)
        if problem is None:
            return
        problems.append(f"{platform}: {problem}")
    pytest.skip(f"no GL context: {'; '.join(problems)}")
