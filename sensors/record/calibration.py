"""A device's calibration, read from its streams."""

from __future__ import annotations

from typing import Any

import numpy as np

from sensors.record.frames import Calibration
from sensors.record.lens import camera_model, pose
from sensors.record.realsense import librealsense
from sensors.record.stream_choice import Stream
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3


def read_calibration(streams: dict[str, Stream]) -> Calibration:
    """Intrinsics of the streams, the pose between depth and colour, and the unit of depth.

    Raises:
        ToolkitError: the device does not tell one of them, or tells what no camera has.
    """
    models, notes = {}, []
    for name, stream in streams.items():
        try:
            models[name], note = camera_model(stream.profile.get_intrinsics(), name)
        except RuntimeError as error:
            raise ToolkitError(
                f"the camera does not tell its intrinsics: {error}", field=name
            ) from error
        except ToolkitError as error:
            raise ToolkitError(
                error.problem, field=f"{name}: {error.field}", value=error.value
            ) from error
        notes += [note] if note else []
    if models["depth"].camera().is_distorted:
        notes.append("depth has a distorted lens; aligning takes it into account")
    return Calibration(
        color=models["color"],
        depth=models["depth"],
        T_color_depth=_between(streams["depth"], streams["color"]),
        depth_unit_m=_unit(streams["depth"].sensor),
        baseline_m=_baseline(streams),
        infrared=models.get("infrared_left"),
        notes=tuple(notes),
    )


def _between(depth: Stream, color: Stream) -> SE3:
    try:
        return pose(depth.profile.get_extrinsics_to(color.profile))
    except RuntimeError as error:
        raise ToolkitError(
            "the place of the colour camera beside depth is not told: depth cannot be aligned",
            field="extrinsics",
        ) from error


def _unit(sensor: Any) -> float:
    rs = librealsense()
    if sensor.supports(rs.option.depth_units):
        # Stored as float32: 0.001 comes as 0.0010000000474974513.
        unit = float(f"{sensor.get_option(rs.option.depth_units):.7g}")
        if np.isfinite(unit) and unit > 0:
            return unit
    raise ToolkitError("the unit of depth is not told", field="depth units")


def _baseline(streams: dict[str, Stream]) -> float | None:
    rs = librealsense()
    left, right = streams.get("infrared_left"), streams.get("infrared_right")
    if left is not None and right is not None:
        try:
            return float(np.linalg.norm(pose(left.profile.get_extrinsics_to(right.profile)).t))
        except RuntimeError:
            pass  # told as an option below, by some
    sensor = streams["depth"].sensor
    if sensor.supports(rs.option.stereo_baseline):
        return abs(float(f"{sensor.get_option(rs.option.stereo_baseline):.7g}")) / 1000 or None
    return None
