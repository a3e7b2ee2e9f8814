"""Data sets, methods, metrics and reports of the benchmark; `Restorer` for one's own camera.

The names below are imported on first use: `import benchmark` loads no library.
"""

from typing import TYPE_CHECKING

from std_toolkit.plugins import install, lazy_names

if TYPE_CHECKING:
    from benchmark.evaluation.evaluate import evaluate
    from benchmark.evaluation.tasks.depth_results import read_results
    from benchmark.methods.protocol import Restored, View
    from benchmark.methods.registry import MethodOptions
    from benchmark.restoring.restorer import RestoredFrame, Restorer

__all__ = [
    "MethodOptions",
    "Restored",
    "RestoredFrame",
    "Restorer",
    "View",
    "evaluate",
    "read_results",
]

# Submodule that defines each name.
_MODULES = {
    "MethodOptions": "methods.registry",
    "Restored": "methods.protocol",
    "RestoredFrame": "restoring.restorer",
    "Restorer": "restoring.restorer",
    "View": "methods.protocol",
    "evaluate": "evaluation.evaluate",
    "read_results": "evaluation.tasks.depth_results",
}

install()


if not TYPE_CHECKING:  # otherwise type checkers would accept misspelt names
    __getattr__ = lazy_names(__name__, _MODULES)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
