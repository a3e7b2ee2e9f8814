"""Single views: a camera that looks at a point, and random viewpoints."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3

Range = tuple[float, float]

# Separates the random numbers of viewpoints from others drawn from the same seed.
_STREAM = 0x71E35

WORLD_UP = (0.0, 0.0, 1.0)

_LOW_DISTANCE_M = 0.6

# Smallest sine of the angle between the line of sight and the up vector that defines a roll.
_LEAST_ANGLE = 1e-6


@dataclass(frozen=True, kw_only=True)
class ViewpointOptions:
    """Ranges of the viewpoints. World frame: z up, floor at z = 0, metres.

    The defaults are the constants of the DREDS generator, with one difference: it draws only the
    second component of the up vector and keeps the first at -0.18, which tilts all images to the
    same side; here both are drawn.

    Attributes:
        count: viewpoints per scene.
        distance_m: range of the distance between the camera and the point that it looks at.
        sideways: the horizontal components of the unit vector from that point to the camera are
            drawn from +-`sideways`, at most 0.7. 0.6 keeps the elevation above 31.9 degrees.
        target_m: point around which the cameras look.
        jitter_m: largest offset of the point looked at from the target along each axis.
        low_share: share of the viewpoints that look from the side, from `low_deg` above the
            horizon and at least 0.6 m away. DREDS has none.
        up_x, up_y: ranges of the horizontal components of the up vector (x, y, 1), which roll the
            image.
    """

    count: int = 30
    distance_m: Range = (0.5, 0.95)
    sideways: float = 0.6
    target_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    jitter_m: float = 0.05
    low_share: float = 0.0
    low_deg: Range = (8.0, 30.0)
    up_x: Range = (-0.18, 0.18)
    up_y: Range = (-0.18, 0.18)

    def __post_init__(self) -> None:
        if self.count < 1:
            raise ToolkitError("must be at least 1", field="count", value=self.count)
        if not 0 < self.distance_m[0] <= self.distance_m[1] < np.inf:
            raise ToolkitError(
                "must be two rising distances above 0", field="distance_m", value=self.distance_m
            )
        # At 1/sqrt(2) the camera could be on the floor.
        if not 0 <= self.sideways <= 0.7:
            raise ToolkitError("must lie in 0..0.7", field="sideways", value=self.sideways)
        if not 0 <= self.jitter_m < np.inf or not np.isfinite(self.target_m).all():
            raise ToolkitError(
                "the point to look at must be finite",
                field="target_m, jitter_m",
                value=(self.target_m, self.jitter_m),
            )
        for name in ("up_x", "up_y"):
            low, high = getattr(self, name)
            if not -1 <= low <= high <= 1:
                raise ToolkitError(
                    "must be two rising numbers in -1..1", field=name, value=(low, high)
                )

    @property
    def least_elevation_rad(self) -> float:
        """Smallest elevation of a camera above the horizon of the point that it looks at."""
        return float(np.arcsin(np.sqrt(1 - 2 * self.sideways**2)))


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """One view of a scene.

    Attributes:
        T_world_cam: OpenCV camera to world.
        target_m: (3,) point that the optical axis goes through.
        up: (3,) vector that defines the image's vertical.
    """

    T_world_cam: SE3
    target_m: NDArray[np.float64] = field(repr=False)
    up: NDArray[np.float64] = field(repr=False)

    @property
    def distance_m(self) -> float:
        """Distance from the camera to the point that it looks at."""
        return float(np.linalg.norm(self.T_world_cam.t - self.target_m))

    @property
    def elevation_rad(self) -> float:
        """Angle of the camera above the horizon of the point that it looks at."""
        return float(np.arcsin((self.T_world_cam.t - self.target_m)[2] / self.distance_m))


def random_viewpoints(seed: int, options: ViewpointOptions | None = None) -> list[Viewpoint]:
    """Viewpoints of one scene.

    Viewpoint i depends only on the seed and i: a larger count does not change earlier ones.

    Args:
        seed: of the scene, 0 or above.
        options: ranges; the defaults are those of DREDS.

    Raises:
        ToolkitError: a negative seed.
    """
    if seed < 0:
        raise ToolkitError("must not be negative", field="seed", value=seed)
    options = options or ViewpointOptions()
    return [_draw(np.random.default_rng([_STREAM, seed, i]), options) for i in range(options.count)]


def _draw(rng: np.random.Generator, options: ViewpointOptions) -> Viewpoint:
    distance = rng.uniform(*options.distance_m)
    x, y = rng.uniform(-options.sideways, options.sideways, 2)
    outward = np.array([x, y, np.sqrt(1 - x * x - y * y)])
    target = np.array(options.target_m) + rng.uniform(-options.jitter_m, options.jitter_m, 3)
    up = np.array([rng.uniform(*options.up_x), rng.uniform(*options.up_y), 1.0])
    if rng.random() < options.low_share:
        elevation = np.deg2rad(rng.uniform(*options.low_deg))
        distance = max(distance, _LOW_DISTANCE_M)
        around = np.arctan2(outward[1], outward[0])
        flat = np.cos(elevation)
        outward = np.array([flat * np.cos(around), flat * np.sin(around), np.sin(elevation)])
        # Above the floor, whatever the jitter.
        target[2] = max(target[2], 0.0)
    if np.linalg.norm(np.cross(outward, up)) < 1e-3:
        up[0] += 1.0  # along the line of sight it would define no roll
    return Viewpoint(look_at(target + distance * outward, target, up=up), target, up)


def look_at(eye: ArrayLike, target: ArrayLike, *, up: ArrayLike = WORLD_UP) -> SE3:
    """T_world_cam of a camera at `eye` whose optical axis goes through `target`.

    Args:
        eye, target: (3,) points in the world, metres.
        up: (3,) direction that points upwards in the image; any length.

    Returns:
        OpenCV camera (x right, y down, z forward) to world; x is perpendicular to `up`.

    Raises:
        ToolkitError: eye and target coincide, or the camera looks along `up`.
    """
    e, t, u = (np.asarray(v, dtype=np.float64) for v in (eye, target, up))
    forward = t - e
    distance = float(np.linalg.norm(forward))
    if not distance > 0:
        raise ToolkitError("the camera stands at the point that it looks at", value=e.tolist())
    forward /= distance
    right = np.cross(forward, u)
    length = float(np.linalg.norm(right))
    if not length > _LEAST_ANGLE * float(np.linalg.norm(u)):
        raise ToolkitError("the camera looks along its up vector", field="up", value=u.tolist())
    right /= length
    return SE3(np.stack([right, np.cross(forward, right), forward], axis=1), e)
