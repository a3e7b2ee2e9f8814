"""Grasp planners: what they are to the benchmark, and those that come with it."""
