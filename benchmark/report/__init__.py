"""Leaderboards and pages of what `std-bench` measured."""
