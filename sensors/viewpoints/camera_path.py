"""Smooth paths of a hand-held camera around a table."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sensors.viewpoints.views import look_at
from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, so3_exp

Kind = Literal["arc", "spiral"]
KINDS: tuple[Kind, ...] = ("arc", "spiral")
_STREAM = 0x7124


@dataclass(frozen=True, kw_only=True)
class TrajectoryOptions:
    """A path around the table. World frame: z up, floor at z = 0, metres.

    The camera moves around the target at a constant angular rate. On an `arc` its elevation and
    distance vary slowly within their ranges; on a `spiral` it climbs from the lowest elevation to
    the highest while only the distance varies. A hand's sway is added to its position and a slow
    drift to the point that it looks at. All of them are cubic splines: velocity and acceleration
    are continuous, and more frames only sample the same path more finely.

    Attributes:
        kind: arc or spiral.
        frames: number of frames.
        sweep_deg: angle of the path around the vertical, negative for clockwise.
        start_deg: azimuth of the first frame; None draws it.
        distance_m: range of the distance to the target, before sway.
        elevation_deg: range of the elevation above the target's horizon, before sway.
        target_m: centre of the path.
        drift_m: largest offset, along each axis, of the point looked at from the target.
        sway_m: largest displacement of the hand along each axis.
        roll_deg: largest roll about the optical axis.
        sways: number of changes of the hand's direction along the path.
    """

    kind: Kind = "arc"
    frames: int = 120
    sweep_deg: float = 120.0
    start_deg: float | None = None
    distance_m: tuple[float, float] = (0.55, 0.75)
    elevation_deg: tuple[float, float] = (35.0, 55.0)
    target_m: tuple[float, float, float] = (0.0, 0.0, 0.05)
    drift_m: float = 0.03
    sway_m: float = 0.004
    roll_deg: float = 3.0
    sways: int = 15

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ToolkitError(
                "unknown trajectory", field="kind", value=self.kind, hint=f"one of {KINDS}"
            )
        for name in ("frames", "sways"):
            if getattr(self, name) < 1:
                raise ToolkitError("must be at least 1", field=name, value=getattr(self, name))
        low, high = self.distance_m
        reach = np.sqrt(3) * (self.sway_m + self.drift_m)
        if not reach < low <= high < np.inf:
            raise ToolkitError(
                "must be two rising distances beyond sway and drift",
                field="distance_m",
                value=self.distance_m,
            )
        low, high = self.elevation_deg
        if not 0 <= low <= high <= 85:
            raise ToolkitError(
                "must be two rising angles in 0..85", field="elevation_deg", value=(low, high)
            )
        for name in ("drift_m", "sway_m", "roll_deg"):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                raise ToolkitError("must not be negative", field=name, value=value)
        if not 0 < abs(self.sweep_deg) < np.inf:
            raise ToolkitError("must not be 0", field="sweep_deg", value=self.sweep_deg)


def smooth_trajectory(seed: int, options: TrajectoryOptions | None = None) -> list[SE3]:
    """T_world_cam of every frame along a smooth path.

    Args:
        seed: of start, variation, drift and sway, 0 or above.
        options: shape of the path.

    Raises:
        ToolkitError: a negative seed.
    """
    if seed < 0:
        raise ToolkitError("must not be negative", field="seed", value=seed)
    options = options or TrajectoryOptions()
    rng = np.random.default_rng([_STREAM, seed])
    s = np.linspace(0, 1, options.frames)
    start = rng.uniform(-180, 180)
    if options.start_deg is not None:
        start = options.start_deg
    azimuth = np.radians(start + options.sweep_deg * s)
    low, high = np.radians(options.elevation_deg)
    wander = _wander(rng, s, knots=5, columns=2)
    height = s if options.kind == "spiral" else (1 + wander[:, 0]) / 2
    elevation = low + (high - low) * height
    near, far = options.distance_m
    distance = near + (far - near) * (1 + wander[:, 1]) / 2
    outward = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=1,
    )
    sway = options.sway_m * _wander(rng, s, knots=options.sways + 3, columns=3)
    eyes = np.array(options.target_m) + distance[:, None] * outward + sway
    targets = np.array(options.target_m) + options.drift_m * _wander(rng, s, knots=5, columns=3)
    rolls = np.radians(options.roll_deg) * _wander(rng, s, knots=7, columns=1)[:, 0]
    return [
        _rolled(look_at(eye, target), roll)
        for eye, target, roll in zip(eyes, targets, rolls, strict=True)
    ]


def _wander(rng: np.random.Generator, s: Array, *, knots: int, columns: int) -> Array:
    """(len(s), columns): random smooth functions of s in 0..1, with values in -1..1.

    Cubic splines through random values, scaled down where they overshoot.
    """
    from scipy.interpolate import CubicSpline

    knots = max(knots, 4)
    spline = CubicSpline(np.linspace(0, 1, knots), rng.uniform(-1, 1, (knots, columns)))
    # The extremes of the function, not of its samples: the path must not depend on the frames.
    turning = spline.derivative().roots(extrapolate=False)
    highest = []
    for column, places in enumerate(turning):
        known = np.concatenate([[0.0, 1.0], places[np.isfinite(places)]])
        highest.append(np.abs(spline(known)[:, column]).max())
    return np.asarray(spline(s) / np.maximum(1.0, highest))


def _rolled(T_world_cam: SE3, angle: float) -> SE3:
    return SE3(T_world_cam.R @ so3_exp([0.0, 0.0, angle]), T_world_cam.t)
