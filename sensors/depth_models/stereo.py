"""Active stereo: a projector of dots, two infrared cameras and a stereo matcher.

Real imagers, lenses and rectification are not perfect, so the disparity gets noise that simulated
images and the matcher do not give. On the infrared pair of a real D415, the residuals of the local
matcher in windows of 32 pixels, after a quadratic fit, have a median deviation of 0.047 px and
correlations of 0.90, 0.76 and 0.46 at distances of 1, 2 and 4 pixels; the camera's own depth has
0.054 px. On the simulated plane, shot and read noise give 0.018 to 0.028 px.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.depth_models.depth_model import DepthModelOptions, Illumination, Reading
from sensors.lighting.light_draw import PROJECTOR_POWER
from sensors.pattern import DotPattern, load_pattern, make_pattern
from sensors.render import infrared_image, sim_scene
from sensors.render.sim_renderer import LoadedScene, RenderOptions
from sensors.specs import SensorSpec
from sensors.stereo import disparity_to_depth, make_matcher
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.options import usable_cores

Pair = tuple[NDArray[np.float32], NDArray[np.float32]]

# With the noise of the images, the simulated plane then has 0.040 to 0.046 px.
NOISE_PX = 0.042

# Spread of the Gaussian that correlates it: 0.95, 0.83 and 0.47 at 1, 2 and 4 pixels.
SPREAD_PX = 2.3


class ActiveStereo:
    """See `DepthModel`.

    Args:
        sensor: a stereo camera.
        options: of the data set.

    Raises:
        ToolkitError: not a stereo camera, or an unknown or unusable image size, matcher or pattern.
    """

    def __init__(self, sensor: SensorSpec, options: DepthModelOptions) -> None:
        size = (options.width, options.height)
        self.camera = sensor.infrared_camera(*size)
        low, high = sensor.disparity_range(*size)
        own = {"min_disparity": low, "max_disparity": high}
        if options.matcher == "dreds":  # the released matcher has its own fixed search range
            own = {}
        elif options.matcher == "sgbm":  # searches a multiple of 16
            own = {"min_disparity": low, "disparities": -(-(high - low + 1) // 16) * 16}
        elif options.matcher == "local":
            own["threads"] = options.threads or usable_cores()
        self._matcher = make_matcher(options.matcher, **own)
        self._sensor, self._noise = sensor, options.noise
        self._picture = _picture(sensor, options)
        # The last pattern: frames of one scene, in any number of calls, share it.
        self._pattern: tuple[int, DotPattern | None] | None = None

    def pattern(self, seed: int) -> DotPattern | None:
        """What the projector shows; None if the sensor has none.

        Args:
            seed: of the pattern, unused if the data set has a picture.
        """
        if self._pattern is None or self._pattern[0] != seed:
            made = None
            if self._sensor.projector is not None:
                made = self._picture or make_pattern(self._sensor, seed=seed)
            self._pattern = seed, made
        return self._pattern[1]

    def look(
        self,
        loaded: LoadedScene,
        T_world_ir: SE3,
        light: Illumination,
        *,
        options: RenderOptions,
        seed: int,
    ) -> Pair:
        """Radiance (h, w) float32 at both cameras."""
        projector = None
        pattern = self.pattern(light.pattern_seed)
        if pattern is not None and self._sensor.projector is not None:
            projector = sim_scene.Projector(
                pattern.image,
                pattern.fov_x_deg,
                T_world_ir @ self._sensor.projector.T_ir_projector,
                power=PROJECTOR_POWER * light.factor,
            )
        T_left_right = SE3(np.eye(3), np.array([self._sensor.baseline_m, 0.0, 0.0]))
        return loaded.infrared_pair(
            self.camera,
            (T_world_ir, T_world_ir @ T_left_right),
            projector,
            ambient=light.ambient,
            options=options,
            seed=seed,
        )

    def read(self, received: Pair, *, seed: int) -> Reading:
        """Expose the pair and match it."""
        left, right, _ = infrared_image.expose_pair(
            *received,
            rng=np.random.default_rng([seed, 0]),
            response=infrared_image.InfraredResponse(noise=self._noise),
        )
        disparity = self._matcher.match(left, right)
        if self._noise:
            disparity = with_noise(disparity, np.random.default_rng([seed, 2]))
        near, far = self._sensor.depth.range_m
        depth = disparity_to_depth(
            disparity,
            focal_px=self.camera.fx,
            baseline_m=self._sensor.baseline_m,
            range_m=(near, far),
        )
        return Reading(depth, left, right)


def _picture(sensor: SensorSpec, options: DepthModelOptions) -> DotPattern | None:
    if options.pattern is None:
        return None
    if sensor.projector is None:
        raise ToolkitError("this sensor has no projector", field="pattern", value=sensor.name)
    fov = options.pattern_fov_deg or sensor.projector.fov_deg[0]
    return load_pattern(options.pattern, fov_x_deg=fov)


def with_noise(
    disparity: NDArray[np.floating],
    rng: np.random.Generator,
    *,
    noise_px: float = NOISE_PX,
    spread_px: float = SPREAD_PX,
) -> NDArray[np.float32]:
    """Disparity with correlated Gaussian noise; pixels without a disparity keep none.

    Args:
        disparity: (H, W) pixels, 0 = none.
        rng: consumed.
        noise_px: standard deviation.
        spread_px: spread of the Gaussian that white noise is smoothed with.

    Returns:
        (H, W) float32.
    """
    white = rng.standard_normal(disparity.shape, np.float32)
    smooth = cv2.GaussianBlur(white, (0, 0), spread_px, borderType=cv2.BORDER_REFLECT)
    # Smoothing divides the deviation of white noise by this.
    lost = 2 * np.sqrt(np.pi) * spread_px
    noisy = disparity + np.float32(noise_px * lost) * smooth
    return np.where(disparity > 0, np.maximum(noisy, 1e-3), 0).astype(np.float32)
