"""Sensor, depth model and sources of a data set, checked before any work begins.

Category-agnostic scenes have real objects arranged as in a scene of GraspNet-1Billion. The seed
selects the scene; materials, floor, light and viewpoints are drawn as for dropped objects. As in
that data set, scenes 0 to 99 are for training and the others for testing.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sensors.assets import Asset, AssetSource, SourceOptions, open_source
from sensors.depth_models import DepthModel, DepthModelOptions, make_depth_model
from sensors.lighting import environment, environment_sources, light_draw
from sensors.physics import GraspNetScenes
from sensors.simulation.options import GRASPNET, SimulationOptions
from sensors.specs import SensorSpec, load_sensor
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.plugins import check_named, names_of

# Its objects may get the materials of this category, as vessels do.
DRESSED_AS = "bottle"

FIRST_TEST_SCENE = 100


@dataclass(frozen=True, eq=False)
class Equipment:
    """Everything that a data set is made with, apart from the renderer.

    Attributes:
        depth_model: how the sensor measures depth.
        label_camera: colour at the size of the labels.
        arrangements: given object poses; None if objects are dropped.
    """

    sensor: SensorSpec
    depth_model: DepthModel
    label_camera: Camera
    assets: AssetSource
    environments: environment_sources.EnvironmentSource
    arrangements: Arrangements | None

    @staticmethod
    def of(
        options: SimulationOptions, *, threads: int | None = None, color: Camera | None = None
    ) -> Equipment:
        """Load all of it; fast, so that invalid options are reported before any work begins.

        Args:
            options: of the data set.
            threads: of the depth model.
            color: another colour camera than the sensor's, with images of its own size. Infrared
                images have its proportions if the sensor knows them, else the size of the options.

        Raises:
            ToolkitError: an unknown or unusable sensor, one whose file names code, or an
                unknown or unusable image size, matcher, source or pattern.
        """
        sensor = load_sensor(options.sensor)
        if not options.allow_code:
            with names_of(f"the sensor {options.sensor}"):
                check_named(sensor.depth_model, field="depth_model")
        size = options.width, options.height
        if color is not None and sensor.has_proportions(*color.size):
            size = color.size
        model = make_depth_model(
            sensor,
            DepthModelOptions(
                width=size[0],
                height=size[1],
                matcher=options.matcher,
                pattern=None if options.pattern is None else Path(options.pattern),
                pattern_fov_deg=options.pattern_fov_deg,
                noise=options.infrared_noise,
                threads=threads,
            ),
        )
        if options.floors is not None:
            environment.files_of_split(options.floors, options.split, light_draw.IMAGE_SUFFIXES)
        root = None if options.assets_root is None else Path(options.assets_root)
        return Equipment(
            sensor,
            model,
            color or sensor.color_camera(options.width, options.height),
            open_source(options.assets, SourceOptions(root=root, split=options.split)),
            environment_sources.environment_source(options.environments, split=options.split),
            Arrangements(options) if options.scenes_from == GRASPNET else None,
        )


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Objects at rest.

    Attributes:
        scene: number of the scene in GraspNet-1Billion.
        assets: its objects.
        poses: T_world_obj of each, their middle above the origin, the floor at z = 0.
    """

    scene: int
    assets: list[Asset]
    poses: tuple[SE3, ...]


class Arrangements:
    """The scenes of a GraspNet-1Billion folder that belong to a split.

    Args:
        options: `graspnet_root` and `split` are used.

    Raises:
        ToolkitError: not such a folder, or no scene of the split in it.
    """

    def __init__(self, options: SimulationOptions) -> None:
        assert options.graspnet_root is not None
        root = Path(options.graspnet_root)
        self._scenes = GraspNetScenes(root)
        self._numbers = [
            n
            for n in self._scenes.scenes()
            if options.split == "all" or (n >= FIRST_TEST_SCENE) == (options.split == "test")
        ]
        if not self._numbers:
            raise ToolkitError(
                f"no annotated scene of the split {options.split!r} here",
                path=root / "scenes",
                hint="training scenes are scene_0000 to scene_0099, the others are for testing",
            )

    def of_seed(self, seed: int, *, cache: Path | None = None) -> Arrangement:
        """The scene of a seed; seeds beyond the number of scenes wrap around.

        Args:
            seed: of the simulated scene.
            cache: folder of convex parts.

        Raises:
            ToolkitError: see `GraspNetScenes.arrangement`.
        """
        number = self._numbers[seed % len(self._numbers)]
        objects, poses = self._scenes.arrangement(number, cache=cache)
        # Viewpoints look at the origin; the origin of the annotated table is at its marker.
        middle = np.mean([T.t for T in poses], axis=0) * [1.0, 1.0, 0.0]
        return Arrangement(
            number, [o.asset for o in objects], tuple(SE3(T.R, T.t - middle) for T in poses)
        )
