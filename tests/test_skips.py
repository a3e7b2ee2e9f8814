"""In continuous integration a skip fails, whatever asks for it, but for a few reasons."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import skips

REPOSITORY = Path(__file__).resolve().parent.parent
FILES = {
    "test_whole.py": "import pytest\npytest.importorskip('no_such_package')\ndef test(): pass\n",
    "test_one.py": """
import pytest

@pytest.fixture
def context():
    pytest.skip("no GL context")

def test_of_a_fixture(context): pass

@pytest.mark.skipif(True, reason="no chromium")
def test_of_a_mark(): pass

@pytest.mark.skipif(True, reason="root may write everywhere")
def test_allowed(): pass

@pytest.mark.xfail
def test_known_fault(): assert False
""",
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ci", "outcome"),
    [("true", "1 skipped, 1 xfailed, 3 errors"), ("", "4 skipped, 1 xfailed")],
)
def test_skips_fail_in_continuous_integration(tmp_path: Path, ci: str, outcome: str) -> None:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_")}
    words = "-q -W ignore -p tests.conftest -p no:cacheprovider --continue-on-collection-errors ."
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *words.split()],
        cwd=tmp_path,
        env=environment | {"CI": ci, "PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
    )
    assert done.stdout.splitlines()[-1].startswith(outcome), done.stdout + done.stderr
    assert (done.returncode == 0) == (ci == "")


def test_a_machine_that_draws_needs_gl(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether it draws is found without the renderer that is under test."""
    monkeypatch.setattr(skips, "gl_problem", lambda platform: None if platform == "osmesa" else "x")
    skips.need_gl()
    with pytest.raises(pytest.skip.Exception, match="no GL context: egl: x"):
        skips.need_gl("egl")
    assert "std_toolkit" not in skips._GL
