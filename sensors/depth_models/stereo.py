"""Active stereo: a projector of dots, two infrared cameras and a stereo matcher."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sensors.depth_models.depth_model import DepthModelOptions, Illumination, Reading
from sensors.lighting.light_draw import PROJECTOR_POWER
from sensors.pattern import DotPattern, load_pattern, make_pattern
from sensors.render import infrared_image, sim_scene
from sensors.render.sim_renderer import LoadedScene, RenderOptions
from sensors.specs import SensorSpec
from sensors.stereo import disparity_to_depth, make_matcher
from sensors.stereo.disparity_noise import with_noise
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.jobs.options import usable_cores

Pair = tuple[NDArray[np.float32], NDArray[np.float32]]


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
