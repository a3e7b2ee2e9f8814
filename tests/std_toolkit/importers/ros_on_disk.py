"""Small recordings of ROS, written with the package `rosbags`."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

SIZE = (96, 64)
K = (80.0, 81.0, 47.0, 32.5)
COLOR, DEPTH = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"


def color_image(number: int) -> NDArray[np.uint8]:
    """(64, 96, 3) RGB: a ramp that moves; no channel equals another."""
    x = np.arange(SIZE[0], dtype=np.uint8)
    image = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    image[..., 0] = x + 3 * number
    image[..., 1] = np.arange(SIZE[1], dtype=np.uint8)[:, None]
    image[..., 2] = 200
    return image


def depth_mm(number: int) -> NDArray[np.uint16]:
    """(64, 96) millimetres: a slanted plane with a hole."""
    depth = np.full(SIZE[::-1], 700 + number, np.uint16) + np.arange(SIZE[0], dtype=np.uint16)
    depth[10:20, 30:40] = 0
    return depth


class RosWriter:
    """Writes messages of one camera.

    Args:
        path: folder of rosbag2, or a .bag of ROS 1.
        storage: `mcap` or `sqlite3`, of rosbag2.
    """

    def __init__(self, path: Path, storage: str = "mcap") -> None:
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_typestore

        self.is2 = path.suffix != ".bag"
        self.store = get_typestore(Stores.ROS2_HUMBLE if self.is2 else Stores.ROS1_NOETIC)
        plugin = getattr(rosbag2.StoragePlugin, storage.upper())
        self.writer: Any = (
            rosbag2.Writer(path, version=9, storage_plugin=plugin)
            if self.is2
            else rosbag1.Writer(path)
        )
        self.topics: dict[str, Any] = {}

    def __enter__(self) -> RosWriter:
        self.writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    def type(self, name: str) -> Any:
        return self.store.types[name]

    def header(self, seconds: float, frame: str) -> Any:
        stamp = self.type("builtin_interfaces/msg/Time")(
            sec=int(seconds), nanosec=round(1e9 * (seconds % 1))
        )
        number = {} if self.is2 else {"seq": 0}
        return self.type("std_msgs/msg/Header")(stamp=stamp, frame_id=frame, **number)

    def write(self, topic: str, name: str, seconds: float, **fields: Any) -> None:
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(topic, name, typestore=self.store)
        message = self.type(name)(**fields)
        to_bytes = self.store.serialize_cdr if self.is2 else self.store.serialize_ros1
        # The recorder's clock is a little late.
        self.writer.write(
            self.topics[topic], round(1e9 * seconds) + 2_000_000, to_bytes(message, name)
        )

    def image(
        self,
        topic: str,
        seconds: float,
        pixels: NDArray[Any],
        encoding: str,
        *,
        frame: str = "color_optical",
        padding: int = 0,
        big_endian: bool = False,
    ) -> None:
        values = pixels.astype(pixels.dtype.newbyteorder(">")) if big_endian else pixels
        rows = np.frombuffer(values.tobytes(), np.uint8).reshape(len(pixels), -1)
        rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
        self.write(
            topic,
            "sensor_msgs/msg/Image",
            seconds,
            header=self.header(seconds, frame),
            height=pixels.shape[0],
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=int(big_endian),
            step=rows.shape[1],
            data=rows.reshape(-1),
        )

    def compressed(
        self, topic: str, seconds: float, form: str, data: bytes, frame: str = "color_optical"
    ) -> None:
        self.write(
            topic,
            "sensor_msgs/msg/CompressedImage",
            seconds,
            header=self.header(seconds, frame),
            format=form,
            data=np.frombuffer(data, np.uint8),
        )

    def info(
        self,
        topic: str,
        seconds: float,
        d: Sequence[float] = (0,) * 5,
        model: str = "plumb_bob",
        frame: str = "color_optical",
        *,
        k: tuple[float, float, float, float] = K,
        size: tuple[int, int] = SIZE,
        binning: tuple[int, int] = (0, 0),
        region: tuple[int, int, int, int] = (0, 0, 0, 0),
    ) -> None:
        fx, fy, cx, cy = k
        names = "dkrp" if self.is2 else "DKRP"
        matrices = (
            np.array(d, float),
            np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0]),
            np.eye(3).reshape(-1),
            np.array([fx + 2, 0, cx, 0, 0, fy + 2, cy, 0, 0, 0, 1.0, 0]),
        )
        x, y, w, h = region
        roi = self.type("sensor_msgs/msg/RegionOfInterest")(x, y, h, w, False)
        self.write(
            topic,
            "sensor_msgs/msg/CameraInfo",
            seconds,
            header=self.header(seconds, frame),
            height=size[1],
            width=size[0],
            distortion_model=model,
            binning_x=binning[0],
            binning_y=binning[1],
            roi=roi,
            **dict(zip(names, matrices, strict=True)),
        )


def write_recording(path: Path, *, storage: str = "mcap", frames: int = 4, fps: float = 10) -> Path:
    """Colour and aligned depth, raw, with all that realsense2_camera records beside them.

    The depth of a frame is 4 ms later than its colour. Returns what is imported.
    """
    with RosWriter(path, storage) as out:
        for i in range(frames):
            t = 100.0 + i / fps
            out.info("/camera/color/camera_info", t)
            out.image(COLOR, t, color_image(i), "rgb8", padding=8)
            out.image("/camera/infra1/image_rect_raw", t, color_image(i)[..., 0], "mono8")
            out.image(
                "/camera/depth/image_rect_raw", t, depth_mm(i)[::2, ::2], "16UC1", frame="depth"
            )
            out.image(DEPTH, t + 0.004, depth_mm(i), "16UC1")
    return path


def compressed_depth(depth: NDArray[Any], *, quantised: bool = False) -> bytes:
    """As compressed_depth_image_transport writes it; floating-point metres are quantised."""
    a = b = 0.0
    if quantised:
        # Its defaults: depth_max 10, depth_quantization 100.
        a = 100.0 * 101.0
        b = 1.0 - a / 10.0
        with np.errstate(divide="ignore"):
            depth = np.where(depth > 0, a / depth + b, 0).astype(np.uint16)
    _, png = cv2.imencode(".png", depth)
    return struct.pack("<iff", 0, a, b) + bytes(png)
