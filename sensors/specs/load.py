"""Sensors by name, or from a file of one's own."""

from __future__ import annotations

from pathlib import Path

from sensors.specs.model import SensorSpec
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import read_document

FOLDER = Path(__file__).parent
SCHEMA = FOLDER / "sensor.schema.json"


def names() -> list[str]:
    """Names of the sensors that come with the package."""
    return sorted(path.stem for path in FOLDER.glob("*.json") if path != SCHEMA)


def load_sensor(name: str | Path) -> SensorSpec:
    """The sensor called `name`, or the one that a JSON file describes.

    Args:
        name: a built-in name, in any case; or a path, told by its suffix or a separator.

    Raises:
        ToolkitError: no such sensor, or a file that does not describe one: the message names the
            field.
    """
    path = Path(name)
    if path.suffix.lower() == ".json" or len(path.parts) > 1:
        return read_document(path, SensorSpec)
    if str(name).lower() not in names():
        raise ToolkitError(
            "no such sensor",
            field="sensor",
            value=str(name),
            hint=f"known: {', '.join(names())}; or give the path of a .json file",
        )
    return read_document(FOLDER / f"{str(name).lower()}.json", SensorSpec)
