"""librealsense: whether it is there, which cameras are connected, what they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sensors.record.frames import DeviceInfo
from std_toolkit.errors import ToolkitError


def librealsense() -> Any:
    """The module pyrealsense2.

    Raises:
        ToolkitError: it is not installed, or does not load.
    """
    try:
        import pyrealsense2
    except ImportError as error:
        raise ToolkitError(
            f"librealsense is not there: {error}", hint="pip install 'std-toolkit[realsense]'"
        ) from error
    # A folder left behind by a removed package imports as an empty one.
    if not hasattr(pyrealsense2, "context"):
        raise ToolkitError(
            "librealsense is not there: pyrealsense2 is empty",
            hint="pip install --force-reinstall 'std-toolkit[realsense]'",
        )
    return pyrealsense2


def connected() -> list[Any]:
    """Devices that are plugged in."""
    rs = librealsense()
    try:
        return list(rs.context().query_devices())
    except RuntimeError as error:
        raise ToolkitError(f"librealsense cannot look for cameras: {error}") from error


def device_info(device: Any) -> DeviceInfo:
    """What a device says about itself."""
    rs = librealsense()

    def told(key: str) -> str:
        info = getattr(rs.camera_info, key)
        return str(device.get_info(info)) if device.supports(info) else ""

    return DeviceInfo(
        name=told("name"),
        serial=told("serial_number"),
        firmware=told("firmware_version"),
        product_line=told("product_line"),
        usb=told("usb_type_descriptor"),
    )


def choose(devices: Sequence[Any], serial: str | None) -> Any:
    """The camera of this serial number, or the only one.

    Raises:
        ToolkitError: none is connected, none has the number, or there are several to choose from.
    """
    infos = [device_info(d) for d in devices]
    told = ", ".join(f"{i.serial} ({i.name})" for i in infos)
    if not devices:
        raise ToolkitError(
            "no RealSense camera is connected",
            hint="check the cable (USB 3) and the udev rules; `std-record --list` shows cameras",
        )
    if serial is None:
        if len(devices) > 1:
            raise ToolkitError(
                "several cameras are connected", field="--serial", hint=f"choose one: {told}"
            )
        return devices[0]
    for device, info in zip(devices, infos, strict=True):
        if info.serial == serial:
            return device
    raise ToolkitError(
        "no camera of this serial number", field="--serial", value=serial, hint=f"connected: {told}"
    )
