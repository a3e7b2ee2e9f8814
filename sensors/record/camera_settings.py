"""Exposure, emitter and preset of a connected camera."""

from typing import Any

from sensors.record.options import CameraSettings
from sensors.record.realsense import Stream, librealsense
from std_toolkit.errors import ToolkitError

# Exposure options with a maximum from this value are in microseconds, others in units of 0.1 ms.
_MICROSECONDS_FROM = 50_000


def apply_settings(streams: dict[str, Stream], settings: CameraSettings) -> dict[str, str]:
    """Apply the settings. The preset comes first because it changes other options.

    Returns:
        The applied settings, as written to recording.json.

    Raises:
        ToolkitError: the camera has no such option, or the value is out of its range.
    """
    color, depth = streams["color"].sensor, streams["depth"].sensor
    done: dict[str, str] = {}
    if settings.preset is not None:
        done["preset"] = _set_preset(depth, settings.preset)
    if settings.exposure is not None:
        done["exposure"] = _set_exposure(color, settings.exposure, "--exposure")
    if settings.gain is not None:
        done["gain"] = _set(color, "gain", settings.gain, "--gain")
    if settings.white_balance is not None:
        automatic = isinstance(settings.white_balance, str)
        _set(color, "enable_auto_white_balance", float(automatic), "--white-balance")
        if not automatic:
            _set(color, "white_balance", float(settings.white_balance), "--white-balance")
        done["white_balance"] = str(settings.white_balance)
    if settings.infrared_exposure is not None:
        done["infrared_exposure"] = _set_exposure(
            depth, settings.infrared_exposure, "--infrared-exposure"
        )
    if settings.laser is not None:
        done["laser"] = _set_laser(depth, settings.laser)
    return done


def lock(
    streams: dict[str, Stream], settings: CameraSettings, exposure_s: float | None
) -> dict[str, str]:
    """Fix the settings that are automatic only until recording starts.

    Args:
        exposure_s: exposure of the last colour image, from its metadata. The exposure option
            cannot be used: in automatic mode it returns the last manual value. Without metadata
            the camera keeps the exposure that it has when automatic exposure ends.

    Returns:
        The fixed settings.
    """
    color = streams["color"].sensor
    done = {}
    if settings.exposure == "lock":
        if exposure_s is None:
            _set(color, "enable_auto_exposure", 0.0, "--exposure")
            done["exposure"] = "lock"
        else:
            done["exposure"] = f"lock: {_set_exposure(color, 1000 * exposure_s, '--exposure')}"
    if settings.white_balance == "lock":
        _set(color, "enable_auto_white_balance", 0.0, "--white-balance")
        done["white_balance"] = "lock"
    return done


def _set_exposure(sensor: Any, wanted: str | float, flag: str) -> str:
    automatic = isinstance(wanted, str)
    _set(sensor, "enable_auto_exposure", float(automatic), flag)
    if automatic:
        return str(wanted)
    largest = _range(sensor, "exposure", flag).max
    per_ms = 1000 if largest >= _MICROSECONDS_FROM else 10
    _set(sensor, "exposure", round(float(wanted) * per_ms), flag, per=per_ms, unit="ms")
    return f"{float(wanted):g} ms"


def _set_laser(sensor: Any, wanted: str | float) -> str:
    _set(sensor, "emitter_enabled", float(wanted != "off"), "--laser")
    if wanted == "max":
        wanted = float(_range(sensor, "laser_power", "--laser").max)
    if not isinstance(wanted, str):
        _set(sensor, "laser_power", float(wanted), "--laser", unit="mW")
        return f"{float(wanted):g} mW"
    return wanted


def _set_preset(sensor: Any, wanted: str) -> str:
    rs = librealsense()
    option = rs.option.visual_preset
    limits = _range(sensor, "visual_preset", "--preset")
    named: dict[str, float] = {}
    for value in range(int(limits.min), int(limits.max) + 1):
        try:
            described = sensor.get_option_value_description(option, float(value))
        except RuntimeError:
            continue
        if described:
            named[str(described).lower()] = float(value)
    key = wanted.lower().replace("-", " ").replace("_", " ")
    if key not in named:
        raise ToolkitError(
            "the camera has no such preset",
            field="--preset",
            value=wanted,
            hint=f"it has {', '.join(named) or 'none'}",
        )
    _set(sensor, "visual_preset", named[key], "--preset")
    return key


def _set(
    sensor: Any, option: str, value: float, flag: str, *, per: float = 1, unit: str = ""
) -> str:
    limits = _range(sensor, option, flag)
    if not limits.min <= value <= limits.max:
        raise ToolkitError(
            f"must lie between {limits.min / per:g} and {limits.max / per:g} {unit}".strip(),
            field=flag,
            value=value / per,
        )
    try:
        sensor.set_option(getattr(librealsense().option, option), value)
    except RuntimeError as error:
        raise ToolkitError(
            f"the camera refuses it: {error}", field=flag, value=value / per
        ) from error
    return f"{value / per:g} {unit}".strip()


def _range(sensor: Any, option: str, flag: str) -> Any:
    key = getattr(librealsense().option, option)
    if not sensor.supports(key):
        raise ToolkitError(
            f"this camera has no option {option.replace('_', ' ')}", field=flag, hint="leave it out"
        )
    return sensor.get_option_range(key)
