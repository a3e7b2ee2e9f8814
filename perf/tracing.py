"""Cost of rendering alone: `python perf/tracing.py [--views 30] [--pictures FOLDER]`.

One scene of six made-up bodies and a floor is rendered from many views at 640x360 at draft
quality, by the path tracer and with --reference by Mitsuba's own integrator. Prints processor
seconds per view of every part, the cost of the first view above the others (compilation), the
noise of infrared by material, and peak memory. Whole frames are measured by simulate.py.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from sensors.lighting.environment_sources import StudioSource
from sensors.lighting.light_draw import draw_floor, draw_lighting
from sensors.materials.material_draw import draw_material
from sensors.materials.material_library import MaterialClass
from sensors.pattern import DotPattern, make_pattern
from sensors.render.color_image import denoise, develop
from sensors.render.infrared_image import expose_pair
from sensors.render.sim_renderer import DRAFT_COLOR, DRAFT_INFRARED, RenderOptions
from sensors.render.sim_scene import Projector, SceneObject, SimScene, SurfaceMesh, TruthCaster
from sensors.specs import load_sensor
from sensors.viewpoints.views import ViewpointOptions, random_viewpoints
from std_toolkit.geometry import SE3
from std_toolkit.io.images import write_color, write_png

SENSOR = load_sensor("d415")
CAMERA = SENSOR.infrared_camera(640, 360)
POWER = 0.25
CLASSES: tuple[MaterialClass, ...] = (
    "diffuse",
    "specular",
    "transparent",
    "raw",
    "specular",
    "transparent",
)


def vessel(radius: float, height: float, wall: float) -> trimesh.Trimesh:
    """An open cup: outside, rim and inside, watertight."""
    profile = [
        *([0, 0], [radius * 0.8, 0], [radius, 0.3 * height], [radius, height]),
        *([radius - wall, height], [radius - wall, 0.3 * height]),
        *([radius * 0.8 - wall, wall], [0, wall]),
    ]
    points = np.asarray(profile, float)
    steps = np.arange(8)[None, :, None] / 8
    dense = (points[:-1, None] * (1 - steps) + points[1:, None] * steps).reshape(-1, 2)
    dense = np.concatenate([dense, points[-1:]])
    return trimesh.creation.revolve(dense, sections=96)


def test_scene(seed: int) -> SimScene:
    """Six objects of all classes on a floor, about 40,000 triangles."""
    rng = np.random.default_rng(seed)
    shapes = [
        trimesh.creation.torus(0.06, 0.025, major_sections=96, minor_sections=48),
        trimesh.creation.icosphere(5, 0.05),
        vessel(0.045, 0.11, 0.004),
        trimesh.creation.box((0.09, 0.06, 0.13)),
        vessel(0.04, 0.09, 0.003),
        vessel(0.075, 0.06, 0.004),
    ]
    floor_half = 1.5
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * floor_half
    floor = SurfaceMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    objects = [SceneObject(0, floor, SE3.identity(), draw_floor(rng).material)]
    for i, (shape, name) in enumerate(zip(shapes, CLASSES, strict=True)):
        place = np.array([0.17 * (i % 3 - 1), 0.15 * (i // 3) - 0.08, -shape.bounds[0, 2]])
        mesh = SurfaceMesh(np.asarray(shape.vertices), np.asarray(shape.faces))
        color = (float(rng.uniform(0.1, 0.8)), float(rng.uniform(0.1, 0.8)), 0.3)
        objects.append(
            SceneObject(i + 1, mesh, SE3(np.eye(3), place), draw_material(rng, name), color=color)
        )
    return SimScene(tuple(objects), StudioSource().draw(rng), float(rng.uniform(0, 2 * np.pi)))


def views(count: int, seed: int) -> list[SE3]:
    """Left infrared cameras around the table."""
    return [v.T_world_cam for v in random_viewpoints(seed, ViewpointOptions(count=count))]


@cache
def pattern_of_sensor() -> DotPattern:
    return make_pattern(SENSOR)


def projector_at(T: SE3, power: float) -> Projector:
    """The sensor's projector beside its left infrared camera."""
    assert SENSOR.projector is not None
    pattern = pattern_of_sensor()
    place = T @ SENSOR.projector.T_ir_projector
    return Projector(pattern.image, pattern.fov_x_deg, place, power=power)


def builtin(scene: SimScene) -> Any:
    """Mitsuba's own integrator on the same surfaces."""
    import mitsuba as mi

    from sensors.render import mitsuba_scene
    from sensors.render.builtin_tracer import BuiltinTracer

    surfaces = mitsuba_scene.build(mi, scene, infrared=True)[0].everything
    return BuiltinTracer(surfaces, mitsuba_scene.environment(mi, scene))


