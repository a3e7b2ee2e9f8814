"""Metric, watertight, textured CAD models from photos of an object."""
