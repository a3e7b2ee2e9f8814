"""From a scene's seed to its frames: light, exposure, the sensor's depth, exact maps."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.align import align_depth
from sensors.depth_models import Illumination, Reading
from sensors.output.simulated_frame import SimulatedFrame
from sensors.render import color_image, sim_renderer, sim_scene
from sensors.simulation.equipment import DRESSED_AS, Equipment
from sensors.simulation.options import SimulationOptions
from sensors.simulation.scene_draw import draw_scene, dress_scene, generator
from sensors.simulation.world_builder import World, build_world
from std_toolkit.arrays import Floats
from std_toolkit.geometry import Camera
from std_toolkit.geometry.se3 import SE3

# Materials on which a depth camera does not measure the surface.
CUT_MATERIALS = ("transparent", "specular")


@dataclass
class Stopwatch:
    """Seconds spent in each part of the work, by the wall clock or another counter."""

    clock: Callable[[], float] = time.perf_counter
    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Add the time of the block."""
        began = self.clock()
        try:
            yield
        finally:
            self.seconds[name] += self.clock() - began


@dataclass(frozen=True, eq=False)
class _Seen:
    """Rendered light of a view, before the cameras.

    Attributes:
        seed: of the noise of this frame.
        infrared: what the depth model received; None: no infrared is rendered.
    """

    index: int
    T_world_cam: SE3
    T_world_ir: SE3
    seed: int
    infrared: Any
    color: sim_renderer.ColorLight


