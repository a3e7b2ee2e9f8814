"""Grasps from geometry alone: two contacts that face each other on the points that are seen."""
