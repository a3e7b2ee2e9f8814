"""Long work over many items."""

from std_toolkit.jobs.runner import JobOptions, JobReport, run_jobs

__all__ = ["JobOptions", "JobReport", "run_jobs"]
