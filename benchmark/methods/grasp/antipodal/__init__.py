"""Grasps from geometry: two opposing contacts on the visible points."""
