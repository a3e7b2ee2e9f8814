"""A recording of chosen objects by the path-tracing simulator, used by the demo.

The form on disk is that of the quick recordings (`sensors.synthetic.recording`): color/, depth/
(16 bit), models/, intrinsics.json, truth.json. Depth is the stereo matcher's result on the
simulated infrared pair of a D415, aligned to colour: with holes and errors on glass and metal.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from sensors.assets import Asset
from sensors.output.recording_writer import Truth, read_truth
from sensors.simulation.options import QualityName
from sensors.simulation.scene_draw import ObjectDraw
from sensors.synthetic.recording import DEPTH_SCALE
from sensors.synthetic.shapes import label_texture
from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.images import write_color
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.jobs.artefact import begin
from std_toolkit.scene.document import Document
from std_toolkit.scene.model import Material

# Asset of the built-in library, diagonal in metres, class and material ("": the asset's own look):
# four that a stereo sensor measures, a bottle of glass and a bowl of steel that it does not.
OBJECTS: tuple[tuple[str, float, Material, str], ...] = (
    ("bottle-p1-000000", 0.22, "transparent", "glass_clear"),
    ("bowl-p1-000004", 0.16, "specular", "steel_polished"),
    ("mug-p1-000012", 0.14, "raw", ""),
    ("camera-p1-000004", 0.18, "raw", ""),
    ("can-p1-000018", 0.14, "raw", ""),
    ("car-p1-000002", 0.22, "diffuse", "coarse_plastic_bright"),
)
# They are close together, as in clutter, and most of them are upright.
HALF_WIDTH_M = 0.24
TILT_RAD = 0.05
# Frames made at a time; a killed run loses at most these.
CHUNK = 5
# Extent of the floor image; a renderer reduces it to 1024 pixels, as fine as the camera images.
FLOOR_TILE_M = 1.5
FLOOR_PX = 1024
_BEGUN = "simulated.json"


class SimulatedOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of a simulated recording.

    Attributes:
        frames: number of frames.
        sweep_deg: angle of the camera's path around the objects.
        width, height: of all images.
        quality: light paths per pixel, one of `sensors.simulation.options`.
        seed: of object poses, light, path and noise.
    """

    frames: int = 36
    sweep_deg: float = 100.0
    width: int = 640
    height: int = 360
    quality: QualityName = "rough"
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("frames", "width", "height"):
            if getattr(self, name) < 1:
                raise ToolkitError("must be at least 1", field=name, value=getattr(self, name))


class Begun(Document, frozen=True, kw_only=True):
    """simulated.json: the options of a recording, written before its first frame."""

    version_of_tool: str
    options: SimulatedOptions


def make_simulated_recording(
    out: Path, options: SimulatedOptions | None = None, *, parts_cache: Path | None = None
) -> Truth:
    """Write color/, depth/ (16-bit PNG, mm), models/, intrinsics.json and truth.json to `out`.

    Existing frames are kept; a recording with truth.json is complete. The same options give the
    same files, also after interruptions.

    Args:
        out: folder; created if missing.
        options: what to simulate.
        parts_cache: cache of the objects' convex parts; default: the user's cache.

    Raises:
        ToolkitError: another recording exists at `out`, or the simulator does not work here.
    """
    options = options or SimulatedOptions()
    begin(
        out / _BEGUN,
        Begun(version_of_tool=__version__, options=options),
        within=["options"],
        what="this recording was",
        hint="choose another folder, or remove this one",
    )
    if (out / "truth.json").exists():
        return read_truth(out)
    chunks = [range(i, min(i + CHUNK, options.frames)) for i in range(0, options.frames, CHUNK)]
    missing = [c for c in chunks if not all(_depth_path(out, i).exists() for i in c)]
    recorder = _Recorder(out, options, parts_cache)
    # Sequentially in this process: the renderer itself uses all cores.
    run_jobs(
        partial(_write_chunk, recorder),
        missing,
        name="simulate",
        key=lambda c: f"frames {c.start} to {c.stop - 1}",
        options=JobOptions(engine="serial"),
    ).raise_if_failed()
    return recorder.finish()


def draw_objects(seed: int) -> tuple[list[Asset], list[ObjectDraw]]:
    """The objects of a recording: their shapes, and their sizes and materials by its seed."""
    from sensors.assets import SourceOptions, open_source
    from sensors.materials.material_draw import draw_material
    from sensors.simulation.scene_draw import ObjectDraw, generator

    source = open_source("procedural", SourceOptions(split="all"))
    assets = [source.load(asset_id) for asset_id, *_ in OBJECTS]
    rng = generator(seed, "materials")
    return assets, [
        ObjectDraw(
            instance=instance,
            asset=asset.id,
            category=asset.category,
            diagonal_m=diagonal,
            material=draw_material(rng, material_class, name=name or None),
        )
        for instance, (asset, (_, diagonal, material_class, name)) in enumerate(
            zip(assets, OBJECTS, strict=True), start=1
        )
    ]


