"""Methods and options that cannot work are refused in one line, before anything is written."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmark.cli.bench import main
from benchmark.methods.protocol import Restored, View
from benchmark.methods.registry import MethodOptions
from tests.benchmark.evaluation.bench_set import SPLIT, write_split

HERE = "tests.benchmark.evaluation.test_bench_odd_methods"
not_a_class = 5


class DoesNotStart:
    """Raises when it is made."""

    def __init__(self, options: MethodOptions) -> None:  # noqa: ARG002
        raise ValueError("no\nlicence")


class Incomplete:
    """Lacks what tells which views it wants."""

    def __init__(self, options: MethodOptions) -> None:
        pass

    def restore(self, views: list[View]) -> list[Restored]:
        return [Restored(view.depth) for view in views]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_split(tmp_path_factory.mktemp("data"), scenes=1, frames=1)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--method", f"{HERE}:not_a_class"], "is not a class that takes MethodOptions"),
        (["--method", f"{HERE}:DoesNotStart"], "cannot be made: ValueError: no licence"),
        (["--method", f"{HERE}:Incomplete"], "input_size, needs_mask: the method has no such"),
        (["--method", "leaves_at_once_plugin:X"], "cannot import plug-in"),
        (["--method", "nearest", "--device", "gpu0"], "--device: there is no such device here"),
        (["--method", "raw", "--weights", "w.pth"], "--weights: the method has no weights"),
        (["--method", "telea", "--label", "x" * 300], "label: must have at most 120 characters"),
    ],
)
def test_it_is_told_in_one_line(
    root: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    told: str,
) -> None:
    (tmp_path / "leaves_at_once_plugin.py").write_text("import sys\nsys.exit('bye')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    out = tmp_path / "r"
    status = main(
        [*words, "--data", str(root), "--split", SPLIT, "--out", str(out), "--engine", "serial"]
    )
    assert status == (2 if "--label" in words else 1)  # a wrong command line
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert len(errors) == 1
    assert told in errors[0]
    assert "Posix" not in errors[0]
    assert not out.exists()
