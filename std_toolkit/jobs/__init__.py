"""Parallel jobs over many items."""

from typing import TYPE_CHECKING

from std_toolkit.options import JobOptions
from std_toolkit.plugins import lazy_names

if TYPE_CHECKING:
    from std_toolkit.jobs.runner import JobReport, run_jobs
else:  # a command that ends by signals needs no pool of processes
    __getattr__ = lazy_names(__name__, {"JobReport": "runner", "run_jobs": "runner"})

__all__ = ["JobOptions", "JobReport", "run_jobs"]
