"""Camera poses in metres from a recording: structure from motion, scale sources, quality gate."""

from std_toolkit.options import PoseOptions, Refinement

__all__ = ["PoseOptions", "Refinement"]
