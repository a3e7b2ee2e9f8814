"""From a scene's seed to its frames: light, exposure, stereo matching, exact maps."""

from __future__ import annotations

import os
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sensors.align import align_depth
from sensors.assets import AssetSource, SourceOptions, open_source
from sensors.lighting import EnvironmentSource, environment_source
from sensors.output import SimulatedFrame
from sensors.pattern import make_pattern
from sensors.render import (
    SIM_RENDERERS,
    InfraredResponse,
    LoadedScene,
    Projector,
    TruthCaster,
    denoise,
    develop,
    expose_pair,
)
from sensors.simulation.draw import draw_scene, generator
from sensors.simulation.options import SimulationOptions
from sensors.simulation.quality import quality_of
from sensors.simulation.world import World, build_world
from sensors.specs import SensorSpec, load_sensor
from sensors.stereo import StereoMatcher, disparity_to_depth, make_matcher
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3

# Irradiance of the projector at 1 m where the pattern is bright, against an environment of mean
# luminance 1 that the camera's filter takes most of.
PROJECTOR_POWER = 0.8
# Materials on which an active stereo camera does not measure the surface.
CUT_MATERIALS = ("transparent", "specular")


@dataclass
class Stopwatch:
    """Seconds by the clock spent in each part of the work."""

    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Add the time that the block takes."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += time.perf_counter() - began


@dataclass(frozen=True, eq=False)
class Equipment:
    """What a data set is made with, apart from the renderer.

    Attributes:
        cameras: infrared, and colour at the size of the labels.
    """

    sensor: SensorSpec
    cameras: tuple[Camera, Camera]
    matcher: StereoMatcher
    assets: AssetSource
    environments: EnvironmentSource

    @staticmethod
    def of(options: SimulationOptions, *, threads: int | None = None) -> Equipment:
        """Find all of it; quick, so that bad options are told before any work begins.

        Raises:
            ToolkitError: an unknown or unusable sensor, image size, matcher or source.
        """
        sensor = load_sensor(options.sensor)
        size = (options.width, options.height)
        cameras = sensor.infrared_camera(*size), sensor.color_camera(*size)
        low, high = sensor.disparity_range(*size)
        # What the released matcher searches is part of it.
        own = {} if options.matcher == "dreds" else {"min_disparity": low, "max_disparity": high}
        if options.matcher == "local":
            own["threads"] = threads or len(os.sched_getaffinity(0))
        root = None if options.assets_root is None else Path(options.assets_root)
        return Equipment(
            sensor,
            cameras,
            make_matcher(options.matcher, **own),
            open_source(options.assets, SourceOptions(root=root, split=options.split)),
            environment_source(options.environments, split=options.split),
        )


