"""Specifications of depth cameras as data."""

from sensors.specs.sensor import (
    DepthSpec,
    ProjectorSpec,
    SensorSpec,
    Source,
    TimeOfFlightSpec,
    load_sensor,
    names,
)

__all__ = [
    "DepthSpec",
    "ProjectorSpec",
    "SensorSpec",
    "Source",
    "TimeOfFlightSpec",
    "load_sensor",
    "names",
]