class _Recorder:
    """The scene at rest, and its simulator."""

    def __init__(self, out: Path, options: SimulatedOptions, cache: Path | None) -> None:
        from sensors.lighting.environment_sources import environment_source
        from sensors.lighting.light_draw import FloorDraw, draw_lighting
        from sensors.materials.material_draw import draw_material
        from sensors.physics import PhysicalObject, convex_parts, settle
        from sensors.physics.settle import SettleOptions
        from sensors.simulation.options import SimulationOptions
        from sensors.simulation.scene_draw import SceneDraw, generator
        from sensors.simulation.simulated_set import parts_cache
        from sensors.simulation.simulator import Simulator
        from sensors.simulation.world_builder import build_world
        from sensors.specs import load_sensor
        from sensors.viewpoints.camera_path import TrajectoryOptions, smooth_trajectory

        self.out = out
        cache = cache or parts_cache()
        settings = SimulationOptions(
            views=options.frames,
            order="arc",
            width=options.width,
            height=options.height,
            quality=options.quality,
        )
        self.simulator = Simulator(settings, parts_cache=cache)
        assets, objects = draw_objects(options.seed)
        rng = generator(options.seed, "light")
        environment = environment_source(None, split="train").draw(rng)
        cloth = draw_material(generator(options.seed, "floor"), "diffuse", name="fabric_cotton")
        draw = SceneDraw(
            seed=options.seed,
            objects=objects,
            floors=[
                FloorDraw(
                    # A printed cloth: structure from motion needs texture.
                    material=msgspec.structs.replace(cloth, texture=None, own_share=1.0),
                    image=str(_write_floor(out / "floor.png", options.seed)),
                    image_tile_m=FLOOR_TILE_M,
                )
            ]
            * options.frames,
            # The light is constant during a recording.
            light=[draw_lighting(rng, environment.name)] * options.frames,
            pattern_seed=options.seed,
        )
        falling = [
            PhysicalObject(asset, obj.diagonal_m, convex_parts(asset, cache))
            for asset, obj in zip(assets, objects, strict=True)
        ]
        settled = settle(
            falling, options.seed, SettleOptions(half_width_m=HALF_WIDTH_M, tilt=TILT_RAD)
        )
        world = build_world(
            out.name,
            draw,
            assets,
            [environment] * options.frames,
            settings,
            sensor="d415",
            baseline_m=load_sensor("d415").baseline_m,
            poses=settled.poses,
        )
        way = TrajectoryOptions(frames=options.frames, sweep_deg=options.sweep_deg)
        self.world = replace(world, T_world_cam=tuple(smooth_trajectory(options.seed, way)))

    def chunk(self, frames: range) -> None:
        """Simulate and write some of the frames."""
        from sensors.output.recording_writer import write_images

        draw = self.world.draw
        part = replace(
            self.world,
            # Each chunk has its own noise, independent of earlier ones.
            draw=msgspec.structs.replace(
                draw,
                seed=draw.seed * 100_000 + frames.start,
                light=draw.light[frames.start : frames.stop],
                floors=draw.floors[frames.start : frames.stop],
            ),
            looks=self.world.looks[frames.start : frames.stop],
            T_world_cam=self.world.T_world_cam[frames.start : frames.stop],
        )
        for frame in self.simulator.frames(part):
            write_images(
                self.out, replace(frame, index=frames.start + frame.index), depth_scale=DEPTH_SCALE
            )

    def finish(self) -> Truth:
        """Write models, intrinsics and the truth after every frame was written."""
        from sensors.output.recording_writer import write_truth
        from sensors.simulation.equipment import Equipment

        camera = Equipment.of(self.simulator.options).label_camera
        poses: list[SE3] = list(self.world.T_world_cam)
        return write_truth(self.out, self.world.record, camera, poses, depth_scale=DEPTH_SCALE)


def _write_chunk(recorder: _Recorder, frames: range) -> None:
    recorder.chunk(frames)


def _depth_path(out: Path, index: int) -> Path:
    return out / f"depth/{index:06d}.png"


def _write_floor(path: Path, seed: int) -> Path:
    """A printed cloth in sRGB, the same for the same seed."""
    picture = label_texture(
        np.random.default_rng(seed),
        width=FLOOR_PX,
        height=FLOOR_PX,
        base=(0.52, 0.47, 0.41),
        marks=3500,
        contrast=0.45,
        mark_size=(0.004, 0.016),
    )
    write_color(path, np.rint(255 * picture).astype(np.uint8))
    return path
