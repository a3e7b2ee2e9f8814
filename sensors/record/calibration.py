"""Calibration read from the camera, as OpenCV models, compared with its specification."""

import re
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from sensors.record.realsense import Stream, librealsense
from sensors.record.recording_document import Calibration, DeviceInfo
from sensors.specs import SensorSpec, load_sensor, names
from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, rotation_angle
from std_toolkit.scene.model import CameraModel

# A larger residual of the fit with OpenCV's model would shift labels.
LARGEST_RESIDUAL_PX = 0.05

_GRID = 33

# Differences between units of one model are smaller: three D435 are within 1.5 % in focal
# length, 12 px of 1280 in the principal point and 0.3 mm in the baseline.
_FOCAL = 0.04

_CENTRE = 0.03  # of the image's width

_BASELINE = 0.05

_PLACE_M = 0.006

_TURN_DEG = 3.0


def read_calibration(streams: dict[str, Stream]) -> Calibration:
    """Intrinsics of the streams, the pose between depth and colour, and the unit of depth.

    Raises:
        ToolkitError: the device does not report one of them, or reports an invalid value.
    """
    models, notes = {}, []
    for name, stream in streams.items():
        try:
            models[name], note = camera_model(stream.profile.get_intrinsics(), name)
        except RuntimeError as error:
            raise ToolkitError(
                f"the camera does not report its intrinsics: {error}", field=name
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
            "the pose between colour and depth is not reported: depth cannot be aligned",
            field="extrinsics",
        ) from error


def _unit(sensor: Any) -> float:
    rs = librealsense()
    if sensor.supports(rs.option.depth_units):
        # Stored as float32: 0.001 comes as 0.0010000000474974513.
        unit = float(f"{sensor.get_option(rs.option.depth_units):.7g}")
        if np.isfinite(unit) and unit > 0:
            return unit
    raise ToolkitError("the unit of depth is not reported", field="depth units")


def _baseline(streams: dict[str, Stream]) -> float | None:
    rs = librealsense()
    left, right = streams.get("infrared_left"), streams.get("infrared_right")
    if left is not None and right is not None:
        try:
            return float(np.linalg.norm(pose(left.profile.get_extrinsics_to(right.profile)).t))
        except RuntimeError:
            pass  # some cameras report it as an option, read below
    sensor = streams["depth"].sensor
    if sensor.supports(rs.option.stereo_baseline):
        return abs(float(f"{sensor.get_option(rs.option.stereo_baseline):.7g}")) / 1000 or None
    return None


def camera_model(intrinsics: Any, stream: str) -> tuple[CameraModel, str]:
    """Intrinsics of a stream, and a note if its lens model had to be converted.

    librealsense places pixel centres at integers, as the toolkit does. Its "Brown Conrady" is
    OpenCV's model; "Modified Brown Conrady" applies the radial scale before the tangential terms.
    "Inverse Brown Conrady" (the colour camera of a D455) is documented as a map from distorted to
    undistorted coordinates, but librealsense projects with it as with the modified model, and
    deprojects accordingly (since 2.44; pull request 8523). Only in this direction is a negative k1,
    which such wide lenses have, barrel distortion. This function follows librealsense. Both kinds
    are fitted by OpenCV's model.

    Args:
        intrinsics: `rs.intrinsics`.
        stream: its name, for messages.

    Raises:
        ToolkitError: another lens model with coefficients, or one that cannot be fitted.
    """
    i = intrinsics
    # The name of the model differs between versions: "distortion.brown_conrady", "Brown Conrady".
    kind = str(i.model).rsplit(".", 1)[-1].lower().replace(" ", "_")
    coefficients = [float(k) for k in i.coeffs]
    plain = Camera(i.width, i.height, i.fx, i.fy, i.ppx, i.ppy)
    if not any(coefficients) or kind == "none":
        return CameraModel.of(plain), ""
    if kind == "brown_conrady":
        bent = Camera(i.width, i.height, i.fx, i.fy, i.ppx, i.ppy, tuple(coefficients))
        return CameraModel.of(bent), ""
    if kind not in ("inverse_brown_conrady", "modified_brown_conrady"):
        raise ToolkitError(
            "a lens model that is not known", field=f"intrinsics of {stream}", value=kind
        )
    fitted, residual = _fit(plain, coefficients)
    if residual > LARGEST_RESIDUAL_PX:
        raise ToolkitError(
            f"the lens does not fit OpenCV's model: {residual:.2f} px residual",
            field=f"intrinsics of {stream}",
            value=coefficients,
        )
    note = f"{stream}: {kind} lens fitted by OpenCV's model to {residual:.4f} px"
    return CameraModel.of(fitted), note


def pose(extrinsics: Any) -> SE3:
    """`rs.extrinsics` from stream a to stream b as `T_b_a`; its rotation is stored by columns.

    Raises:
        ToolkitError: not a rotation.
    """
    R = np.array(extrinsics.rotation, dtype=np.float64).reshape(3, 3).T
    if not np.allclose(R @ R.T, np.eye(3), atol=1e-3) or np.linalg.det(R) < 0:
        raise ToolkitError("is not a rotation", field="extrinsics", value=R.ravel())
    # Stored as float32: up to 1e-7 from a rotation, an error that accumulates in chained poses.
    U, _, Vt = np.linalg.svd(R)
    return SE3(U @ Vt, np.array(extrinsics.translation, dtype=np.float64))


def bend(xy: Array, k: list[float], *, scaled_first: bool) -> Array:
    """Apply the polynomial of k1 k2 p1 p2 k3 to normalised coordinates (N, 2)."""
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    f = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    xs, ys = (x * f, y * f) if scaled_first else (x, y)
    return np.stack(
        [
            x * f + 2 * k[2] * xs * ys + k[3] * (r2 + 2 * xs * xs),
            y * f + 2 * k[3] * xs * ys + k[2] * (r2 + 2 * ys * ys),
        ],
        axis=1,
    )


def _fit(plain: Camera, k: list[float]) -> tuple[Camera, float]:
    """The camera in OpenCV's model, and the largest residual in pixels."""
    u = np.linspace(0, plain.width - 1, _GRID)
    v = np.linspace(0, plain.height - 1, _GRID)
    grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    f, c = np.array([plain.fx, plain.fy]), np.array([plain.cx, plain.cy])
    rays = (grid - c) / f
    pixels = bend(rays, k, scaled_first=True) * f + c

    def left(parameters: Array) -> Array:
        bent = bend(rays, list(parameters), scaled_first=False) * f + c
        return (bent - pixels).ravel()

    found = least_squares(left, np.array(k), x_scale="jac")
    distances = np.hypot(*left(found.x).reshape(-1, 2).T)
    camera = Camera(
        plain.width, plain.height, plain.fx, plain.fy, plain.cx, plain.cy, tuple(found.x)
    )
    return camera, float(distances.max())


def sensor_of(info: DeviceInfo) -> str | None:
    """Name of the built-in specification of a device, by its name: "Intel RealSense D435I"."""
    found = re.search(r"\b(D\d{3})", info.name.upper())
    name = found.group(1).lower() if found else ""
    return name if name in names() else None


def compare(info: DeviceInfo, calibration: Calibration, sensor: str | None) -> list[str]:
    """Deviations from the specification, one sentence each; empty if there are none.

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
