"""Grasp planners."""
