"""Leaderboards and report pages of `std-bench` results."""
