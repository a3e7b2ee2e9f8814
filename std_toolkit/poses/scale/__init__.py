"""Sources of metres: plug-ins that say how many metres one unit of a reconstruction is."""

from std_toolkit.poses.scale.source import SOURCES, ScaleContext, ScaleSource

__all__ = ["SOURCES", "ScaleContext", "ScaleSource"]
