"""JSON Schema of a sensor's file, generated from the structure that reads it."""

from __future__ import annotations

import msgspec

from sensors.specs.model import SensorSpec
from std_toolkit.io.documents import DIALECT


def schema_bytes() -> bytes:
    """The schema as it is stored beside the sensors, in `sensor.schema.json`."""
    schema = {
        "$schema": DIALECT,
        "$id": "https://std-toolkit.example/schemas/sensor.schema.json",
        **msgspec.json.schema(SensorSpec),
    }
    return msgspec.json.format(msgspec.json.encode(schema), indent=2) + b"\n"
