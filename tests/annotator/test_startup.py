"""Quick imports leave everything as usable as plain imports do."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip("pyvistaqt")


def run(code: str) -> list[str]:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


QUICKLY = "from annotator.startup import quick_imports\nwith quick_imports():\n    import pyvista\n"
QUICKLY += "    import pyvista.plotting\nimport gc, sys\n"


@pytest.mark.slow
def test_what_nothing_here_uses_is_not_loaded() -> None:
    plain = "import pyvista, pyvista.plotting, sys\n"
    show = "print('matplotlib.pyplot' in sys.modules, 'pooch' in sys.modules, len(sys.modules))"
    before, after = run(plain + show), run(QUICKLY + show)
    assert before[:2] == ["True", "True"]
    assert after[:2] == ["False", "False"]
    assert int(after[2]) < int(before[2]) - 100


@pytest.mark.slow
def test_it_is_loaded_when_it_is_used() -> None:
    code = QUICKLY + "chart = pyvista.ChartMPL()\nimport matplotlib.pyplot as plt\n"
    code += "print(chart.figure in map(plt.figure, plt.get_fignums()), plt.__name__)"
    assert run(code) == ["True", "matplotlib.pyplot"]


@pytest.mark.slow
def test_it_can_be_imported_afterwards() -> None:
    code = QUICKLY + "import mypy, pooch\nfrom matplotlib import pyplot\n"
    code += "print(mypy.__name__, pooch.retrieve.__name__, pyplot.figure.__name__)"
    assert run(code) == ["mypy", "retrieve", "figure"]


def test_garbage_is_collected_again_but_not_among_what_was_imported() -> None:
    frozen = run(QUICKLY + "print(gc.isenabled(), gc.get_freeze_count() > 10_000)")
    assert frozen == ["True", "True"]


@pytest.mark.slow
def test_the_second_time_nothing_is_kept_from_the_collector() -> None:
    code = QUICKLY + "gc.unfreeze()\nwith quick_imports():\n    import pyvista.plotting\n"
    assert run(code + "print(gc.get_freeze_count())") == ["0"]


def test_what_was_imported_before_stays() -> None:
    code = "import pooch, gc\ngc.disable()\n" + QUICKLY
    code += "print(sys.modules['pooch'] is pooch, gc.isenabled())"
    assert run(code) == ["True", "False"]


def test_after_a_failed_import_nothing_stands_in() -> None:
    code = "from annotator.startup import quick_imports\nimport gc, sys\n"
    code += "try:\n    with quick_imports():\n        import no_such_module\n"
    code += "except ImportError:\n    print(gc.isenabled(), 'pooch' in sys.modules)"
    assert run(code) == ["True", "False"]
