"""What a data set is made with, found before any work begins."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from sensors.assets import AssetSource, SourceOptions, open_source
from sensors.lighting import EnvironmentSource, environment_source
from sensors.lighting.floor import IMAGE_SUFFIXES
from sensors.lighting.folder import files_of_split
from sensors.pattern import DotPattern, load_pattern, make_pattern
from sensors.simulation.arrangement import Arrangements
from sensors.simulation.options import SimulationOptions
from sensors.specs import SensorSpec, load_sensor
from sensors.stereo import StereoMatcher, make_matcher
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera


@dataclass(frozen=True, eq=False)
class Equipment:
    """What a data set is made with, apart from the renderer.

    Attributes:
        cameras: infrared, and colour at the size of the labels.
        pattern: what the projector throws; None where the sensor has none.
        arrangements: where objects lie already; None where they fall.
    """

    sensor: SensorSpec
    cameras: tuple[Camera, Camera]
    matcher: StereoMatcher
    assets: AssetSource
    environments: EnvironmentSource
    pattern: DotPattern | None
    arrangements: Arrangements | None

    @staticmethod
    def of(options: SimulationOptions, *, threads: int | None = None) -> Equipment:
        """Find all of it; quick, so that bad options are told before any work begins.

        Raises:
            ToolkitError: an unknown or unusable sensor, image size, matcher, source or pattern.
        """
        sensor = load_sensor(options.sensor)
        size = (options.width, options.height)
        cameras = sensor.infrared_camera(*size), sensor.color_camera(*size)
        low, high = sensor.disparity_range(*size)
        # What the released matcher searches is part of it.
        own = {} if options.matcher == "dreds" else {"min_disparity": low, "max_disparity": high}
        if options.matcher == "local":
            own["threads"] = threads or len(os.sched_getaffinity(0))
        if options.floors is not None:
            files_of_split(options.floors, options.split, IMAGE_SUFFIXES)
        root = None if options.assets_root is None else Path(options.assets_root)
        return Equipment(
            sensor,
            cameras,
            make_matcher(options.matcher, **own),
            open_source(options.assets, SourceOptions(root=root, split=options.split)),
            environment_source(options.environments, split=options.split),
            _pattern(sensor, options),
            Arrangements(options) if options.scenes_from == "graspnet" else None,
        )


def _pattern(sensor: SensorSpec, options: SimulationOptions) -> DotPattern | None:
    if options.pattern is None:
        return None if sensor.projector is None else make_pattern(sensor)
    if sensor.projector is None:
        raise ToolkitError(
            "this sensor has no projector to throw a pattern", field="pattern", value=sensor.name
        )
    fov = options.pattern_fov_deg or sensor.projector.fov_deg[0]
    return load_pattern(Path(options.pattern), fov_x_deg=fov)
