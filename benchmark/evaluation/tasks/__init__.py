"""The tasks of the benchmark, each loaded when it is needed."""

from __future__ import annotations

import importlib
from typing import Any

TASKS = {
    name: f"benchmark.evaluation.tasks.{name}:TASK" for name in ("depth", "pose", "grasp", "bop")
}


def get_task(name: str) -> Any:
    """The task of this name, a `benchmark.evaluation.engine.Task`."""
    module, _, attribute = TASKS[name].partition(":")
    return getattr(importlib.import_module(module), attribute)
