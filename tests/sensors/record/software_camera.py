"""A D415 that is not there: librealsense's software device, fed with images of a known scene."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyrealsense2 as rs
from numpy.typing import NDArray

from sensors.specs import load_sensor
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3

COLOR_SIZE, DEPTH_SIZE, FPS = (320, 180), (320, 180), 30
SPEC = load_sensor("d415")
COLOR = SPEC.color_camera(*COLOR_SIZE)
DEPTH = SPEC.infrared_camera(*DEPTH_SIZE)
T_COLOR_DEPTH = SPEC.pose_of_color.inverse()


@dataclass(frozen=True)
class Pictures:
    """What the streams show at one time."""

    color: NDArray[np.uint8]
    depth: NDArray[np.uint16]
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]


@cache
def pictures(number: int) -> Pictures:
    """A textured wall that moves by three pixels a frame, at 800 mm and `number` more; a hole."""
    rng = np.random.default_rng(7)
    width, height = COLOR_SIZE
    coarse = rng.integers(40, 216, (height // 6, 4 * width // 6, 3), dtype=np.uint8)
    wall = cv2.resize(coarse, (4 * width, height), interpolation=cv2.INTER_CUBIC)
    start = (3 * number) % (3 * width)
    color = np.ascontiguousarray(wall[:, start : start + width])
    depth = np.full(DEPTH_SIZE[::-1], 800 + number, dtype=np.uint16)
    depth[60:80, 100:130] = 0
    left = np.full(DEPTH_SIZE[::-1], 50 + number % 100, dtype=np.uint8)
    return Pictures(color, depth, left, left + 1)


def plain_pictures(number: int) -> Pictures:
    """As `pictures`, without texture: a file of them is small."""
    color = np.zeros((*COLOR_SIZE[::-1], 3), dtype=np.uint8)
    color[:] = (40 + number, 90, 200)
    color[40:140, 60:160] = (200, 60, 20 + number)
    return replace(pictures(number), color=color)


def rs_intrinsics(
    camera: Camera, model: Any = None, coefficients: Sequence[float] = (0.0,) * 5
) -> Any:
    out = rs.intrinsics()
    out.width, out.height, out.fx, out.fy = camera.width, camera.height, camera.fx, camera.fy
    out.ppx, out.ppy = camera.cx, camera.cy
    out.model, out.coeffs = model or rs.distortion.none, list(coefficients)
    return out


def rs_extrinsics(T: SE3) -> Any:
    out = rs.extrinsics()
    out.rotation, out.translation = list(T.R.T.ravel()), list(T.t)  # rotation by columns
    return out


class SoftwareCamera:
    """Streams of a software device.

    Args:
        streams: which of "color", "depth", "infrared" there are.
        options: further writable options of the depth and the colour sensor: name to
            (least, largest, step, default).
    """

    def __init__(
        self,
        name: str = "Intel RealSense D415",
        serial: str = "840412060001",
        *,
        streams: Sequence[str] = ("color", "depth", "infrared"),
        color: Camera = COLOR,
        depth: Camera = DEPTH,
        T_color_depth: SE3 = T_COLOR_DEPTH,
        depth_unit: float = 0.001,
        extrinsics: bool = True,
        depth_options: dict[str, tuple[float, float, float, float]] | None = None,
        color_options: dict[str, tuple[float, float, float, float]] | None = None,
    ) -> None:
        self.device = rs.software_device()
        self.device.register_info(rs.camera_info.name, name)
        self.device.register_info(rs.camera_info.serial_number, serial)
        self.device.register_info(rs.camera_info.firmware_version, "5.16.0.1")
        self.device.register_info(rs.camera_info.product_line, "D400")
        self.depth_unit = depth_unit
        self.profiles: dict[str, tuple[Any, Any]] = {}
        self._uid = 0
        stereo = self.device.add_sensor("Stereo Module")
        rgb = self.device.add_sensor("RGB Camera")
        if "depth" in streams:
            self._add(stereo, "depth", rs.stream.depth, 0, depth, 2, rs.format.z16)
        if "infrared" in streams:
            self._add(stereo, "left", rs.stream.infrared, 1, depth, 1, rs.format.y8)
            self._add(stereo, "right", rs.stream.infrared, 2, depth, 1, rs.format.y8)
        if "color" in streams:
            self._add(rgb, "color", rs.stream.color, 0, color, 3, rs.format.rgb8)
        stereo.add_read_only_option(rs.option.depth_units, depth_unit)
        stereo.add_read_only_option(rs.option.stereo_baseline, 1000 * SPEC.baseline_m)
        for sensor, options in ((stereo, depth_options), (rgb, color_options)):
            for option, limits in (options or {}).items():
                allowed = rs.option_range()
                allowed.min, allowed.max, allowed.step, allowed.default = limits
                sensor.add_option(getattr(rs.option, option), allowed, True)
        if extrinsics and {"color", "depth"} <= set(streams):
            self._place("depth", "color", T_color_depth)
        if extrinsics and {"infrared", "depth"} <= set(streams):
            self._place("depth", "left", SE3.identity())
            self._place("left", "right", SE3(np.eye(3), np.array([-SPEC.baseline_m, 0, 0])))
        self._feeder: threading.Thread | None = None
        self._stop = threading.Event()

    def _add(
        self, sensor: Any, name: str, kind: Any, index: int, camera: Camera, size: int, form: Any
    ) -> None:
        stream = rs.video_stream()
        stream.type, stream.index, stream.uid, stream.fps = kind, index, self._uid, FPS
        stream.width, stream.height, stream.bpp, stream.fmt = (*camera.size, size, form)
        stream.intrinsics = rs_intrinsics(camera)
        self._uid += 1
        self.profiles[name] = (sensor, sensor.add_video_stream(stream))

    def _place(self, a: str, b: str, T_b_a: SE3) -> None:
        self.profiles[a][1].register_extrinsics_to(self.profiles[b][1], rs_extrinsics(T_b_a))

    def send(
        self, number: int, *, only: Sequence[str] | None = None, shown: Pictures | None = None
    ) -> None:
        """One image of each stream."""
        images = vars(shown or pictures(number))
        for name, (sensor, profile) in self.profiles.items():
            if only is not None and name not in only:
                continue
            frame = rs.software_video_frame()
            frame.pixels = np.ascontiguousarray(images[name])
            frame.bpp = {"color": 3, "depth": 2}.get(name, 1)
            frame.stride = frame.bpp * images[name].shape[1]
            # Streams of one trigger differ a little in their times.
            frame.timestamp = 1000.0 + 1000 * number / FPS + (0.4 if name == "color" else 0.0)
            frame.frame_number, frame.domain = number, rs.timestamp_domain.hardware_clock
            frame.profile = profile.as_video_stream_profile()
            if name == "depth":
                frame.depth_units = self.depth_unit
            sensor.on_video_frame(frame)

    def feed(
        self,
        frames: int,
        *,
        rate: float = 100.0,
        step: Callable[[int], None] | None = None,
    ) -> None:
        """Send frames from another thread, as soon as the streams were started."""
        self._stop.clear()

        def run() -> None:
            sensors = [sensor for sensor, _ in self.profiles.values()]
            while not all(s.get_active_streams() for s in sensors):
                if self._stop.wait(0.01):
                    return
            time.sleep(0.05)  # opened; started a moment later
            for number in range(frames):
                if self._stop.wait(1 / rate):
                    return
                (step or self.send)(number)

        self._feeder = threading.Thread(target=run, daemon=True)
        self._feeder.start()

    def close(self) -> None:
        self._stop.set()
        if self._feeder is not None:
            self._feeder.join()


def record_file(
    path: Path,
    frames: int,
    camera: SoftwareCamera | None = None,
    shown: Callable[[int], Pictures] = pictures,
) -> Path:
    """A file recorded by librealsense's own recorder.

    Args:
        path: librealsense before 2.58 records .bag alone, later ones .db3 alone.
    """
    camera = camera or SoftwareCamera()
    recorder = rs.recorder(str(path), camera.device)
    sink = rs.frame_queue(1)
    sensors = [s for s in recorder.query_sensors() if s.get_stream_profiles()]
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles())
        sensor.start(sink)
    for number in range(frames):
        camera.send(number, shown=shown(number))
        time.sleep(0.004)  # the recorder writes in its own thread, and gives up what it cannot hold
    time.sleep(0.3)
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    del recorder
    return path
