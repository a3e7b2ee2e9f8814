"""A connected RealSense as a live camera, such as `std-restore live` reads."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from sensors.align import align_depth
from sensors.record import realsense
from sensors.record.device_source import DeviceSource
from sensors.record.options import StreamRequest
from std_toolkit.cameras import CameraRequest, LiveFrame
from std_toolkit.geometry.camera import Camera


class RealSenseCamera:
    """Colour and depth of a RealSense; depth is aligned to colour by the toolkit.

    Args:
        request: serial number, image size of both streams, frame rate.
        devices: devices to choose from instead of the connected ones.

    Raises:
        ToolkitError: pyrealsense2 is not installed, or no camera fits the request.
    """

    name: str
    camera: Camera

    def __init__(self, request: CameraRequest, devices: Sequence[Any] | None = None) -> None:
        found = realsense.connected() if devices is None else devices
        device = realsense.choose(found, request.serial)
        wanted = StreamRequest(color=request.size, depth=request.size, fps=request.fps)
        streams = realsense.requested_streams(device, wanted)
        self._source = DeviceSource(device, streams, playback=False, stop=request.stop)
        info = realsense.device_info(device)
        self.name = f"{info.name} {info.serial}".strip()
        self.camera = self._source.calibration.color.camera()

    def frames(self) -> Iterator[LiveFrame]:
        """See `LiveCamera`."""
        calibration = self._source.calibration
        depth_camera = calibration.depth.camera()
        for frame in self._source.frames():
            metres = align_depth(
                frame.depth * np.float64(calibration.depth_unit_m),
                depth_camera,
                self.camera,
                calibration.T_color_depth,
            )
            yield LiveFrame(frame.color, metres, frame.timestamp)

    def close(self) -> None:
        """Stop the camera."""
        self._source.close()
