"""A camera's own calibration beside the specification of its model."""

from __future__ import annotations

import re

import numpy as np

from sensors.record.frames import Calibration, DeviceInfo
from sensors.specs import SensorSpec, load_sensor, names
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import rotation_angle

# Units of one model differ by less: three D435 that were read out lie within 1.5 % in focal
# length, 12 px of 1280 in the principal point and 0.3 mm in the baseline.
_FOCAL = 0.04
_CENTRE = 0.03  # of the image's width
_BASELINE = 0.05
_PLACE_M = 0.006
_TURN_DEG = 3.0


def sensor_of(info: DeviceInfo) -> str | None:
    """Name of the built-in specification of a device, by its name: "Intel RealSense D435I"."""
    found = re.search(r"\b(D\d{3})", info.name.upper())
    name = found.group(1).lower() if found else ""
    return name if name in names() else None


def compare(info: DeviceInfo, calibration: Calibration, sensor: str | None) -> list[str]:
    """What does not fit, one sentence each; empty if all does.

    Args:
        sensor: name or file of the specification that the user expects, or None for that of the
            device's own model.

    Raises:
        ToolkitError: no such specification.
    """
    own = sensor_of(info)
    notes = []
    if sensor is None:
        if own is None:
            return [f"there is no specification of {info.name or 'this camera'} to compare with"]
        spec = load_sensor(own)
    else:
        spec = load_sensor(sensor)
        if own is not None and spec.name in names() and own != spec.name:
            notes.append(f"the camera is {info.name}, not {spec.title} as --sensor says")
    return notes + _differences(calibration, spec)


def _differences(calibration: Calibration, spec: SensorSpec) -> list[str]:
    notes = []
    for name, model, listed in (
        ("colour", calibration.color, spec.color_camera),
        ("depth", calibration.depth, spec.infrared_camera),
    ):
        try:
            camera = listed(model.width, model.height)
        except ToolkitError:
            notes.append(f"{spec.title}: no {name} of {model.width}x{model.height} is specified")
            continue
        notes += _camera_differences(f"{spec.title}: {name}", model.camera(), camera)
    if calibration.baseline_m is not None:
        off = calibration.baseline_m / spec.baseline_m - 1
        if abs(off) > _BASELINE:
            notes.append(
                f"{spec.title}: baseline {1000 * calibration.baseline_m:.1f} mm, specified "
                f"{1000 * spec.baseline_m:.1f} mm"
            )
    relative = calibration.T_color_depth @ spec.pose_of_color
    apart, turned = float(np.linalg.norm(relative.t)), np.rad2deg(rotation_angle(relative.R))
    if apart > _PLACE_M or turned > _TURN_DEG:
        notes.append(
            f"{spec.title}: the colour camera is {1000 * apart:.1f} mm and {turned:.1f} degrees "
            "from its specified place"
        )
    return notes


def _camera_differences(title: str, camera: Camera, listed: Camera) -> list[str]:
    notes = []
    for name in ("fx", "fy"):
        own, specified = getattr(camera, name), getattr(listed, name)
        if abs(own / specified - 1) > _FOCAL:
            notes.append(f"{title} {name} {own:.1f}, specified {specified:.1f}")
    for name in ("cx", "cy"):
        own, specified = getattr(camera, name), getattr(listed, name)
        if abs(own - specified) > _CENTRE * camera.width:
            notes.append(f"{title} {name} {own:.1f}, specified {specified:.1f}")
    return notes