def compiled_anew(renderer: Any, seed: int) -> str:
    """Kernels compiled for another scene with other materials."""
    import drjit as dr

    if "scalar" in renderer.name:
        return "none, it is not a compiled variant"
    options = RenderOptions(samples=16, chunk=4)
    T = views(1, seed)[0]
    projector = projector_at(T, POWER)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        loaded = renderer.load(test_scene(seed))
        loaded.infrared(CAMERA, T, projector, ambient=0.035, options=options)
        loaded.color(CAMERA, T, ambient=0.5)
        kernels = dr.kernel_history([dr.KernelType.JIT])
    return f"{sum(not k['cache_hit'] for k in kernels)} of {len(kernels)}"


def infrared_noise(loaded: Any, maps: Any, T: SE3) -> dict[str, float]:
    """Deviation between seeds as a share of the floor's mean light, by material class."""
    projector = projector_at(T, POWER)
    images = np.stack(
        [loaded.infrared(CAMERA, T, projector, ambient=0.035, seed=s) for s in (7, 8, 9)]
    )
    deviation, level = images.std(axis=0, ddof=1), images.mean(axis=0)[maps.mask == 0].mean()
    names = ("floor", *CLASSES)
    out: dict[str, list[float]] = defaultdict(list)
    for i, name in enumerate(names):
        out[name].append(float(deviation[maps.mask == i].mean() / level))
    return {name: float(np.mean(v)) for name, v in out.items()}


class Clock:
    """Processor seconds of named parts."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = defaultdict(list)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        began = time.process_time()
        yield
        self.seconds[name].append(time.process_time() - began)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--views", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--variant", default=None)
    parser.add_argument("--threads", type=int, default=None)
    parser.add_argument("--reference", action="store_true")
    parser.add_argument("--pictures", type=Path, default=None)
    options = parser.parse_args()

    from sensors.render.mitsuba_renderer import MitsubaRenderer

    renderer = MitsubaRenderer(variant=options.variant, threads=options.threads)
    rng = np.random.default_rng(options.seed)
    scene = test_scene(options.seed)
    light = draw_lighting(rng, scene.environment.name)
    clock, wall = Clock(), time.perf_counter()
    with clock.part("load scene"):
        loaded = renderer.load(scene)
    with clock.part("load truth"):
        truth = TruthCaster(scene)
    others = builtin(scene) if options.reference else None
    for i, T in enumerate(views(options.views, options.seed)):
        T_right = T @ SE3(np.eye(3), np.array([SENSOR.baseline_m, 0, 0]))
        projector = projector_at(T, POWER * light.projector_factor)
        seed = 10 * i
        with clock.part("infrared left"):
            left = loaded.infrared(CAMERA, T, projector, ambient=light.infrared_strength, seed=seed)
        if others is not None:
            with clock.part("(left, reference)"):
                others.radiance(
                    CAMERA,
                    T,
                    projector,
                    ambient=light.infrared_strength,
                    options=DRAFT_INFRARED,
                    seed=seed,
                    grey=True,
                )
        with clock.part("infrared right"):
            right = loaded.infrared(
                CAMERA, T_right, projector, ambient=light.infrared_strength, seed=seed + 1
            )
        with clock.part("colour"):
            color = loaded.color(CAMERA, T, ambient=light.color_strength, seed=seed + 2)
        with clock.part("denoise colour"):
            clean = denoise(color)
        with clock.part("develop and expose"):
            grey_left, grey_right, _ = expose_pair(left, right, rng=rng)
            picture, _ = develop(clean, rng=rng)
        with clock.part("exact maps"):
            maps = truth.maps(CAMERA, T)
        if options.pictures is not None and i < 6:
            options.pictures.mkdir(parents=True, exist_ok=True)
            write_png(options.pictures / f"{i:02d}_left.png", grey_left)
            write_png(options.pictures / f"{i:02d}_right.png", grey_right)
            write_color(options.pictures / f"{i:02d}_color.png", picture)
            noisy, _ = develop(color.radiance)
            write_color(options.pictures / f"{i:02d}_noisy.png", noisy)
            write_png(options.pictures / f"{i:02d}_mask.png", maps.mask * 40)
    wall = time.perf_counter() - wall

    print(
        f"{renderer.name}, {options.views} views of one scene, 640x360, draft: infrared "
        f"{DRAFT_INFRARED.samples} paths a pixel and imager, colour {DRAFT_COLOR.samples}"
    )
    print(f"{'part':20s} {'CPU s a view':>12s} {'first view':>11s}")
    total = 0.0
    for name, seconds in clock.seconds.items():
        share = sum(seconds) / options.views
        total += 0 if name.startswith("(") else share
        print(f"{name:20s} {share:12.3f} {seconds[0]:11.3f}")
    print(f"{'all':20s} {total:12.3f}   ({wall / options.views:.2f} s of wall a view here)")
    if others is None:  # every surface that is alive counts, the reference's too
        anew = compiled_anew(renderer, options.seed + 1)
        print(f"kernels that another scene compiled: {anew}")
    noise = infrared_noise(loaded, maps, T)
    print("infrared noise, share of the floor's light: ", end="")
    print(", ".join(f"{name} {value:.3f}" for name, value in noise.items()))
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


if __name__ == "__main__":
    main()
