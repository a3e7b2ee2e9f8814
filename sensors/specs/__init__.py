"""Specifications of depth cameras as data."""

from sensors.specs.load import load_sensor, names
from sensors.specs.model import DepthSpec, ProjectorSpec, SensorSpec, Source

__all__ = ["DepthSpec", "ProjectorSpec", "SensorSpec", "Source", "load_sensor", "names"]
