"""Recordings that several tests read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.sensors.record.software_camera import SoftwareCamera

FRAMES = 24


@pytest.fixture(scope="session")
def recorded_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of 24 frames that the installed librealsense recorded from a software device."""
    pytest.importorskip("pyrealsense2")
    from tests.sensors.record.software_camera import record_file

    folder = tmp_path_factory.mktemp("recorded")
    try:
        return record_file(folder / "software.db3", FRAMES)
    except RuntimeError:  # librealsense before 2.58
        return record_file(folder / "software.bag", FRAMES)


@pytest.fixture
def camera() -> Iterator[SoftwareCamera]:
    pytest.importorskip("pyrealsense2")
    from tests.sensors.record.software_camera import SoftwareCamera

    made = SoftwareCamera()
    yield made
    made.close()
