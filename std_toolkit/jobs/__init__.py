"""Parallel jobs over many items."""

from std_toolkit.jobs.options import JobOptions
from std_toolkit.jobs.runner import JobReport, run_jobs

__all__ = ["JobOptions", "JobReport", "run_jobs"]