class Simulator:
    """Makes the scenes of one data set; keeps the objects that they share.

    Args:
        options: of the data set.
        renderer: name of the renderer plug-in.
        parts_cache: folder that caches the objects' convex parts across runs.
        threads: of renderer, denoiser and depth model; None uses all cores. With more than one, the
            single-threaded work (exact maps, images, alignment) is done while the next view
            renders; the frames are identical to the bit.
        color: another colour camera than the sensor's, in its place. It may have distortion.

    Attributes:
        sensor, environments: that the options name.

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
        color: Camera | None = None,
    ) -> None:
        self.options = options
        self.stopwatch = Stopwatch()
        equipment = Equipment.of(options, threads=threads, color=color)
        self.sensor = equipment.sensor
        self._assets, self.environments = equipment.assets, equipment.environments
        self._arrangements = equipment.arrangements
        self._threads = threads
        self._depth_model = equipment.depth_model
        self._label_camera = equipment.label_camera
        width, height = self._label_camera.size
        self._color_camera = self._label_camera.resized(
            options.color_factor * width, options.color_factor * height
        )
        self._lens = color_image.Lens.of(self._color_camera)
        self._quality = sim_renderer.quality_of(options.quality)
        self._parts_cache = parts_cache
        self._renderer = sim_renderer.SIM_RENDERERS.get(renderer)(threads=threads)

    @property
    def renderer_name(self) -> str:
        """Name of the renderer in records, its variant included."""
        return self._renderer.name

    def world(self, seed: int, name: str) -> World:
        """Draw a scene and let it come to rest.

        Raises:
            ToolkitError: see `draw_scene` and `build_world`.
        """
        with self.stopwatch.part("settle"):
            poses: Sequence[SE3] | None = None
            parameters: dict[str, Any] = {"renderer": self._renderer.name}
            if self._arrangements is None:
                draw, assets, maps = draw_scene(seed, self.options, self._assets, self.environments)
            else:
                found = self._arrangements.of_seed(seed, cache=self._parts_cache)
                assets, poses = found.assets, found.poses
                parameters["graspnet_scene"] = found.scene
                draw, maps = dress_scene(
                    seed, self.options, assets, self.environments, dressed_as=DRESSED_AS
                )
            return build_world(
                name,
                draw,
                assets,
                maps,
                self.options,
                sensor=self.sensor.name,
                baseline_m=self.sensor.baseline_m or None,
                poses=poses,
                parts_cache=self._parts_cache,
                parameters=parameters,
            )

    def frames(self, world: World) -> Iterator[SimulatedFrame]:
        """The frames of a scene, in order."""
        with self.stopwatch.part("load"):
            loaded = self._renderer.load(world.scene)
            truth = sim_scene.TruthCaster(world.scene)
        noise = generator(world.draw.seed, "noise")
        # A seed per frame: the noise of a frame does not depend on earlier frames.
        seen = (
            self._look(world, loaded, index, T_world_cam, int(noise.integers(2**31)))
            for index, T_world_cam in enumerate(world.T_world_cam)
        )
        if self._threads == 1:
            for view in seen:
                yield self._frame(world, truth, view)
            return
        with ThreadPoolExecutor(1, thread_name_prefix="finish-frame") as finisher:
            waiting: Future[SimulatedFrame] | None = None
            for view in seen:
                following = finisher.submit(self._frame, world, truth, view)
                if waiting is not None:
                    yield waiting.result()
                waiting = following
            if waiting is not None:
                yield waiting.result()

    def _look(
        self,
        world: World,
        loaded: sim_renderer.LoadedScene,
        index: int,
        T_world_cam: SE3,
        seed: int,
    ) -> _Seen:
        """Render a view: the only step that uses the renderer."""
        light, look = world.draw.light[index], world.looks[index]
        with self.stopwatch.part("load"):
            loaded.change(look.environment, look.rotation_rad, look.floor)
        T_world_ir = T_world_cam @ self.sensor.pose_of_color.inverse()
        infrared = None
        if self.options.depth != "exact":
            with self.stopwatch.part("infrared"):
                infrared = self._depth_model.look(
                    loaded,
                    T_world_ir,
                    Illumination(
                        ambient=light.infrared_strength,
                        factor=light.projector_factor,
                        pattern_seed=world.draw.pattern_seed,
                    ),
                    options=self._quality.infrared,
                    seed=seed,
                )
        with self.stopwatch.part("colour"):
            color = loaded.color(
                self._lens.rendered,
                T_world_cam,
                ambient=light.color_strength,
                options=self._quality.color,
                seed=seed,
            )
        return _Seen(index, T_world_cam, T_world_ir, seed, infrared, color)

    def _frame(self, world: World, truth: sim_scene.TruthCaster, view: _Seen) -> SimulatedFrame:
        """Images, depth and labels of a rendered view."""
        part, camera = self.stopwatch.part, self._depth_model.camera
        with part("exact maps"):
            exact = truth.maps(self._label_camera, view.T_world_cam)
            depth_exact_ir, mask_ir = truth.depth_and_mask(camera, view.T_world_ir)
        if view.infrared is None:
            reading = Reading(depth_exact_ir, np.zeros(depth_exact_ir.shape, np.uint8))
        else:
            with part("depth"):
                reading = self._depth_model.read(view.infrared, seed=view.seed)
        with part("denoise"):
            fast = self._quality.color.fast_denoiser
            clean = color_image.denoise(view.color, threads=self._threads, fast=fast)
            clean = self._lens.bent(clean)
        with part("images"):
            responses = world.draw.color
            color, _ = color_image.develop(
                clean,
                rng=np.random.default_rng([view.seed, 1]),
                response=responses[view.index] if responses else None,
            )
        if self.options.depth == "exact":
            aligned = exact.depth
        elif self.options.depth == "cut":
            reading = Reading(
                self._cut(world, depth_exact_ir, mask_ir), reading.left, reading.right
            )
            aligned = self._cut(world, exact.depth, exact.mask)
        else:
            with part("alignment"):
                aligned = align_depth(
                    reading.depth,
                    camera,
                    self._label_camera,
                    self.sensor.pose_of_color.inverse(),
                )
        return SimulatedFrame(
            index=view.index,
            color=color,
            infrared_left=reading.left,
            infrared_right=reading.right,
            depth_sensor=reading.depth,
            depth_exact_infrared=depth_exact_ir,
            mask_infrared=mask_ir,
            depth_aligned=aligned,
            depth_exact=exact.depth,
            mask=exact.mask,
            nocs=exact.nocs,
            normals=exact.normals,
            T_world_cam=view.T_world_cam,
            T_world_ir=view.T_world_ir,
            color_camera=self._color_camera,
            infrared_camera=camera,
        )

    def _cut(self, world: World, depth: Floats, mask: NDArray[np.uint8]) -> Floats:
        """Exact depth without the objects that the sensor does not measure."""
        ids = [o.instance_id for o in world.record.objects if o.material_class in CUT_MATERIALS]
        return np.where(np.isin(mask, ids), np.float32(0), depth)