class Simulator:
    """Makes scenes of one data set; keeps what all of them share.

    Args:
        options: of the data set.
        renderer: name of the renderer plug-in.
        parts_cache: folder that keeps the objects' convex parts over runs.
        threads: of renderer and matcher; None takes all cores.

    Raises:
        ToolkitError: an unknown sensor, source or renderer, or one that does not work here.
    """

    def __init__(
        self,
        options: SimulationOptions,
        *,
        renderer: str = "mitsuba",
        parts_cache: Path | None = None,
        threads: int | None = None,
    ) -> None:
        self.options = options
        self.stopwatch = Stopwatch()
        equipment = Equipment.of(options, threads=threads)
        self._sensor = equipment.sensor
        self._assets, self._environments = equipment.assets, equipment.environments
        self._matcher = equipment.matcher
        self._infrared_camera, self._label_camera = equipment.cameras
        self._color_camera = self._label_camera.resized(
            options.color_factor * options.width, options.color_factor * options.height
        )
        self._quality = quality_of(options.quality)
        self._pattern = None if self._sensor.projector is None else make_pattern(self._sensor)
        self._parts_cache = parts_cache
        self._renderer = SIM_RENDERERS.get(renderer)(threads=threads)

    def world(self, seed: int, name: str) -> World:
        """Draw a scene and let it come to rest.

        Raises:
            ToolkitError: see `draw_scene` and `build_world`.
        """
        with self.stopwatch.part("settle"):
            draw, assets, environment = draw_scene(
                seed, self.options, self._assets, self._environments
            )
            return build_world(
                name,
                draw,
                assets,
                environment,
                self.options,
                sensor=self._sensor.name,
                parts_cache=self._parts_cache,
                parameters={"renderer": self._renderer.name},
            )

    def frames(self, world: World) -> Iterator[SimulatedFrame]:
        """The frames of a scene, one after the other."""
        with self.stopwatch.part("load"):
            loaded = self._renderer.load(world.scene)
            truth = TruthCaster(world.scene)
        noise = generator(world.draw.seed, "noise")
        for index, T_world_cam in enumerate(world.T_world_cam):
            # A seed for each frame: a frame's noise does not depend on those before it.
            number = int(noise.integers(2**31))
            yield self._frame(world, loaded, truth, index, T_world_cam, number)

    def _frame(
        self,
        world: World,
        loaded: LoadedScene,
        truth: TruthCaster,
        index: int,
        T_world_cam: SE3,
        seed: int,
    ) -> SimulatedFrame:
        part = self.stopwatch.part
        T_world_ir = T_world_cam @ self._sensor.pose_of_color.inverse()
        with part("exact maps"):
            exact = truth.maps(self._label_camera, T_world_cam)
            exact_ir = truth.maps(self._infrared_camera, T_world_ir)
        left, right = self._infrared_pair(world, loaded, index, T_world_ir, seed)
        with part("colour"):
            light = loaded.color(
                self._color_camera,
                T_world_cam,
                ambient=world.draw.light[index].color_strength,
                options=self._quality.color,
                seed=seed,
            )
        with part("denoise"):
            color, _ = develop(denoise(light), rng=np.random.default_rng([seed, 1]))
        if self.options.depth == "cut":
            depth_ir = self._cut(world, exact_ir.depth, exact_ir.mask)
            aligned = self._cut(world, exact.depth, exact.mask)
        else:
            with part("matching"):
                depth_ir = self._measured(left, right)
            with part("alignment"):
                aligned = align_depth(
                    depth_ir,
                    self._infrared_camera,
                    self._label_camera,
                    self._sensor.pose_of_color.inverse(),
                )
        return SimulatedFrame(
            index=index,
            color=color,
            infrared_left=left,
            infrared_right=right,
            depth_sensor=depth_ir,
            depth_exact_infrared=exact_ir.depth,
            mask_infrared=exact_ir.mask,
            depth_aligned=aligned,
            depth_exact=exact.depth,
            mask=exact.mask,
            nocs=exact.nocs,
            normals=exact.normals,
            T_world_cam=T_world_cam,
            T_world_ir=T_world_ir,
            color_camera=self._color_camera,
            infrared_camera=self._infrared_camera,
        )

    def _infrared_pair(
        self, world: World, loaded: LoadedScene, index: int, T_world_ir: SE3, seed: int
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        light = world.draw.light[index]
        projector = None
        if self._pattern is not None and self._sensor.projector is not None:
            projector = Projector(
                self._pattern.image,
                self._pattern.fov_x_deg,
                T_world_ir @ self._sensor.projector.T_ir_projector,
                power=PROJECTOR_POWER * light.projector_factor,
            )
        T_left_right = SE3(np.eye(3), np.array([self._sensor.baseline_m, 0.0, 0.0]))
        with self.stopwatch.part("infrared"):
            # Different paths for the two eyes: equal noise would look like texture to match.
            left, right = (
                loaded.infrared(
                    self._infrared_camera,
                    T,
                    projector,
                    ambient=light.infrared_strength,
                    options=self._quality.infrared,
                    seed=2 * seed + eye,
                )
                for eye, T in enumerate((T_world_ir, T_world_ir @ T_left_right))
            )
        images = expose_pair(
            left,
            right,
            rng=np.random.default_rng([seed, 0]),
            response=InfraredResponse(noise=self.options.infrared_noise),
        )
        return images[0], images[1]

    def _measured(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> NDArray[np.float32]:
        near, far = self._sensor.depth.range_m
        return disparity_to_depth(
            self._matcher.match(left, right),
            focal_px=self._infrared_camera.fx,
            baseline_m=self._sensor.baseline_m,
            range_m=(near, far),
        )

    def _cut(
        self, world: World, depth: NDArray[np.float32], mask: NDArray[np.uint8]
    ) -> NDArray[np.float32]:
        """Exact depth without the objects that a sensor does not measure."""
        ids = [o.instance_id for o in world.record.objects if o.material_class in CUT_MATERIALS]
        return np.where(np.isin(mask, ids), np.float32(0), depth)
