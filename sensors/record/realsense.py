"""librealsense: connected cameras, their information, and the streams to record."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sensors.record.options import StreamRequest
from sensors.record.recording_document import DeviceInfo
from std_toolkit.errors import ToolkitError

INFRARED = ("infrared_left", "infrared_right")


def librealsense() -> Any:
    """The module pyrealsense2.

    Raises:
        ToolkitError: it is not installed, or cannot be loaded.
    """
    try:
        import pyrealsense2
    except ImportError as error:
        raise ToolkitError(
            f"librealsense is not there: {error}", hint="pip install 'std-toolkit[realsense]'"
        ) from error
    # The remaining folder of a removed package imports as an empty module.
    if not hasattr(pyrealsense2, "context"):
        raise ToolkitError(
            "librealsense is not there: pyrealsense2 is empty",
            hint="pip install --force-reinstall 'std-toolkit[realsense]'",
        )
    return pyrealsense2


def connected() -> list[Any]:
    """Connected devices."""
    rs = librealsense()
    try:
        return list(rs.context().query_devices())
    except RuntimeError as error:
        raise ToolkitError(f"librealsense cannot look for cameras: {error}") from error


def device_info(device: Any) -> DeviceInfo:
    """Information reported by a device."""
    rs = librealsense()

    def described(key: str) -> str:
        info = getattr(rs.camera_info, key)
        return str(device.get_info(info)) if device.supports(info) else ""

    return DeviceInfo(
        name=described("name"),
        serial=described("serial_number"),
        firmware=described("firmware_version"),
        product_line=described("product_line"),
        usb=described("usb_type_descriptor"),
    )


def choose(devices: Sequence[Any], serial: str | None) -> Any:
    """The camera with this serial number, or the only one.

    Raises:
        ToolkitError: none is connected, none has the number, or several are connected.
    """
    infos = [device_info(d) for d in devices]
    described = ", ".join(f"{i.serial} ({i.name})" for i in infos)
    if not devices:
        raise ToolkitError(
            "no RealSense camera is connected",
            hint="check the cable (USB 3) and the udev rules; `std-record --list` shows cameras",
        )
    if serial is None:
        if len(devices) > 1:
            raise ToolkitError(
                "several cameras are connected", field="--serial", hint=f"choose one: {described}"
            )
        return devices[0]
    for device, info in zip(devices, infos, strict=True):
        if info.serial == serial:
            return device
    raise ToolkitError(
        "no camera of this serial number",
        field="--serial",
        value=serial,
        hint=f"connected: {described}",
    )


@dataclass(frozen=True)
class Stream:
    """A stream of a device: its sensor and its profile."""

    sensor: Any
    profile: Any


def requested_streams(device: Any, request: StreamRequest) -> dict[str, Stream]:
    """The streams of a connected camera, by the toolkit's names.

    Raises:
        ToolkitError: the camera does not offer one of them; the message lists the available ones.
    """
    rs = librealsense()
    wanted = {
        "color": (rs.stream.color, 0, rs.format.rgb8, request.color),
        "depth": (rs.stream.depth, 0, rs.format.z16, request.depth),
    }
    if request.infrared:
        wanted["infrared_left"] = (rs.stream.infrared, 1, rs.format.y8, request.depth)
        wanted["infrared_right"] = (rs.stream.infrared, 2, rs.format.y8, request.depth)
    found = {}
    for name, (kind, index, form, size) in wanted.items():
        offered = [
            s
            for s in video_streams(device)
            if s.profile.stream_type() == kind
            and s.profile.format() == form
            and s.profile.stream_index() == index
        ]
        fitting = [s for s in offered if (*_size(s), s.profile.fps()) == (*size, request.fps)]
        if not fitting:
            raise ToolkitError(
                "the camera does not offer this",
                field=name,
                value=f"{size[0]}x{size[1]} at {request.fps} fps",
                hint=f"it offers {_listed(offered)}" if offered else "it has no such stream",
            )
        found[name] = fitting[0]
    return found


def recorded_streams(device: Any, path: str, *, infrared: bool) -> dict[str, Stream]:
    """The streams in a file, by the toolkit's names.

    Raises:
        ToolkitError: colour, depth or a requested stream is missing.
    """
    rs = librealsense()
    kinds = {
        (rs.stream.color, 0): "color",
        (rs.stream.depth, 0): "depth",
        (rs.stream.infrared, 1): INFRARED[0],
        (rs.stream.infrared, 2): INFRARED[1],
    }
    found: dict[str, Stream] = {}
    for stream in video_streams(device):
        profile = stream.profile
        name = kinds.get((profile.stream_type(), profile.stream_index()))
        if name is not None and name not in found:
            found[name] = stream
    for name, wanted in {"color": True, "depth": True, "infrared_left": infrared}.items():
        if wanted and name not in found:
            held = ", ".join(sorted(s.profile.stream_name() for s in video_streams(device)))
            raise ToolkitError(
                f"the file holds no {name.replace('_left', '')} images",
                path=path,
                hint=f"it holds {held or 'no images at all'}",
            )
    return {n: s for n, s in found.items() if infrared or n not in INFRARED}


def video_streams(device: Any) -> list[Stream]:
    """All image streams of a device."""
    return [
        Stream(sensor, profile.as_video_stream_profile())
        for sensor in device.query_sensors()
        for profile in sensor.get_stream_profiles()
        if profile.is_video_stream_profile()
    ]


def _size(stream: Stream) -> tuple[int, int]:
    return stream.profile.width(), stream.profile.height()


def _listed(streams: list[Stream]) -> str:
    """Such as `1280x720 (6, 15, 30 fps), 640x480 (30, 60 fps)`."""
    rates: dict[tuple[int, int], set[int]] = {}
    for stream in streams:
        rates.setdefault(_size(stream), set()).add(stream.profile.fps())
    return ", ".join(
        f"{w}x{h} ({', '.join(map(str, sorted(rates[w, h])))} fps)"
        for w, h in sorted(rates, reverse=True)
    )
