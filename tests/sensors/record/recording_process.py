"""A process that records from a software device for ever: `python recording_process.py SCENE`."""

from __future__ import annotations

import sys

from sensors.record.cli import main
from tests.sensors.record.software_camera import SoftwareCamera

if __name__ == "__main__":
    camera = SoftwareCamera()
    camera.feed(1_000_000, rate=60)
    arguments = [*sys.argv[1:], "--color", "320x180", "--depth", "320x180", "--warm-up", "0"]
    status = main(arguments, devices=[camera.device])
    camera.close()
    sys.exit(status)
